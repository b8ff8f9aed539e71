"""Snapshots against the reference: every piece right, of one image, in order, however slowly they are taken."""

import random

import numpy as np
import pytest

from gateware.frame.snapshot import SLOTS, Snapshot
from gateware.layouts import NowSettings
from magtrak.protocol import REGISTERS, SNAPSHOT, SNAPSHOT_PIXELS, Access, Scope, SnapshotSource
from magtrak.reference import snapshot
from tests.support.simulation import simulate

NOW = {r.name: r.init for r in REGISTERS if r.scope is Scope.NOW and r.access is Access.BOTH}
DELAY = 9  # of the measured pixels after the raw ones


def random_image(rng, rows, columns):
    """Raw, gate and weight, independent of each other."""
    return {
        SnapshotSource.RAW: rng.integers(0, 256, (rows, columns, 3), dtype=np.uint8),
        SnapshotSource.GATE: 255 * rng.integers(0, 2, (rows, columns), dtype=np.uint8),
        SnapshotSource.WEIGHT: rng.integers(0, 256, (rows, columns), dtype=np.uint8),
    }


def play(images, settings, *, changes=(), stall=0.0, hold=0, blanking=16, gap=64, faults=(), seed=0):
    """Show ``images``, and take what is sent.

    Parameters
    ----------
    settings : of the snapshot, written before the first image
    changes : pairs of a number of an image and settings that are written in the middle of it
    stall : probability of a clock in which the link takes nothing
    hold : clocks for which it takes nothing at first
    faults : images whose rows are all faulty

    Returns
    -------
    Headers with their pixels, the states of ``busy`` after each image.
    """
    dut = Snapshot()
    values = NOW | settings
    clocks = []  # per clock: raw pixel or None
    for number, image in enumerate(images):
        rows, columns = image[SnapshotSource.RAW].shape[:2]
        for y in range(rows):
            clocks += [(number, y, x, x == columns - 1) for x in range(columns)]
            clocks += [None] * max(blanking, 48 - columns)
        clocks += [None] * gap
    middles = {}
    for number, change in changes:
        of_image = [at for at, clock in enumerate(clocks) if clock is not None and clock[0] == number]
        middles[of_image[len(of_image) // 2]] = change
    ends = [
        max(at for at, c in enumerate(clocks) if c is not None and c[0] == n) + DELAY + 20 for n in range(len(images))
    ]
    ends = [end for end in ends if end < len(clocks) + 200]
    busy, packets = [], []

    async def show(ctx):
        nonlocal values
        ctx.set(dut.settings, NowSettings.const(values))
        await ctx.tick().repeat(4)
        for clock in range(len(clocks) + 200):
            for name, port, at in (("raw", dut.raw, clock), ("measured", dut.measured, clock - DELAY)):
                place = clocks[at] if 0 <= at < len(clocks) else None
                ctx.set(port.valid, place is not None)
                if place is None:
                    continue
                number, y, x, last = place
                image = images[number]
                flags = {
                    "row_first": x == 0,
                    "row_last": last,
                    "frame_first": x == y == 0,
                    "fault": number in faults and x == 0,
                }
                if name == "raw":
                    r, g, b = map(int, image[SnapshotSource.RAW][y, x])
                    ctx.set(port.p, {"r": r, "g": g, "b": b, **flags})
                    if x == y == 0:
                        ctx.set(dut.frame, 1000 + number)
                        ctx.set(dut.generation, 70 + number)
                else:
                    gate = int(image[SnapshotSource.GATE][y, x] != 0)
                    weight = int(image[SnapshotSource.WEIGHT][y, x])
                    ctx.set(port.p, {"gate": gate, "weight": weight, "mix": 0, "saturated": 0, **flags})
            if clock in middles:
                values = values | middles[clock]
                ctx.set(dut.settings, NowSettings.const(values))
            if clock in ends:
                busy.append(ctx.get(dut.busy))
            await ctx.tick()
        for _ in range(60_000):  # what waits is sent
            if not ctx.get(dut.o.valid) and ctx.get(dut.o.ready):
                quiet = 0
                while not ctx.get(dut.o.valid) and quiet < 6:
                    await ctx.tick()
                    quiet += 1
                if quiet == 6:
                    break
            await ctx.tick()

    async def take(ctx):
        rng = random.Random(seed)
        current, clock = bytearray(), 0
        while True:
            ctx.set(dut.o.ready, clock >= hold and rng.random() >= stall)
            _, _, valid, ready, payload = await ctx.tick().sample(dut.o.valid, dut.o.ready, dut.o.payload)
            clock += 1
            if valid and ready:
                current.append(payload.data)
                if payload.last:
                    packets.append(bytes(current))
                    current.clear()

    simulate(dut, show, take, clocks=len(clocks) + 70_000)
    pieces = []
    for packet in packets:
        header = SNAPSHOT.unpack(packet[: SNAPSHOT.size])
        depth = 3 if header["source"] == SnapshotSource.RAW else 1
        pixels = np.frombuffer(packet[SNAPSHOT.size :], np.uint8)
        assert len(pixels) == depth * header["pixels"]
        pieces.append((header, pixels.reshape(-1, 3) if depth == 3 else pixels))
    return pieces, busy


def settings_of(source, columns, rows, step, number=1):
    names = ("source", "step", "column_first", "column_last", "row_first", "row_last")
    values = (int(source), step, *columns, *rows)
    return {"snapshot": number} | {f"snapshot_{name}": value for name, value in zip(names, values, strict=True)}


def check(pieces, images, source, columns, rows, step, number=1):
    """Every piece is the reference's, of the image that it names."""
    wanted = snapshot(images[0][source], columns, rows, step)
    assert [header["pixels"] for header, _ in pieces] == [len(piece.pixels) for piece in wanted]
    for (header, pixels), piece in zip(pieces[:-1], wanted, strict=False):
        of_image = header["frame"] - 1000
        assert (header["row"], header["column"]) == (piece.row, piece.column)
        facts = {"generation": 70 + of_image, "number": number, "source": source, "step": step, "flags": 0}
        assert header.items() >= facts.items()
        last = piece.column + step * (len(piece.pixels) - 1)
        assert np.array_equal(pixels, images[of_image][source][piece.row, piece.column : last + 1 : step])
    assert pieces[-1][0].items() >= {"number": number, "flags": 0}.items()


REGIONS = [
    # columns, rows, step
    ((0, 4095), (0, 4095), 1),
    ((0, 39), (0, 5), 1),
    ((3, 3), (2, 2), 1),
    ((39, 39), (5, 5), 1),
    ((7, 30), (1, 4), 1),
    ((0, 4095), (0, 4095), 2),
    ((5, 38), (1, 5), 3),
    ((0, 4095), (0, 4095), 63),
]


@pytest.mark.parametrize(("columns", "rows", "step"), REGIONS)
def test_every_region_comes_as_the_reference_has_it(columns, rows, step):
    source = SnapshotSource((columns[0] + step) % 3)
    rng = np.random.default_rng(step)
    images = [random_image(rng, 6, 40) for _ in range(3)]
    pieces, busy = play(images, settings_of(source, columns, rows, step))
    check(pieces, images, source, columns, rows, step)
    assert busy[-1] == 0


@pytest.mark.parametrize(
    ("columns", "rows"), [((5, 4), (0, 4095)), ((0, 4095), (3, 2)), ((40, 50), (0, 4095)), ((0, 4095), (6, 9))]
)
def test_a_region_without_pixels_is_complete_at_once(columns, rows):
    images = [random_image(np.random.default_rng(1), 6, 40) for _ in range(3)]
    pieces, busy = play(images, settings_of(SnapshotSource.WEIGHT, columns, rows, 1))
    assert [header["pixels"] for header, _ in pieces] == [0]
    assert busy[-1] == 0


@pytest.mark.parametrize(("source", "stall", "count"), [(SnapshotSource.RAW, 0.9, 18), (SnapshotSource.WEIGHT, 0.0, 4)])
def test_wide_images_come_in_strips_however_slow_the_link(source, stall, count):
    width = 2 * SNAPSHOT_PIXELS + 17
    images = [random_image(np.random.default_rng(n), 3, width) for n in range(count)]
    pieces, busy = play(images, settings_of(source, (0, 4095), (0, 4095), 1), stall=stall)
    check(pieces, images, source, (0, 4095), (0, 4095), 1)
    assert busy[-1] == 0


def test_with_the_least_blanking_a_narrow_image_is_taken_at_once():
    images = [random_image(np.random.default_rng(n), SLOTS, 40) for n in range(2)]
    pieces, _ = play(images, settings_of(SnapshotSource.RAW, (0, 39), (0, SLOTS - 1), 1))
    assert {header["frame"] for header, _ in pieces} == {1000}


def test_while_the_link_stands_still_the_slots_fill_and_no_more():
    images = [random_image(np.random.default_rng(n), 12, 32) for n in range(4)]
    pieces, busy = play(images, settings_of(SnapshotSource.WEIGHT, (0, 31), (0, 11), 1), hold=12 * 48 + 64 + 40)
    check(pieces, images, SnapshotSource.WEIGHT, (0, 31), (0, 11), 1)
    frames = [header["frame"] for header, _ in pieces[:-1]]
    assert frames[:SLOTS] == [1000] * SLOTS
    assert min(frames[SLOTS:]) > 1000
    assert (busy[0], busy[-1]) == (1, 0)


def test_another_number_starts_anew_and_the_same_does_not():
    images = [random_image(np.random.default_rng(n), 6, 32) for n in range(6)]
    first = settings_of(SnapshotSource.RAW, (0, 31), (0, 5), 1)
    second = settings_of(SnapshotSource.GATE, (4, 20), (1, 5), 2, number=9)
    idle = settings_of(SnapshotSource.WEIGHT, (0, 31), (0, 5), 1, number=9)
    pieces, busy = play(images, first, changes=[(0, second), (3, idle)])
    old = [piece for piece in pieces if piece[0]["number"] == 1]
    assert 0 < len(old) < 6
    for header, pixels in old:
        assert np.array_equal(pixels, images[0][SnapshotSource.RAW][header["row"]])
    check(pieces[len(old) :], images, SnapshotSource.GATE, (4, 20), (1, 5), 2, number=9)
    assert busy == [1, 0, 0, 0, 0, 0]


def test_number_0_gives_up():
    images = [random_image(np.random.default_rng(n), 12, 32) for n in range(4)]
    pieces, busy = play(images, settings_of(SnapshotSource.RAW, (0, 31), (0, 11), 1), changes=[(0, {"snapshot": 0})])
    assert len(pieces) < SLOTS
    assert all(header["pixels"] for header, _ in pieces)
    assert busy == [0, 0, 0, 0]


def test_rows_that_broke_the_contract_are_marked():
    images = [random_image(np.random.default_rng(n), 3, 32) for n in range(3)]
    pieces, _ = play(images, settings_of(SnapshotSource.GATE, (4, 20), (0, 2), 1), faults=[0])
    assert [header["flags"] for header, _ in pieces] == [1, 1, 1, 0]


@pytest.mark.parametrize("seed", range(4))
def test_random_snapshots_one_after_the_other(seed):
    print("seed", seed)
    rng = np.random.default_rng(seed)
    rows, columns = int(rng.integers(1, 9)), int(rng.integers(16, 200))
    images = [random_image(rng, rows, columns) for _ in range(16)]
    wanted = []
    for number in (1, 2):
        region = [sorted(int(v) for v in rng.integers(0, size + 3, 2)) for size in (columns, rows)]
        wanted.append((SnapshotSource(int(rng.integers(3))), *map(tuple, region), int(rng.integers(1, 5)), number))
    changes = [(8, settings_of(*wanted[1]))]
    pieces, busy = play(
        images, settings_of(*wanted[0]), changes=changes, stall=float(rng.choice([0, 0.3, 0.6])), seed=seed
    )
    for source, *region, number in wanted:
        check([p for p in pieces if p[0]["number"] == number], images, source, *region, number)
    assert busy[7] == busy[-1] == 0
