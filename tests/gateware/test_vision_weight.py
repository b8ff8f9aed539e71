"""Mix and weight against the reference."""

import numpy as np

from gateware.vision.weight import Weight
from magtrak.reference import mix, saturated, weight
from tests.support.simulation import simulate
from tests.support.vision import default_settings

SEED = 31


def measured(colours: np.ndarray, settings: dict[str, int]) -> np.ndarray:
    dut = Weight()
    results = []

    async def testbench(ctx):
        ctx.set(dut.settings, settings)
        for colour in colours.tolist() + [[0, 0, 0]] * dut.latency:
            for name, value in zip("rgb", colour, strict=True):
                ctx.set(getattr(dut, name), value)
            _, _, *item = await ctx.tick().sample(dut.mix, dut.weight, dut.saturated)
            results.append(item)

    simulate(dut, testbench)
    return np.array(results[dut.latency :])


def check(colours, **changes):
    settings = default_settings(**changes)
    colours = np.array(colours, dtype=np.uint8)
    mixed = mix(colours, settings)
    expected = np.stack((mixed, weight(mixed, settings), saturated(colours)), axis=-1)
    np.testing.assert_array_equal(measured(colours, settings), expected)
    return expected.tolist()


def test_by_hand():
    """The default is the mean; 254.5 is rounded up, the floor is taken off."""
    rows = check([(0, 0, 0), (255, 255, 255), (254, 255, 255), (30, 20, 10), (21, 20, 20), (22, 21, 21)])
    assert rows == [[0, 0, 0], [255, 235, 1], [255, 235, 1], [20, 0, 0], [20, 0, 0], [21, 1, 0]]


def test_limits():
    colours = [(r, g, b) for r in (0, 1, 255) for g in (0, 1, 255) for b in (0, 1, 255)]
    for coefficients in ((-512, -512, -512), (511, 511, 511), (-512, 511, -512), (256, -128, -128), (0, 0, 0)):
        for floor in (0, 255):
            check(colours, **dict(zip(("weight_r", "weight_g", "weight_b"), coefficients, strict=True)), floor=floor)


def test_random():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(10):
        coefficients = (int(value) for value in rng.integers(-512, 512, 3))
        changes = dict(zip(("weight_r", "weight_g", "weight_b"), coefficients, strict=True))
        check(rng.integers(0, 256, (200, 3)), **changes, floor=int(rng.integers(0, 256)))
