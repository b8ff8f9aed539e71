"""Images are let in whole, and the order of the strobes holds whatever the camera does."""

import random

import pytest

from gateware.frame.admission import APART_CLOCKS, SHORTEST_CLOCKS, Admission
from tests.support.simulation import simulate

NOTHING = {"valid": 0, "row_first": 0, "row_last": 0, "frame_first": 0, "frame_end": 0, "run": 1}


def play(clocks, **options):
    """What comes out in each clock, for what goes in in each clock: values that differ from ``NOTHING``."""
    dut = Admission(**options)
    out = []

    async def drive(ctx):
        pixel = dut.i.pixel
        for number, clock in enumerate(clocks):
            values = {**NOTHING, **clock}
            ctx.set(dut.run, values["run"])
            ctx.set(pixel.valid, values["valid"])
            ctx.set(dut.i.frame_end, values["frame_end"])
            names = ("row_first", "row_last", "frame_first")
            ctx.set(pixel.payload, {"r": number & 0xFF, **{name: values[name] for name in names}})
            # `frame_end` is the only output that sees its input at once.
            end = ctx.get(dut.frame_end)
            video = dut.video
            _, _, *state = await ctx.tick().sample(
                video.pixel.valid, video.pixel.payload.r, video.frame_end, dut.frame_first, dut.row_first, dut.refused
            )
            names = ("valid", "r", "video_end", "frame_first", "row_first", "refused")
            out.append(dict(zip(names, state, strict=True), frame_end=end))

    simulate(dut, drive, clocks=len(clocks) + 10)
    return out


def image(rows, columns=32, blanking=16, end=70, **more):
    """The clocks of an image that keeps the contract; ``frame_end`` comes ``end`` clocks after the last pixel."""
    clocks = []
    for row in range(rows):
        for column in range(columns):
            first = {"frame_first": int(row == 0 and column == 0), "row_first": int(column == 0)}
            clocks.append({"valid": 1, "row_last": int(column == columns - 1), **first, **more})
        clocks += [dict(more)] * blanking
    clocks += [dict(more)] * (end - blanking)
    clocks[-1] = {"frame_end": 1, **more}
    return clocks


def clocks_of(out, name):
    return [number for number, state in enumerate(out) if state[name]]


def test_an_image_passes_a_clock_later():
    clocks = [{}, *image(3), {}, {}, {}]
    out = play(clocks)
    assert clocks_of(out, "valid") == [n + 1 for n, c in enumerate(clocks) if c.get("valid")]
    assert [state["r"] for state in out if state["valid"]] == [n for n, c in enumerate(clocks) if c.get("valid")]
    assert clocks_of(out, "row_first") == [n + 1 for n, c in enumerate(clocks) if c.get("row_first")]
    assert clocks_of(out, "frame_first") == [2]
    assert clocks_of(out, "frame_end") == clocks_of(out, "video_end") == [len(clocks) - 3]
    assert not clocks_of(out, "refused")


def test_only_whole_images_pass():
    """``run`` rises within the first image and falls within the third."""
    first, second, third, fourth = (image(3) for _ in range(4))
    for clock in [*first[:50], *third[60:], *fourth]:
        clock["run"] = 0
    out = play([{"run": 0}, *first, *second, *third, *fourth, {}, {}])
    length = len(first)
    assert clocks_of(out, "frame_first") == [2 + length, 2 + 2 * length]
    assert len(clocks_of(out, "valid")) == 2 * 3 * 32
    assert len(clocks_of(out, "frame_end")) == len(clocks_of(out, "video_end")) == 2
    assert not clocks_of(out, "refused")


def test_pixels_before_the_first_image_are_left_out():
    out = play([*image(3)[5:], *image(2), {}, {}])
    assert len(clocks_of(out, "valid")) == 2 * 32
    assert len(clocks_of(out, "frame_first")) == len(clocks_of(out, "frame_end")) == 1


def test_an_image_without_end_is_over_when_the_next_begins():
    cut = image(4)[:-1]
    out = play([{}, *cut, *image(2), {}, {}, {}])
    begins = clocks_of(out, "frame_first")
    ends = clocks_of(out, "frame_end")
    assert len(begins) == len(ends) == 2
    assert begins[0] < ends[0] < begins[1] < ends[1]


def test_an_image_that_is_too_short_ends_later():
    short = image(1, columns=4, end=17)
    out = play([{}, *short, *[{}] * 200])
    assert len(clocks_of(out, "video_end")) == 1
    (begin,), (end,) = clocks_of(out, "frame_first"), clocks_of(out, "frame_end")
    assert end - begin == SHORTEST_CLOCKS


def test_an_image_that_comes_too_early_is_refused():
    short = image(1, columns=4, end=17)
    out = play([{}, *short, *short, *[{}] * 200, *image(2), {}, {}])
    assert len(clocks_of(out, "refused")) == 1
    assert len(clocks_of(out, "frame_first")) == len(clocks_of(out, "frame_end")) == 2
    assert len(clocks_of(out, "valid")) == 4 + 2 * 32


def test_an_image_that_is_cut_off_by_a_refused_one_is_closed():
    cut = image(2)[:40]
    out = play([{}, *cut, *image(2), *[{}] * 200])
    assert len(clocks_of(out, "refused")) == 1
    assert len(clocks_of(out, "video_end")) == 1
    assert len(clocks_of(out, "frame_first")) == len(clocks_of(out, "frame_end")) == 1


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_the_strobes_holds_for_noise(seed):
    print("seed", seed)
    rng = random.Random(seed)
    rate = [0.5, 0.1, 0.02, 0.005][seed]
    clocks = []
    for _ in range(6000):
        begins = rng.random() < rate
        clocks.append(
            {
                "valid": int(rng.random() < 0.7),
                "row_first": int(begins or rng.random() < 0.05),
                "row_last": int(rng.random() < 0.05),
                "frame_first": int(begins or rng.random() < 0.01),
                "frame_end": int(rng.random() < rate),
                "run": int(rng.random() < 0.8),
            }
        )
    out = play(clocks)
    begins, ends = clocks_of(out, "frame_first"), clocks_of(out, "frame_end")
    assert len(begins) > 5
    assert len(begins) - len(ends) in (0, 1)
    for number, end in enumerate(ends):
        assert end - begins[number] >= SHORTEST_CLOCKS
        if number + 1 < len(begins):
            assert end < begins[number + 1]
    asked = sum(1 for c in clocks if c["valid"] and c["row_first"] and c["frame_first"] and c["run"])
    assert len(begins) + len(clocks_of(out, "refused")) in (asked, asked - 1)


@pytest.mark.parametrize("apart", [1, APART_CLOCKS - 1, APART_CLOCKS, APART_CLOCKS + 1])
def test_images_that_are_not_close_are_at_least_so_far_apart(apart):
    """The next image begins so many clocks after the strobe of the first."""
    first, second = image(3), image(3)
    clocks = [{}, *first, *([{}] * apart), *second, {}, {}]
    out = play(clocks, close_images=False)
    end = clocks_of(out, "frame_end")[0]
    let_in = apart > APART_CLOCKS
    assert clocks_of(out, "frame_first") == [2] + [end + apart + 1] * let_in
    assert len(clocks_of(out, "refused")) == 1 - let_in
    assert len(clocks_of(out, "frame_end")) == len(clocks_of(out, "video_end")) == 1 + let_in


def test_images_that_are_not_close_an_image_without_end_costs_the_next():
    """It is closed by the one that begins, which is refused; rows after an end are none of the image."""
    open_end = image(3)
    open_end[-1] = {}
    out = play([{}, *open_end, *image(3), *([{}] * APART_CLOCKS), *image(2), *image(2)[1:-1], {}], close_images=False)
    begins = clocks_of(out, "frame_first")
    assert len(begins) == 2
    assert len(clocks_of(out, "refused")) == 1
    ends = clocks_of(out, "frame_end")
    assert len(ends) == len(clocks_of(out, "video_end")) == 2
    assert begins[0] < ends[0] < begins[1] < ends[1]
    assert not [clock for clock in clocks_of(out, "row_first") if ends[0] < clock < begins[1] or clock > ends[1] + 1]
