"""The isolated-pixel filter: the reference by hand, the gateware against it, and images that break the contract."""

import itertools
from dataclasses import dataclass, field

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from gateware.camera.monitor import MIN_BLANKING, MIN_FRAME_GAP, MIN_ROW_PERIOD, Monitor
from gateware.layouts import FrameSettings, Video
from gateware.vision.isolate import Isolate
from gateware.vision.pixels import MeasuredPixel
from magtrak.reference import isolate
from tests.support.simulation import simulate

SEED = 2024
CARRIED = ("mix", "weight", "saturated", "fault")


def picture(text: str) -> np.ndarray:
    return np.array([[mark != "." for mark in line] for line in text.split()])


def test_reference_by_hand():
    gated = picture("#..## ...## .#... ..#.. ....#")
    assert (isolate(gated, 0) == gated).all()
    assert (isolate(gated, 1) == picture("...## ...## .#... ..#.. .....")).all()
    assert (isolate(gated, 3) == picture("...## ...## ..... ..... .....")).all()
    assert not isolate(gated, 4).any()
    full = np.ones((3, 4), bool)
    assert (isolate(full, 8) == picture(".... .##. ....")).all()
    assert (isolate(full, 4) == picture(".##. #### .##.")).all()
    assert (isolate(full[:1], 2) == picture(".##.")).all()
    assert (isolate(full[:, :1], 1) == full[:, :1]).all() and not isolate(full[:1, :1], 1).any()


@pytest.mark.parametrize("k", range(9))
def test_reference_is_the_definition(k):
    print("seed", SEED)
    gated = np.random.default_rng(SEED).random((9, 13)) < 0.6
    expected = np.zeros_like(gated)
    for y, x in zip(*np.nonzero(gated), strict=True):
        near = gated[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].sum() - 1
        expected[y, x] = near >= k
    assert (isolate(gated, k) == expected).all()


@dataclass
class Clock:
    """What comes in with one clock; ``k`` is the setting from then on."""

    pixel: dict[str, int] | None = None
    k: int | None = None


@dataclass
class Tape:
    """Images, clock by clock, when they end, and when each pixel came."""

    rng: np.random.Generator
    clocks: list[Clock] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    frames: list[list[list[tuple[int, dict[str, int]]]]] = field(default_factory=list)

    def idle(self, clocks: int) -> None:
        self.clocks += [Clock() for _ in range(clocks)]

    def row(self, gated: np.ndarray, *, top: bool, gap: float = 0, blanking: int | None = None) -> None:
        """Pixels of random contents and the blanking after them, by default the shortest that is allowed."""
        start = len(self.clocks)
        if top:
            self.frames.append([])
        self.frames[-1].append([])
        for x, gate in enumerate(gated):
            while x and self.rng.random() < gap:
                self.idle(1)
            pixel = {name: int(self.rng.integers(0, 256)) for name in ("mix", "weight")}
            pixel |= {"gate": int(gate), "saturated": int(self.rng.random() < 0.3)}
            pixel |= {"fault": int(self.rng.random() < 0.05)}
            pixel |= {
                "row_first": int(x == 0),
                "row_last": int(x == len(gated) - 1),
                "frame_first": int(top and x == 0),
            }
            self.frames[-1][-1].append((len(self.clocks), pixel))
            self.clocks.append(Clock(pixel))
        sent = len(self.clocks) - start
        self.idle(max(MIN_BLANKING, MIN_ROW_PERIOD - sent + 1) - 1 if blanking is None else blanking - 1)

    def image(self, rows, k: int, *, end: int | None = 0, frame_gap: int = MIN_FRAME_GAP, **how) -> None:
        """An image; ``frame_end`` comes ``end`` clocks after the last pixel, or not."""
        begin = len(self.clocks)
        for number, gated in enumerate(rows):
            self.row(gated, top=number == 0, **how)
        last = self.frames[-1][-1][-1][0]
        del self.clocks[last + 1 :]
        self.idle(frame_gap - 1)
        self.clocks[begin + 1].k = k
        if end is not None:
            self.ends.append(last + end)

    def play(self, max_columns: int = 64):
        """Frames as lists of rows of (clock, pixel), and the clocks at which they ended."""
        dut = Isolate(max_columns)
        out, ends = [], []

        async def testbench(ctx):
            clocks = [*self.clocks, *(Clock() for _ in range(max_columns + 100))]
            nothing = {"row_first": 1, "row_last": 1, "frame_first": 1, "gate": 1}
            ctx.set(dut.ahead.valid, clocks[0].pixel is not None)
            ctx.set(dut.ahead.p, clocks[0].pixel or nothing)
            await ctx.tick()
            for now, (clock, ahead) in enumerate(itertools.pairwise([*clocks, Clock()])):
                for port, item in ((dut.i, clock), (dut.ahead, ahead)):
                    ctx.set(port.valid, item.pixel is not None)
                    ctx.set(port.p, item.pixel or nothing)
                ctx.set(dut.i_frame_end, now in self.ends)
                if clock.k is not None:
                    ctx.set(dut.settings.isolate, clock.k)
                _, _, valid, pixel, ended = await ctx.tick().sample(dut.o.valid, dut.o.p, dut.o_frame_end)
                if valid:
                    out.append((now, {name: pixel[name] for name in pixel.shape().members}))
                if ended:
                    ends.append(now)

        simulate(dut, testbench, clocks=len(self.clocks) + max_columns + 200)
        return well_formed(out, ends), ends


def well_formed(out, ends):
    """Check the form that the blocks behind it need, and cut into frames and rows."""
    frames, row, starts, endings = [[]], None, [], []
    waiting = list(ends)
    for clock, pixel in out:
        while waiting and waiting[0] < clock + pixel["frame_first"]:
            assert row is None, "a frame ended within a row"
            waiting.pop(0)
            frames.append([])
        if pixel["row_first"]:
            assert row is None, "a row began within a row"
            assert not endings or clock - endings[-1] >= MIN_BLANKING
            assert pixel["frame_first"] == (not frames[-1])
            row = []
            starts.append(clock)
        assert row is not None, "a pixel between rows"
        assert pixel["row_first"] or not pixel["frame_first"]
        row.append((clock, pixel))
        if pixel["row_last"]:
            frames[-1].append(row)
            row = None
            endings.append(clock)
    assert row is None
    assert all(late - early >= MIN_ROW_PERIOD for early, late in zip(endings, endings[2:], strict=False))
    return frames + [[] for _ in waiting[1:]]


def check(frame, result, k: int) -> None:
    """A frame of whole rows against the reference."""
    gated = np.array([[pixel["gate"] for _, pixel in row] for row in frame], bool)
    got = np.array([[pixel["gate"] for _, pixel in row] for row in result], bool)
    np.testing.assert_array_equal(got, isolate(gated, k))
    for row, row_out in zip(frame, result, strict=True):
        for name in CARRIED:
            assert [pixel[name] for _, pixel in row] == [pixel[name] for _, pixel in row_out]


def clocks_of(frame) -> list[list[int]]:
    return [[clock for clock, _ in row] for row in frame]


def check_latency(frame, result) -> None:
    """Each pixel two clocks after its neighbour on the right of the row below, a row's last three after that one's."""
    sent, came = clocks_of(frame), clocks_of(result)
    for below, row in zip(sent[1:], came, strict=False):
        assert row == [clock + 2 for clock in below[1:]] + [below[-1] + Isolate.latency]
    assert np.diff(came[-1]).tolist() == [1] * (len(came[-1]) - 1)


def starts_apart(result) -> None:
    starts = [row[0][0] for row in result]
    assert (np.diff(starts) >= MIN_ROW_PERIOD).all()


@pytest.mark.parametrize("k", range(9))
def test_full_and_random_images(k):
    """Pixel after pixel with the shortest blanking, frame after frame: the last row goes out into the next frame."""
    rng = np.random.default_rng(SEED + k)
    print("seed", SEED + k)
    tape = Tape(rng)
    for rows, columns, end in ((3, 16, 0), (16, 16, 5), (5, 40, 0), (4, 40, 1), (2, 64, 20)):
        tape.image(rng.random((rows, columns)) < rng.choice([0.3, 0.6, 1.0]), k, end=end)
    frames, ends = tape.play()
    assert len(ends) == len(frames) == 5
    for frame, result in zip(tape.frames, frames, strict=True):
        check(frame, result, k)
        if k:
            check_latency(frame, result)
            starts_apart(result)
        else:
            assert clocks_of(result) == [[clock + Isolate.latency for clock in row] for row in clocks_of(frame)]
    for clock, result in zip(ends, frames, strict=True):
        assert k == 0 or clock == result[-1][-1][0] + 1
    if k == 0:
        assert ends == [clock + Isolate.latency for clock in tape.ends]


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 20), (4, 2), (1, 64)])
def test_smallest_images(shape):
    """One row, one column; also three frames of them in a row."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    for k in (1, 2):
        tape = Tape(rng)
        for end in (1, 3, MIN_FRAME_GAP):
            tape.image(rng.random(shape) < 0.8, k, end=end)
        tape.idle(100)
        frames, ends = tape.play()
        assert len(ends) == len(frames) == 3
        for frame, result in zip(tape.frames, frames, strict=True):
            check(frame, result, k)
            check_latency(frame, result)
            starts_apart(result)


def test_gaps_and_changes():
    """Random gaps between pixels and rows, another setting for each image, on and off."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    tape, settings = Tape(rng), []
    for _ in range(25):
        rows, columns = rng.integers(1, 7), 24
        settings.append(int(rng.choice([0, 0, 1, 2, 3, 5, 8])))
        tape.image(
            rng.random((rows, columns)) < rng.choice([0.2, 0.5, 0.9]),
            settings[-1],
            gap=float(rng.choice([0, 0, 0.3, 0.7])),
            end=int(rng.integers(0, 60)),
            blanking=None if rng.random() < 0.6 else int(rng.integers(48, 90)),
            frame_gap=int(rng.choice([64, 64, 80, 150])),
        )
    frames, ends = tape.play()
    assert len(ends) == len(frames) == len(settings)
    for k, frame, result in zip(settings, tape.frames, frames, strict=True):
        check(frame, result, k)


def test_turned_off():
    """The image after the last held one is still held if it comes before that has gone out; then all pass again."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    for frame_gap, held in ((MIN_FRAME_GAP, True), (2 * 40 + 32, False)):
        tape = Tape(rng)
        for k in (3, 0):
            tape.image(rng.random((3, 40)) < 0.7, k, frame_gap=frame_gap)
        tape.idle(200)
        tape.image(rng.random((3, 40)) < 0.7, 0)
        frames, _ = tape.play()
        for k, frame, result in zip((3, 0, 0), tape.frames, frames, strict=True):
            check(frame, result, k)
        if held:
            check_latency(tape.frames[1], frames[1])
        for at in [1, 2][held:]:
            assert clocks_of(frames[at]) == [
                [clock + Isolate.latency for clock in row] for row in clocks_of(tape.frames[at])
            ]


def rows_of(tape: Tape, result) -> None:
    """Every pixel that came out of a frame stands where it stood in that frame, and what is missing is flagged."""
    for frame, out in zip(tape.frames, result, strict=True):
        assert len(frame) == len(out)
        for row, row_out in zip(frame, out, strict=True):
            names = ("mix", "weight", "saturated")
            sent, came = ([[pixel[name] for name in names] for _, pixel in pixels] for pixels in (row, row_out))
            assert came == sent[: len(came)]
            assert len(came) == len(sent) or row_out[-1][1]["fault"]


def test_rows_of_different_length():
    """A row ends with a shorter one below it, flagged; a longer one is whole. By hand: all pixels are gated."""
    tape = Tape(np.random.default_rng(SEED))
    for number, length in enumerate((20, 12, 30, 30)):
        tape.row(np.ones(length), top=number == 0)
    tape.clocks[1].k = 6
    tape.idle(MIN_FRAME_GAP)
    tape.ends.append(len(tape.clocks) - 1)
    tape.idle(100)
    tape.image(np.ones((2, 20)), 6)
    frames, ends = tape.play()
    rows_of(tape, frames)
    assert [len(row) for row in frames[0]] == [12, 12, 30, 30] and len(ends) == 2
    gates = ["".join(".#"[pixel["gate"]] for _, pixel in row) for row in frames[0]]
    # Up to two neighbours of its own row, and three of each row that reaches so far.
    assert gates == ["." * 12, "." + "#" * 11, "." + "#" * 12 + "." * 17, "." * 30]


def test_next_image_shorter():
    """The last row of a long image is cut where the next image's first row ends; nothing else is."""
    for length in (1, 10, 15, 16, 64):
        tape = Tape(np.random.default_rng(SEED))
        for columns, k in ((64, 2), (length, 2), (64, 0)):
            tape.image(np.ones((3, columns)), k)
        frames, ends = tape.play()
        rows_of(tape, frames)
        assert len(ends) == 3
        # It begins 16 clocks after the row, the next image 64, and 16 more have to be left before that one's rows.
        assert len(frames[0][-1]) == min(64, MIN_FRAME_GAP - MIN_BLANKING + length)
        assert frames[1][-1][-1][1]["row_last"] and len(frames[1][-1]) == length


@pytest.mark.parametrize("end", [0, MIN_BLANKING])
def test_next_image_at_once(end):
    """As early as the monitor lets it begin after a late row: the last row goes out ahead of what overwrites it."""
    rng = np.random.default_rng(SEED)
    tape = Tape(rng)
    for frame_gap in (MIN_BLANKING, MIN_BLANKING, 100):
        tape.image(rng.random((2, 20)) < 0.6, 2, end=end, frame_gap=frame_gap)
    frames, ends = tape.play()
    assert len(ends) == 3
    for frame, result in zip(tape.frames, frames, strict=True):
        check(frame, result, 2)


def test_images_without_rows():
    """Their ends come out after the row that was on its way, and before the next image."""
    rng = np.random.default_rng(SEED)
    tape = Tape(rng)
    tape.image(rng.random((2, 40)) < 0.5, 2, frame_gap=90)
    tape.ends += [len(tape.clocks) - 70, len(tape.clocks) - 60]
    tape.image(rng.random((2, 40)) < 0.5, 2, frame_gap=200)
    tape.ends += [len(tape.clocks) - 10]
    tape.image(rng.random((2, 40)) < 0.5, 2)
    frames, ends = tape.play()
    assert [len(frame) for frame in frames] == [2, 0, 0, 2, 0, 2] and len(ends) == 6


class Watched(wiring.Component):
    """The filter behind the monitor, and what it is given."""

    settings: In(FrameSettings)
    video: In(Video())
    given: Out(stream.Signature(MeasuredPixel, always_ready=True))
    given_end: Out(1)
    o: Out(stream.Signature(MeasuredPixel, always_ready=True))
    o_frame_end: Out(1)

    def elaborate(self, platform):
        m = Module()
        m.submodules.monitor = monitor = Monitor(32, 8)
        m.submodules.dut = dut = Isolate(32)
        wiring.connect(m, monitor.video, wiring.flipped(self.video))
        wiring.connect(m, dut.o, wiring.flipped(self.o))
        pixel, ahead = monitor.pixel.p, dut.ahead.p
        m.d.sync += [
            dut.i.valid.eq(dut.ahead.valid),
            dut.i.p.eq(ahead),
            dut.i_frame_end.eq(monitor.frame_end),
        ]
        m.d.comb += [
            dut.settings.eq(self.settings),
            dut.ahead.valid.eq(monitor.pixel.valid),
            ahead.mix.eq(pixel.r),
            ahead.weight.eq(pixel.g),
            ahead.gate.eq(pixel.b[0]),
            self.given.valid.eq(dut.i.valid),
            self.given.p.eq(dut.i.p),
            self.given_end.eq(dut.i_frame_end),
            self.o_frame_end.eq(dut.o_frame_end),
        ]
        for name in ("row_first", "row_last", "frame_first", "fault"):
            m.d.comb += ahead[name].eq(pixel[name])
        return m


class Rows:
    """Frames of rows, from pixels and ends."""

    def __init__(self) -> None:
        self.frames: list[list[list]] = [[]]

    def take(self, valid, pixel, end) -> None:
        if end and valid and pixel.frame_first:
            self.frames.append([])
        if valid:
            assert pixel.frame_first == (pixel.row_first and not self.frames[-1])
            if pixel.row_first:
                assert not self.frames[-1] or self.frames[-1][-1][-1].row_last
                self.frames[-1].append([])
            self.frames[-1][-1].append(pixel)
        if end and not (valid and pixel.frame_first):
            assert not self.frames[-1] or self.frames[-1][-1][-1].row_last
            self.frames.append([])


def test_noise_through_the_monitor():
    """Whatever the camera does, each frame comes out with its own rows in order; what is cut is flagged."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    dut = Watched()
    given, out = Rows(), Rows()

    async def testbench(ctx):
        calm = True
        for now in range(12_000):
            if now % 300 == 0:
                calm = rng.random() < 0.7
                ctx.set(dut.settings.isolate, int(rng.choice([0, 1, 4])))
            shares = (0.9, 0.02, 0.03, 0.3, 0.003) if calm else (0.7, 0.1, 0.2, 0.3, 0.05)
            quiet = now % 300 > 240 and calm
            valid, row_first, row_last, frame_first, end = (int(rng.random() < share and not quiet) for share in shares)
            flags = {"row_first": row_first, "row_last": row_last, "frame_first": row_first & frame_first}
            ctx.set(dut.video.pixel.valid, valid)
            ctx.set(dut.video.pixel.p, {"r": now & 255, "g": now >> 8, "b": int(rng.integers(0, 2)), **flags})
            ctx.set(dut.video.frame_end, end)
            values = (dut.given.valid, dut.given.p, dut.given_end, dut.o.valid, dut.o.p, dut.o_frame_end)
            _, _, *sampled = await ctx.tick().sample(*values)
            given.take(*sampled[:3])
            out.take(*sampled[3:])

    simulate(dut, testbench, clocks=13_000)
    assert len(given.frames) > 50
    assert len(given.frames) - len(out.frames) <= 3  # on the way
    whole = cut = 0
    for frame, result in zip(given.frames, out.frames[:-1], strict=False):
        assert len(frame) == len(result)
        for row, row_out in zip(frame, result, strict=True):
            sent, came = ([(pixel.mix, pixel.weight) for pixel in pixels] for pixels in (row, row_out))
            assert came == sent[: len(came)]
            assert len(came) == len(sent) or row_out[-1].fault
            whole += len(came) == len(sent)
            cut += len(came) != len(sent)
    print(whole, "rows whole,", cut, "cut")
    assert whole > 40 and cut > 4
