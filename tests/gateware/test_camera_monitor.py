"""The camera's contract: images that keep it, every way to break it, and noise on the wires."""

import random

import pytest

from gateware.camera.monitor import MIN_BLANKING, MIN_FRAME_GAP, MIN_ROW_PERIOD, Monitor
from magtrak.protocol import CAMERA_ERRORS
from tests.support.simulation import simulate

ERRORS = [field.name for field in CAMERA_ERRORS.fields if not field.reserved]
FLAGS = ("row_first", "row_last", "frame_first")
COLUMNS, ROWS = 20, 4


class Tape:
    """What a camera sends, clock by clock: ``(valid, flags, frame_end)``; pixels are numbered by ``r``."""

    def __init__(self) -> None:
        self.clocks: list[dict[str, int]] = []

    def idle(self, clocks: int = 1, **flags: int) -> "Tape":
        self.clocks += [{"valid": 0, **flags}] * clocks
        return self

    def pixel(self, **flags: int) -> "Tape":
        self.clocks.append({"valid": 1, **flags})
        return self

    def row(
        self, columns: int = COLUMNS, *, frame: int = 0, open_end: bool = False, blanking: int | None = None, **last
    ):
        """A row and the blanking after it, by default the shortest that the contract allows."""
        for column in range(columns):
            ends = column == columns - 1
            self.pixel(
                row_first=column == 0,
                row_last=ends and not open_end,
                frame_first=frame and column == 0,
                **(last if ends else {}),
            )
        if blanking is None:
            blanking = max(MIN_BLANKING, MIN_ROW_PERIOD - columns + 1)
        return self.idle(blanking - 1)

    def frame(self, rows: int = 3, columns: int = COLUMNS) -> "Tape":
        for row in range(rows):
            self.row(columns, frame=row == 0)
        return self.end()

    def end(self, gap: int = MIN_FRAME_GAP) -> "Tape":
        self.idle(1, frame_end=1)
        return self.idle(gap)


def play(tape: Tape, max_columns: int = 32, max_rows: int = ROWS):
    """Frames as lists of rows of pixels, the report of each, errors since reset; the same from a fast one."""
    plain = _play(Monitor(max_columns, max_rows), tape)
    fast = _play(Monitor(max_columns, max_rows, fast=True), tape)
    assert fast == plain
    out, ends, reports, ever = plain
    return well_formed(out, ends, max_columns, max_rows), reports, ever[0]


def _play(dut: Monitor, tape: Tape):
    """Pixels and ends of frames, as of the clock they came in, reports, errors since reset."""
    out, ends, reports, ever = [], [], [], []

    async def testbench(ctx):
        ended, sizes = [False] * dut.latency, []
        pixels = []
        for clock, item in enumerate([*tape.clocks, *({"valid": 0},) * 4]):
            pixel = {"r": clock % 255 + 1, "g": 0, "b": 0} | {flag: item.get(flag, 0) for flag in FLAGS}
            pixels.append(pixel)
            ctx.set(dut.video.pixel.p, pixel)
            ctx.set(dut.video.pixel.valid, item["valid"])
            ctx.set(dut.video.frame_end, item.get("frame_end", 0))
            await ctx.tick()
            if ended[-1]:
                sizes.append((ctx.get(dut.rows), ctx.get(dut.columns)))
            if ended[0]:
                errors = ctx.get(dut.errors)
                reports.append(({name for name in ERRORS if errors[name]}, *sizes[len(reports)]))
            if ctx.get(dut.pixel.valid):
                sent = ctx.get(dut.pixel.p)
                assert sent.r in (0, pixels[-dut.latency]["r"]), f"latency is not {dut.latency}"
                out.append((clock + 1 - dut.latency, sent))
            ended = [*ended[1:], ctx.get(dut.frame_end)]
            if ended[-1]:
                ends.append(clock + 1 - dut.latency)
        errors = ctx.get(dut.errors_ever)
        ever.append({name for name in ERRORS if errors[name]})

    simulate(dut, testbench, clocks=len(tape.clocks) + 20)
    return out, ends, reports, ever


def well_formed(out, ends, max_columns, max_rows):
    """Check the form that the monitor promises, and cut into frames and rows."""
    frames, row, endings, first_clock = [], None, [-999, -999], None
    waiting = sorted(ends)
    for clock, pixel in out:
        while waiting and waiting[0] < clock + pixel.frame_first:
            assert row is None, "a frame ended within a row"
            waiting.pop(0)
            first_clock = None
        if pixel.row_first:
            assert row is None, "a row began within a row"
            assert clock - endings[-1] >= MIN_BLANKING
            assert pixel.frame_first == (first_clock is None), "frame_first marks the first row of a frame"
            if pixel.frame_first:
                frames.append([])
                first_clock = clock
            row = []
        assert row is not None, "a pixel between rows"
        row.append(pixel)
        assert len(row) <= max_columns
        if pixel.row_last:
            frames[-1].append(row)
            assert len(frames[-1]) <= max_rows
            row = None
            assert clock - endings[-2] >= MIN_ROW_PERIOD, "the divider needs time"
            endings.append(clock)
    return frames


def faults(frame) -> list[bool]:
    return [any(pixel.fault for pixel in row) for row in frame]


def lengths(frame) -> list[int]:
    return [len(row) for row in frame]


def test_contract_kept():
    tape = Tape().frame().frame(rows=ROWS, columns=32).frame(rows=1, columns=16)
    frames, reports, ever = play(tape)
    assert [lengths(frame) for frame in frames] == [[20] * 3, [32] * 4, [16]]
    assert not any(fault for frame in frames for fault in faults(frame))
    assert reports == [(set(), 3, 20), (set(), 4, 32), (set(), 1, 16)]
    assert ever == set()


def test_pixels_pass_unchanged():
    tape = Tape()
    tape.pixel(row_first=1, frame_first=1).idle(3).pixel().idle(2).pixel(row_last=1, frame_end=1).idle(70)
    frames, reports, _ = play(tape)
    assert [pixel.r for pixel in frames[0][0]] == [1, 5, 8]
    assert reports == [(set(), 1, 3)]


def test_frame_end_with_last_pixel():
    frames, reports, _ = play(Tape().row(frame=1).row(frame_end=1).idle(70).frame())
    assert [lengths(frame) for frame in frames] == [[20, 20], [20] * 3]
    assert reports == [(set(), 2, 20), (set(), 3, 20)]


def test_middle_of_an_image_after_reset():
    """A card that is switched on in the middle of an image waits for the next one, and finds no fault."""
    tape = Tape().pixel().pixel().pixel(row_last=1).idle(30).row().row().end().frame()
    frames, reports, ever = play(tape)
    assert [lengths(frame) for frame in frames] == [[20] * 3]
    assert reports == [(set(), 3, 20)]
    assert ever == set()


def test_blanking_too_short():
    """The next row loses the pixels of the missing time; the row before is whole."""
    tape = Tape().row(40, frame=1, blanking=10).row(40).row(40).end()
    frames, reports, ever = play(tape, max_columns=64)
    assert lengths(frames[0]) == [40, 34, 40]
    assert faults(frames[0]) == [False, True, False]
    assert reports[0][0] == ever == {"blanking"}


def test_row_period_too_short():
    tape = Tape().row(20, frame=1, blanking=20).row(20).end()
    frames, reports, _ = play(tape)
    assert lengths(frames[0]) == [20, 20 - (MIN_ROW_PERIOD - 39)]
    assert faults(frames[0]) == [False, True]
    assert reports[0] == ({"row_period"}, 2, 20)


def test_row_lost():
    """A row that is over before it may start is not sent; from then on no row of the frame is sure of its number."""
    tape = Tape().row(20, frame=1, blanking=4).row(5).row(20).row(20).end().frame()
    frames, reports, _ = play(tape)
    assert lengths(frames[0]) == [20, 20, 20]
    assert faults(frames[0]) == [False, True, True]
    assert reports[0] == ({"blanking", "row_period", "row_length"}, 3, 20)
    assert reports[1] == (set(), 3, 20) and not any(faults(frames[1]))


def test_frame_gap_too_short():
    tape = Tape().row(frame=1).idle(1, frame_end=1).idle(5).frame(2)
    frames, reports, _ = play(tape)
    assert [lengths(frame) for frame in frames] == [[20], [20, 20]]
    assert reports == [(set(), 1, 20), ({"frame_gap"}, 2, 20)]


def test_rows_of_different_length():
    frames, reports, _ = play(Tape().row(20, frame=1).row(21).row(20).end().frame())
    assert lengths(frames[0]) == [20, 21, 20]
    assert reports == [({"row_length"}, 3, 20), (set(), 3, 20)]


def test_too_many_columns():
    frames, reports, _ = play(Tape().row(40, frame=1).row(32).end().frame())
    assert lengths(frames[0]) == [32, 32]
    assert faults(frames[0]) == [True, False]
    assert reports[0] == ({"columns"}, 2, 32)
    assert reports[1][0] == set()


def test_too_many_rows():
    frames, reports, _ = play(Tape().frame(rows=ROWS + 2).frame())
    assert lengths(frames[0]) == [20] * ROWS
    assert reports == [({"rows"}, ROWS, 20), (set(), 3, 20)]


def test_row_without_end():
    """A black pixel ends it, in place of the first of the next row."""
    frames, reports, _ = play(Tape().row(frame=1, open_end=True).row(40).row().end(), max_columns=64)
    assert faults(frames[0]) == [True, True, False]
    assert lengths(frames[0]) == [21, 40 - MIN_BLANKING, 20]
    assert frames[0][0][-1].r == 0
    assert "framing" in reports[0][0]


def test_row_without_end_at_the_end_of_the_frame():
    for tape in (
        Tape().row(frame=1).row(open_end=True).end(),
        Tape().row(frame=1).row(open_end=True, frame_end=1).idle(70),
    ):
        frames, reports, _ = play(tape.frame())
        assert faults(frames[0]) == [False, True]
        assert reports == [({"framing"}, 2, 20), (set(), 3, 20)]


def test_frame_without_end():
    frames, reports, ever = play(Tape().row(frame=1).row().idle(70).frame())
    assert [lengths(frame) for frame in frames] == [[20, 20], [20] * 3]
    assert reports == [({"framing"}, 2, 20), (set(), 3, 20)]
    assert ever == {"framing"}


def test_pixels_between_rows_and_frames():
    tape = Tape().row(frame=1, blanking=30).pixel().pixel(row_last=1).idle(60).row().end()
    frames, reports, _ = play(tape)
    assert lengths(frames[0]) == [20, 20]
    assert reports == [({"framing"}, 2, 20)]
    frames, reports, _ = play(Tape().frame().row().idle(70).frame())
    assert [lengths(frame) for frame in frames] == [[20] * 3, [20] * 3]
    assert reports[1][0] == {"framing"}


def test_second_frame_end():
    _, reports, ever = play(Tape().frame().end())
    assert len(reports) == 1
    assert ever == {"framing"}


@pytest.mark.parametrize("seed", range(6))
def test_noise(seed):
    """Whatever comes in, what goes out is well-formed, and nothing is amiss without an error."""
    rng = random.Random(seed)
    print("seed", seed)
    tape = Tape()
    density = rng.choice([0.02, 0.1, 0.4])
    for _ in range(4000):
        flags = {flag: rng.random() < density for flag in (*FLAGS, "frame_end")}
        flags["row_first"] |= flags["frame_first"] and rng.random() < 0.8
        tape.clocks.append({"valid": rng.random() < 0.8, **flags})
    frames, reports, ever = play(tape)
    assert frames and reports and "framing" in ever


def test_recovers_from_noise():
    rng = random.Random(9)
    tape = Tape()
    for _ in range(500):
        tape.clocks.append({"valid": 1, **{flag: rng.random() < 0.2 for flag in (*FLAGS, "frame_end")}})
    frames, reports, _ = play(tape.end(100).frame().frame())
    assert [lengths(frame) for frame in frames[-2:]] == [[20] * 3] * 2
    assert not any(faults(frames[-1]) + faults(frames[-2]))
    assert reports[-1] == (set(), 3, 20)


def test_limits():
    with pytest.raises(ValueError, match="max_columns is 2049"):
        Monitor(max_columns=2049)
    with pytest.raises(ValueError, match="max_rows is 0"):
        Monitor(max_rows=0)
