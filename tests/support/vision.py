"""Images, settings and tables for tests of the vision, and the camera that sends them."""

import numpy as np

from magtrak.protocol import REGISTERS, Access, Scope
from magtrak.reference import words_from_luts

BLANKING = 16
ROW_PERIOD = 48
FRAME_GAP = 64


def default_settings(**changes: int) -> dict[str, int]:
    """The settings after reset, with ``changes``."""
    settings = {r.name: r.init for r in REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH}
    unknown = set(changes) - set(settings)
    assert not unknown, f"no such settings: {unknown}"
    return settings | changes


def random_settings(rng: np.random.Generator, columns: int, rows: int) -> dict[str, int]:
    """Settings of all kinds, most of which let something pass."""

    def between(low: int, high: int) -> int:
        return int(rng.integers(low, high + 1))

    def mostly(usual: int, low: int, high: int) -> int:
        return usual if rng.random() < 0.6 else between(low, high)

    mean = rng.random() < 0.5
    return default_settings(
        weight_r=85 if mean else between(-512, 511),
        weight_g=86 if mean else between(-512, 511),
        weight_b=85 if mean else between(-512, 511),
        floor=between(0, 120),
        run_gated=between(0, 3),
        run_reach=between(0, 15),
        run_bridge=mostly(0, 0, 15),
        run_width_min=mostly(1, 0, 4),
        run_width_max=mostly(4095, 1, 12),
        column_first=mostly(0, 0, columns),
        column_last=mostly(4095, 0, columns),
        row_first=mostly(0, 0, 2),
        row_last=mostly(4095, 0, rows),
        detector=between(0, 3),
        isolate=mostly(0, 1, 8),
        choice=between(0, 4),
        centroid_window=between(0, 3),
        centroid_base=between(0, 15),
        ambiguous_ratio=between(0, 255),
    )


def random_luts(rng: np.random.Generator, density: float = 0.7) -> np.ndarray:
    """Tables of which each entry passes with probability ``density``."""
    return rng.random((3, 256)) < density


def random_image(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """Noise, flat stretches, full scale and laser lines, so that runs of all kinds come."""
    image = rng.integers(0, 256, (rows, columns, 3))
    for row in image:
        kind = rng.integers(0, 4)
        if kind == 0:
            continue
        base = rng.integers(0, 60, 3)
        row[:] = base + rng.integers(0, 8, row.shape)
        for _ in range(kind):
            x = np.arange(columns)
            line = rng.integers(50, 900) * np.exp(
                -((x - rng.uniform(-2, columns + 1)) ** 2) / (2 * rng.uniform(0.3, 4) ** 2)
            )
            row += (line[:, None] * rng.random(3)).astype(int)
    return np.clip(image, 0, 255).astype(np.uint8)


async def load_luts(ctx, lut, luts: np.ndarray) -> None:
    """Write all words to the idle banks and swap."""
    for axis, words in enumerate(words_from_luts(luts)):
        for word, value in enumerate(words):
            ctx.set(lut.valid, 1)
            ctx.set(lut.axis, axis)
            ctx.set(lut.word, word)
            ctx.set(lut.data, value)
            await ctx.tick()
    ctx.set(lut.valid, 0)
    ctx.set(lut.written, 0b111)
    ctx.set(lut.swap, 1)
    await ctx.tick()
    ctx.set(lut.swap, 0)


async def send_image(ctx, video, image: np.ndarray, *, gap: float = 0, rng=None, blanking: int = BLANKING) -> None:
    """Send an image as tightly as the contract allows, or with gaps of probability ``gap`` before each pixel."""
    rows, columns = image.shape[:2]
    for row in range(rows):
        clocks = 0
        for column in range(columns):
            while gap and rng.random() < gap:
                await ctx.tick()
                clocks += 1
            r, g, b = (int(value) for value in image[row, column])
            ctx.set(
                video.pixel.p,
                {
                    "r": r,
                    "g": g,
                    "b": b,
                    "row_first": column == 0,
                    "row_last": column == columns - 1,
                    "frame_first": row == column == 0,
                },
            )
            ctx.set(video.pixel.valid, 1)
            ctx.set(video.frame_end, row == rows - 1 and column == columns - 1)
            await ctx.tick()
            clocks += 1
            ctx.set(video.pixel.valid, 0)
            ctx.set(video.frame_end, 0)
        # The next first pixel comes `blanking` clocks after the last, and ROW_PERIOD after the first.
        await ctx.tick().repeat(max(blanking - 1, ROW_PERIOD - clocks))
    await ctx.tick().repeat(FRAME_GAP)
