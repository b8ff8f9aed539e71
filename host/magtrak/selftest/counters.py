"""The counters: nothing gets lost, and where something must, it is counted."""

import itertools

from .bench import Bench, FailedError, NotTriedError

IMAGES = 20
FULL = 1
COMPACT = 0


def lossless(bench: Bench) -> str:
    """Compact rows of many images: their numbers follow each other, and no counter of losses moves."""
    card = bench.card
    card.write("form", COMPACT)
    names = ("dropped", "damaged_commands", "line_errors")
    bench.measure({})
    before = card.read_all(names)
    link = card.link.statistics
    frames = bench.images(lambda got: len(got) >= IMAGES)
    after, seen = card.read_all(names), card.link.statistics - link
    if seen.damaged or seen.lost:
        raise FailedError(f"on the link {seen.lost} packets got lost and {seen.damaged} were damaged")
    for name, old, new in zip(names, before, after, strict=True):
        if new != old:
            raise FailedError(f"{name} went from {old} to {new} in {IMAGES} images")
    for earlier, later in itertools.pairwise(frames):
        if later.number != earlier.number + 1:
            raise FailedError(f"image {later.number} came after {earlier.number}")
    if errors := next((one.header["camera_errors"] for one in frames if one.header["camera_errors"]), 0):
        raise FailedError(f"the source broke its contract: camera_errors is {errors:#04x}, see docs/protocol.md")
    clocks = frames[-1].header["first_time"] - frames[0].header["first_time"]
    rate = (IMAGES - 1) * card.identity.clock_hz / clocks
    return f"{IMAGES} images one after the other, {rate:.1f} a second, none lost"


def dropping(bench: Bench) -> str:
    """Full rows, more than the link may carry: whole images are left out, and exactly those are counted."""
    card = bench.card
    if card.identity.built.has("full_rows"):
        card.write("form", FULL)
    bench.measure({})
    link = card.link.statistics
    frames = bench.images(lambda got: len(got) >= IMAGES)
    card.write("form", COMPACT)
    seen = card.link.statistics - link
    if seen.damaged or seen.lost:
        raise FailedError(f"on the link {seen.lost} packets got lost and {seen.damaged} were damaged")
    missing = 0
    for earlier, later in itertools.pairwise(frames):
        gap, counted = later.number - earlier.number - 1, later.header["dropped"] - earlier.header["dropped"]
        if gap != counted:
            raise FailedError(
                f"{gap} images are missing before image {later.number}, and {counted} were counted as dropped"
            )
        missing += gap
    if not missing:
        raise NotTriedError(f"the link carries all rows of {IMAGES} images: none had to be dropped")
    return f"{missing} images of {frames[-1].number - frames[0].number + 1} dropped, and all of them counted"
