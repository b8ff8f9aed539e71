"""A scan of a scene through the virtual card, judged by its truth."""

from pathlib import Path

from sim import ply
from sim.evaluate import NEEDED, Judge, Report
from sim.scene import Scene
from sim.truth import Truth
from tests.support.virtual import receive, run, virtual_card


def judged_scan(
    folder: Path, scene: str, *card_options: str, settings: str = "", receiver: tuple[str, ...] = ()
) -> Report:
    """Scan ``scene``; ``settings`` is TOML that comes after the scene's own settings."""
    calibration, toml, truth = folder / "calibration.json", folder / "scan.toml", folder / "truth.npz"
    made = run("python", "-m", "sim.scene", scene, "--calibration", calibration, "--settings", toml)
    assert made.returncode == 0, made.stderr
    toml.write_text(toml.read_text() + settings)
    with virtual_card(folder / "card", "--scene", scene, "--truth", truth, *card_options) as card:
        receive(folder / "card", calibration, folder / "cloud.ply", "--settings", toml, *receiver)
        assert card.wait(timeout=60) == 0
    what = Scene.load(scene)
    cloud = ply.read(folder / "cloud.ply", NEEDED)
    return Judge(what, Truth.load(truth, what)).judge(cloud)
