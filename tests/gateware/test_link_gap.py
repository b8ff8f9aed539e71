"""Pieces begin only where they fit before the next frame."""

from gateware.link.gap import PIECE_BYTES, TICK, Gap
from tests.support.simulation import simulate

BYTE_CLOCKS = 3
FRAME_CLOCKS = 600


def opened(periods):
    """For each period between the beginnings of frames: clocks after the frame's end in which a piece may begin."""
    dut = Gap()
    open_at = []

    async def testbench(ctx):
        for _ in range(4):  # a few bytes tell how fast the line is
            ctx.set(dut.waits, 1)
            for clock in range(BYTE_CLOCKS):
                ctx.set(dut.moved, clock == BYTE_CLOCKS - 1)
                await ctx.tick()
        ctx.set(dut.waits, 0)
        ctx.set(dut.moved, 0)
        for period in periods:
            for clock in range(FRAME_CLOCKS):
                ctx.set(dut.frame, clock % 7 != 3)  # it has pauses
                ctx.set(dut.frame_last, clock == FRAME_CLOCKS - 1)
                await ctx.tick()
                assert not ctx.get(dut.open) or clock < 1
            ctx.set(dut.frame, 0)
            ctx.set(dut.frame_last, 0)
            clocks = []
            for clock in range(period - FRAME_CLOCKS):
                await ctx.tick()
                if ctx.get(dut.open):
                    clocks.append(clock)
            open_at.append(clocks)

    simulate(dut, testbench, clocks=sum(periods) + 100)
    return open_at


def test_a_piece_begins_only_if_it_ends_before_the_next_frame():
    piece = BYTE_CLOCKS * PIECE_BYTES
    gap = 4000
    for clocks in opened([FRAME_CLOCKS + gap] * 4)[2:]:
        assert gap - piece - 4 * TICK < max(clocks) <= gap - piece
        assert min(clocks) < 2 * TICK


def test_a_line_that_is_full_is_left_to_the_frames():
    assert opened([FRAME_CLOCKS + BYTE_CLOCKS * PIECE_BYTES - TICK] * 4)[1:] == [[]] * 3


def test_when_frames_stay_away_the_line_is_free(monkeypatch):
    monkeypatch.setattr("gateware.link.gap._OVERDUE_BIT", 4)
    for gap, free in ((1000, 16 * TICK), (3000, 6000)):  # no piece fits in the first
        *_, last = opened([FRAME_CLOCKS + gap] * 3 + [FRAME_CLOCKS + 9000])
        late = [clock for clock in last if clock > gap]
        assert free - TICK < min(late) < free + 3 * TICK
        assert max(late) == 8999


def test_after_one_long_gap_no_other_is_expected():
    full, long_ = FRAME_CLOCKS + 1000, FRAME_CLOCKS + 9000
    assert opened([full, full, long_, full, full, full])[1:2] == [[]]
    assert opened([full, full, long_, full, full, full])[3:] == [[]] * 3
