"""Frames through buffer and assembler: what is sent is what was measured, whole and in order."""

import random
from collections import defaultdict
from enum import EnumMeta
from itertools import pairwise

import pytest
from amaranth.hdl import Module, Shape
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from gateware.frame.admission import APART_CLOCKS
from gateware.frame.assembler import FrameAssembler
from gateware.frame.buffer import FrameBuffer
from gateware.frame.facts import STEADY_CLOCKS, ImageFacts, MotionFacts, StartFacts, VisionFacts
from gateware.layouts import Packets
from gateware.motion.angle import FIRST_CLOCKS
from magtrak.protocol import COMPACT_ROW, EDGE, FRAME, FRAME_FLAGS, FULL_ROW, FieldParity, Phase, RowForm
from tests.support.simulation import simulate

MAX_ROWS = 16
LIMITS = {RowForm.FULL: MAX_ROWS, RowForm.COMPACT: 4 * MAX_ROWS}
EMPTY = dict.fromkeys((f.name for f in FULL_ROW.fields if not f.reserved), 0)
SHORTEST = 112  # clocks from image to image


class Chain(wiring.Component):
    """A buffer whose frames are sent."""

    def __init__(self, *, edge_log=True, close_images=True):
        self.edge_log = edge_log
        self.buffer = FrameBuffer(MAX_ROWS, edge_log=edge_log, close_images=close_images)
        members = dict(self.buffer.signature.members)
        del members["reader"], members["moving"]
        super().__init__({**members, "o": Out(Packets)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.buffer = buffer = self.buffer
        m.submodules.assembler = assembler = FrameAssembler(MAX_ROWS, edge_log=self.edge_log)
        connect(m, buffer.reader, assembler.i)
        connect(m, flipped(self.o), assembler.o)
        connect(m, flipped(self.rows), buffer.rows)
        m.d.comb += buffer.moving.eq(self.o.valid & self.o.ready)
        for name, member in self.signature.members.items():
            if name in ("o", "rows"):
                continue
            inner, outer = getattr(buffer, name), getattr(self, name)
            m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
        return m


def any_record(rng, layout):
    """Random values of a protocol layout, the limits often among them."""
    return {f.name: rng.choice([*f.range, rng.randint(*f.range)]) for f in layout.fields if not f.reserved}


def any_facts(rng, shape):
    """Random values of a struct."""
    values = {}
    for name, field in data.Layout.cast(shape):
        if name == "edges":
            values[name] = rng.choice([0, 1, 15, 16, rng.randrange(17)])
        elif isinstance(field.shape, EnumMeta):
            values[name] = rng.choice(list(field.shape))
        elif isinstance(field.shape, (int, range, Shape)):
            shape = Shape.cast(field.shape)
            values[name] = rng.randrange(1 << shape.width) - (shape.signed << shape.width - 1)
        else:
            values[name] = any_facts(rng, field.shape)
    return values


FLAGS = ("laser_on", "speed_in_band", "motor_stopped")
"""Facts of the image that are flags of its header."""


class Image:
    """One image: everything that the header and the rows are to say."""

    def __init__(self, rng, rows, form=None):
        self.form = rng.choice(list(RowForm)) if form is None else form
        self.limit = LIMITS[self.form]
        self.rows = [any_record(rng, FULL_ROW) | {"position": rng.randrange(1 << 19)} for _ in range(rows)]
        self.rows = [row if row["valid"] else EMPTY | {"overflow": row["overflow"]} for row in self.rows]
        self.start = any_facts(rng, StartFacts)
        self.image = any_facts(rng, ImageFacts)
        self.motion = any_facts(rng, MotionFacts)
        self.vision = any_facts(rng, VisionFacts)
        self.vision["errors"] |= {"rows": int(rows > self.limit), "_reserved": 0}
        self.edges = [any_record(rng, EDGE) for _ in range(16)]
        self.lost = False  # not all rows could be written

    def payload(self, number, dropped, damaged=7, lost=9):
        """The definition of what is sent of it."""
        # Images that were not measured have no rows to send.
        sent = self.rows[: self.limit] if self.image["phase"] in (Phase.MEASURED, Phase.UNSUBTRACTED) else []
        errors = sum(bit << n for n, bit in enumerate(self.vision["errors"].values()))
        encoder = self.motion["encoder_errors"]
        field = self.image["field"].value
        flags = FRAME_FLAGS.pack(
            {
                "index_seen": self.motion["index_seen"],
                "speed_in_band": self.image["speed_in_band"],
                "laser_on": self.image["laser_on"],
                "motor_stopped": self.image["motor_stopped"],
                "encoder_fault": self.motion["encoder_fault"],
                "camera_fault": int(errors != 0),
                "rows_lost": int(self.lost or len(self.rows) > self.limit),
            }
        )
        header = {
            **self.start,
            **{name: value for name, value in self.image.items() if name not in FLAGS},
            "field": field,
            **{name: self.motion[name] for name in ("edges", "edge_shift", "index_passes", "index_count")},
            **{f"first_{name}": value for name, value in self.motion["first"].items()},
            **{f"last_{name}": value for name, value in self.motion["last"].items()},
            "form": int(self.form),
            "frame": number,
            "flags": int.from_bytes(flags, "little"),
            "camera_errors": errors,
            "rows": len(sent),
            "first_row": int(field == FieldParity.ODD),
            "row_step": 1 if field == FieldParity.PROGRESSIVE else 2,
            "line_errors": lost,
            "columns": self.vision["columns"],
            "dropped": dropped,
            "encoder_errors": encoder["illegal"] | encoder["turns"] << 16,
            "damaged_commands": damaged,
        }
        edges = b"".join(EDGE.pack(edge) for edge in self.edges[: self.motion["edges"]])
        if self.form == RowForm.FULL:
            rows = b"".join(FULL_ROW.pack(row) for row in sent)
        else:
            rows = b"".join(COMPACT_ROW.pack(FrameAssembler.reference(row)) for row in sent)
        return FRAME.pack(header) + edges + rows


def play(
    images,
    *,
    ready=lambda clock: True,
    row_clocks=34,
    gap=2,
    after=600,
    damaged=7,
    lost=9,
    delays=(20, 6),
    late=0,
    pause=16,
    payload_of=Image.payload,
):
    """Send ``images`` through.

    Results of odd rows come ``late`` clocks earlier than they should; rows that are None have none. Results of an image
    end ``pause`` clocks after where one more would be.

    Gives the payloads that came out, what these had to be according to the images that they say they are, and the
    counters of images and of dropped ones. Stops after the last image when nothing came for ``after`` clocks. Results
    come ``delays[0]`` clocks late, the motion ``delays[1]``.
    """
    dut = Chain()
    payloads, expected = [], {}
    counters = []
    events = defaultdict(list)  # by clock: what is set in that clock only, in order
    ends = {}  # clock of frame_end: the image's number
    at = 1
    for number, image in enumerate(images):
        events[at] += [(dut.frame_first, 1), (dut.form, int(image.form))]
        for when in range(at + 1, at + 1 + STEADY_CLOCKS):
            events[when].append((dut.start, image.start))
        end = at + max(len(image.rows) * row_clocks + 2, SHORTEST - gap)
        for row, record in enumerate(image.rows):
            when = at + (row + 1) * row_clocks + delays[0] - late * (row % 2)
            if record is None:
                continue
            events[when] += [(dut.rows.row.valid, 1), (dut.rows.row.payload, {"row": row, "record": record})]
        events[end] += [(dut.frame_end, 1), (dut.image, image.image)]
        ends[end] = number
        events[end + delays[0] + pause] += [(dut.rows.frame_end, 1), (dut.vision, image.vision)]
        at = end + gap

    async def drive(ctx):
        ctx.set(dut.damaged_commands, damaged)
        ctx.set(dut.line_errors, lost)
        log, index, current, quiet = None, 0, bytearray(), 0
        clock = 0
        while clock < at or quiet < after:
            for strobe in (dut.frame_first, dut.rows.row.valid, dut.frame_end, dut.rows.frame_end, dut.taken):
                ctx.set(strobe, 0)
            # Outside the moments at which they are sampled the facts are something else.
            ctx.set(dut.form, clock & 1)
            for facts in (dut.start, dut.image, dut.vision, dut.motion):
                ctx.set(facts, facts.shape().from_bits(clock & 0x3F))
            ctx.set(dut.edge, log[index] if log else {})
            for target, value in events.pop(clock, ()):
                if target is dut.motion:
                    image, number = value
                    ctx.set(dut.motion, image.motion)
                    log = image.edges
                    expected[number] = payload_of(image, number, ctx.get(dut.dropped), damaged, lost)
                else:
                    ctx.set(target, value)
            if ctx.get(dut.take):
                image = images[ends[clock]]
                events[clock + delays[1]] += [(dut.taken, 1), (dut.motion, (image, ends[clock]))]
            index = ctx.get(dut.edge_index)
            ctx.set(dut.o.ready, ready(clock))
            _, _, taken, valid, item = await ctx.tick().sample(dut.o.ready, dut.o.valid, dut.o.payload)
            quiet = 0 if clock < at or (taken and valid) else quiet + 1
            if taken and valid:
                current.append(item.data)
                if item.last:
                    payloads.append(bytes(current))
                    current.clear()
            clock += 1
        assert not current, "a frame without end"
        counters.extend([ctx.get(dut.frames), ctx.get(dut.dropped)])

    simulate(dut, drive, clocks=2 * (at + after) + 1_000_000)
    return payloads, [expected[number] for number in numbers_of(payloads)], *counters


def numbers_of(payloads):
    """Numbers of the images that were sent; they rise."""
    numbers = [FRAME.unpack(payload[: FRAME.size])["frame"] for payload in payloads]
    assert numbers == sorted(set(numbers))
    return numbers


@pytest.mark.parametrize("edge_log", [False, True])
@pytest.mark.parametrize(("delay", "filled"), [(8, 40), (262, 40), (8, 60)])
def test_images_that_are_not_close_need_nothing_kept_but_the_first_stamp(edge_log, delay, filled):
    """Strobes of motion come ``delay`` clocks late, that of the rows ``filled`` clocks after the image's end.

    Each thing is what it should be only as long as the card keeps it.
    """
    rng = random.Random(delay + filled)
    images = [Image(rng, rows) for rows in (0, 3, 5, 9)]
    dut = Chain(edge_log=edge_log, close_images=False)
    events = defaultdict(list)
    expected, payloads = [], []
    at = 1
    for number, image in enumerate(images):
        if not edge_log:
            image.motion |= {"edges": 0}
        end = at + max(len(image.rows) * 34 + 2, SHORTEST)
        first = image.motion | {"last": image.motion["first"], "first": any_facts(rng, MotionFacts)["first"]}
        events[at] += [(dut.frame_first, 1), (dut.form, int(image.form))]
        events[at + 1] += [(dut.start, image.start)]
        events[at + 1 + delay] += [(dut.first_is_last, 1), (dut.motion, first)]
        events[at + 1 + delay + FIRST_CLOCKS] += [(dut.motion, image.motion | {"first": first["first"]})]
        for row, record in enumerate(image.rows):
            payload = {"row": row, "record": record}
            events[at + (row + 1) * 34 + 20] += [(dut.rows.row.valid, 1), (dut.rows.row.payload, payload)]
        events[end] += [(dut.frame_end, 1), (dut.image, image.image)]
        events[end + filled] += [(dut.rows.frame_end, 1), (dut.vision, image.vision)]
        events[end + delay] += [(dut.taken, 1)]
        expected.append(image.payload(number, 0))
        at = end + APART_CLOCKS + 1

    async def drive(ctx):
        ctx.set(dut.damaged_commands, 7)
        ctx.set(dut.line_errors, 9)
        ctx.set(dut.o.ready, 1)
        current, index, number = bytearray(), 0, -1
        for clock in range(at + 4000):
            for strobe in (dut.frame_first, dut.rows.row.valid, dut.frame_end, dut.rows.frame_end, dut.taken):
                ctx.set(strobe, 0)
            ctx.set(dut.first_is_last, 0)
            ctx.set(dut.image, ImageFacts.from_bits(clock & 0x3F))
            for target, value in events.pop(clock, ()):
                ctx.set(target, value)
                number += target is dut.taken
            ctx.set(dut.edge, images[number].edges[index] if number >= 0 else {})
            index = ctx.get(dut.edge_index)
            _, _, valid, item = await ctx.tick().sample(dut.o.valid, dut.o.payload)
            if valid:
                current.append(item.data)
                if item.last:
                    payloads.append(bytes(current))
                    current.clear()

    simulate(dut, drive, clocks=at + 5000)
    assert payloads == expected


@pytest.mark.parametrize("form", RowForm)
@pytest.mark.parametrize("rows", [0, 1, 2, MAX_ROWS - 1, MAX_ROWS, MAX_ROWS + 1, MAX_ROWS + 9])
def test_one_frame_of_each_size(form, rows):
    if form is RowForm.COMPACT and rows > 2:
        rows += LIMITS[form] - MAX_ROWS
    image = Image(random.Random(rows), rows, form)
    payloads, expected, frames, dropped = play([image])
    assert (frames, dropped) == (1, 0)
    assert payloads == expected == [image.payload(0, 0, 7)]


@pytest.mark.parametrize("seed", range(2))
def test_frames_follow_each_other_without_loss_when_they_are_taken(seed):
    print("seed", seed)
    rng = random.Random(seed)
    images = [Image(rng, rng.randrange(1, MAX_ROWS + 3), RowForm.COMPACT) for _ in range(12)]
    payloads, expected, frames, dropped = play(images, row_clocks=48, gap=700)
    assert (frames, dropped) == (12, 0)
    assert payloads == expected
    assert len(payloads) == 12


@pytest.mark.parametrize("seed", range(4))
def test_frames_are_dropped_whole_when_the_link_is_slow(seed):
    print("seed", seed)
    rng = random.Random(100 + seed)
    images = [Image(rng, rng.choice([1, 2, rng.randrange(1, MAX_ROWS + 3)])) for _ in range(40)]
    share = [0.05, 0.3, 0.7, 1.0][seed]
    ready = random.Random(seed)
    payloads, expected, frames, dropped = play(
        images,
        ready=lambda clock: ready.random() < share,
        row_clocks=32,
        gap=[1, 64][seed % 2],
        after=3000,
        delays=[(0, 1), (60, 1), (0, 260), (60, 260)][seed],
    )
    assert payloads == expected
    assert frames == 40
    assert len(payloads) + dropped == 40
    assert dropped > 0


@pytest.mark.parametrize("until", [4500, 4630, 4760])
def test_after_a_link_that_stood_still_the_newest_image_comes_next(until):
    """However the end of the pause lies to the images, which come every 394 clocks and take 305 to be complete."""
    rng = random.Random(9)
    images = [Image(rng, 4, RowForm.COMPACT) for _ in range(16)]
    payloads, expected, frames, dropped = play(
        images, ready=lambda clock: not 1500 < clock < until, row_clocks=48, gap=200, after=600
    )
    assert payloads == expected
    numbers = numbers_of(payloads)
    assert (frames, len(numbers) + dropped) == (16, 16)
    assert numbers[-1] == 15
    # Up to the gap comes what was under way, then an image that was the newest when the pause ended, or a later one.
    newest = next(after for before, after in pairwise(numbers) if after > before + 1)
    assert newest >= (until - 305) // 394


FLAGGED = EMPTY | {"overflow": 1}


@pytest.mark.parametrize("form", RowForm)
@pytest.mark.parametrize("given", [[0, 1, 9], [3, 4], [0, 2, 15]])
def test_rows_without_a_result_have_no_line(form, given):
    """The bank has rows of an earlier image at their places, which are not to be taken for this image's."""
    rng = random.Random(5)
    images = [Image(rng, rows, form) for rows in (LIMITS[form], LIMITS[form], given[-1] + 1)]
    for image in images:
        image.image["phase"] = Phase.MEASURED
    rows = images[-1].rows
    images[-1].rows = [row if at in given else None for at, row in enumerate(rows)]
    payloads, expected, frames, dropped = play(images, gap=6000, payload_of=filled)
    assert (frames, dropped) == (3, 0)
    assert payloads == expected


def filled(image, *facts):
    """The payload of an image with rows that have no result."""
    image.rows = [FLAGGED if row is None else row for row in image.rows]
    return image.payload(*facts)


@pytest.mark.parametrize("form", RowForm)
def test_a_result_right_behind_another_one_is_kept_as_a_row_without_a_line(form):
    def late(image, *facts):
        image.rows = [FLAGGED if at % 2 else row for at, row in enumerate(image.rows)]
        return image.payload(*facts)

    image = Image(random.Random(6), 6, form)
    image.image["phase"] = Phase.MEASURED
    payloads, expected, *_ = play([image], late=33, payload_of=late)
    assert payloads == expected
    assert len(payloads) == 1


def test_what_is_not_written_when_the_results_end_is_left_out_and_told():
    def cut(image, *facts):
        image.rows, image.lost = image.rows[:-1], True
        return image.payload(*facts)

    images = [Image(random.Random(7), rows, RowForm.FULL) for rows in (6, 7)]
    for image in images:
        image.image["phase"] = Phase.MEASURED
    payloads, expected, *_ = play(images, gap=2000, pause=0, payload_of=cut)
    assert payloads == expected
    assert [FRAME.unpack(payload[: FRAME.size])["rows"] for payload in payloads] == [5, 6]


def test_a_size_that_is_no_power_of_two_is_refused():
    for rows in (0, 1, 48):
        with pytest.raises(ValueError, match=f"max_rows is {rows}"):
            FrameBuffer(rows)
