"""The test picture against its definition."""

import numpy as np
import pytest

from gateware.camera.pattern import Pattern
from tests.support.simulation import simulate


def test_images_are_as_defined_and_keep_the_contract():
    dut = Pattern(33, 5)
    images, clocks = [], {"row_first": [], "row_last": [], "frame_first": [], "frame_end": []}

    async def drive(ctx):
        video, current = dut.video, []
        ctx.set(dut.run, 1)
        for clock in range(40 * 6 * 65):
            _, _, valid, pixel, end = await ctx.tick().sample(video.pixel.valid, video.pixel.payload, video.frame_end)
            if valid:
                current.append([pixel.r, pixel.g, pixel.b])
                for name in ("row_first", "row_last", "frame_first"):
                    if pixel[name]:
                        clocks[name].append(clock)
            if end:
                clocks["frame_end"].append(clock)
                images.append(np.array(current, np.uint8).reshape(5, 33, 3))
                current.clear()
            if len(images) == 35:
                return

    simulate(dut, drive, clocks=20_000)
    for number, image in enumerate(images):
        assert (image == dut.reference(number)).all(), number
    lasts, firsts = np.array(clocks["row_last"]), np.array(clocks["row_first"])
    assert (np.diff(firsts) >= 48).all()
    assert (firsts[1:] - lasts[: len(firsts) - 1] >= 16).all()
    ends, begins = clocks["frame_end"], clocks["frame_first"]
    for number, end in enumerate(ends):
        last = lasts[5 * number + 4]
        assert last < end
        if number + 1 < len(begins):
            assert end < begins[number + 1]
            assert begins[number + 1] - last >= 64


def test_nothing_comes_unless_it_is_wanted():
    dut = Pattern(32, 2)

    async def drive(ctx):
        for _ in range(300):
            _, _, valid = await ctx.tick().sample(dut.video.pixel.valid)
            assert not valid

    simulate(dut, drive)


@pytest.mark.parametrize(("period", "clocks"), [(0, 196), (1, 196), (196, 196), (197, 197), (251, 251)])
def test_images_come_at_their_rate(period, clocks):
    """An image of 2 rows takes 3 * 65 clocks, and one more to begin."""
    dut = Pattern(33, 2, period)
    begun = []

    async def drive(ctx):
        ctx.set(dut.run, 1)
        for clock in range(5 * max(period, 200)):
            _, _, valid, first = await ctx.tick().sample(dut.video.pixel.valid, dut.video.pixel.payload.frame_first)
            if valid and first:
                begun.append(clock)

    simulate(dut, drive, clocks=20_000)
    assert len(begun) > 3
    assert set(np.diff(begun).tolist()) == {clocks}


@pytest.mark.parametrize(("columns", "rows"), [(31, 4), (2049, 4), (32, 0), (32, 2049)])
def test_sizes_that_are_not_possible_are_refused(columns, rows):
    with pytest.raises(ValueError, match=r"is (31|2049|0); (32|1) to 2048 are possible"):
        Pattern(columns, rows)
