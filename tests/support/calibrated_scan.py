"""From pictures to a cloud: a session of the simulated rig, its lines through the virtual card, a calibration by the
commands, and a scan with it. The tools see pictures, encoder edges and the boards' descriptions, nothing else.
"""

import json
from pathlib import Path

import numpy as np

from magtrak.cloud.ply import read_ply
from sim.scene import FOLDER, Scene
from sim.session import timing_of
from tests.support.calibration_rig import TrueRig
from tests.support.virtual import run, virtual_card

RIG = "rig"


def take_session(folder: Path, views: int, frames: int = 4, seed: int = 1) -> Path:
    """Pictures of a session; made once for a folder."""
    session = folder / "session"
    if not (session / "session.json").exists():
        options = ["--scene", RIG, "--views", f"{views}", "--frames", f"{frames}", "--seed", f"{seed}"]
        made = run("python", "-m", "sim.session", session, *options, timeout_s=3600)
        assert made.returncode == 0, made.stderr
    return session


def measure_lines(session: Path) -> str:
    """The laser's pictures through the gateware; what the command says."""
    values = json.loads((session / "session.json").read_text())
    link = session / "card"
    options = ["--frames", session / "laser", "--angles", session / "angles.csv"]
    options += ["--frame-rate", f"{values['frame_rate_hz']}", "--row-time", f"{values['row_time_us']}"]
    options += ["--counts-per-turn", f"{values['counts_per_turn']}"]
    with virtual_card(link, *options) as card:
        done = run("magtrak", "calibrate", "lines", session, "--port", link, timeout_s=1800)
        assert done.returncode == 0, done.stderr
        assert card.wait(timeout=60) == 0
    return done.stdout


def calibrate(session: Path, output: Path, *options: str | Path) -> str:
    """The joint calibration by its command; what it prints."""
    done = run("magtrak", "calibrate", "joint", session, "--output", output, *options, timeout_s=1800)
    assert done.returncode == 0, done.stderr
    return done.stdout


def true_rig() -> TrueRig:
    """What the tools shall find. The pictures of a session are exposed otherwise than those of a scan."""
    scene = Scene.load(RIG)
    return TrueRig(scene.camera, scene.laser, 0.0, counts_per_turn=scene.counts_per_turn)


def plane_scene(path: Path, distance_mm: float, frames: int) -> Path:
    """The rig before a white wall."""
    text = (FOLDER / f"{RIG}.toml").read_text().split("[[object]]")[0]
    text = text.replace("frames = 300", f"frames = {frames}")
    wall = f'[[object]]\nshape = "plane"\nposition_mm = [0, 0, {distance_mm}]\nrotation_deg = [0, 0, 0]\n'
    path.write_text(text + wall + "albedo = [0.8, 0.8, 0.8]\n")
    return path


def scan_plane(folder: Path, calibration: Path, distance_mm: float, frames: int = 150) -> np.ndarray:
    """(N, 3) points of a wall at a distance, scanned with a calibration. Its time offset is that of the session's
    exposure; the scan's is known to differ by half the difference of the exposures, which the settings carry.
    """
    scene = plane_scene(folder / "plane.toml", distance_mm, frames)
    made = run(
        "python", "-m", "sim.scene", scene, "--calibration", folder / "truth.json", "--settings", folder / "s.toml"
    )
    assert made.returncode == 0, made.stderr
    what = Scene.load(RIG)
    shift = what.timing.offset_s - timing_of(what).offset_s
    settings = folder / "s.toml"
    settings.write_text(settings.read_text() + f"[camera]\ntime_offset_s = {shift:.9f}\n")
    link, cloud = folder / "card", folder / "plane.ply"
    with virtual_card(link, "--scene", scene) as card:
        done = run(
            "magtrak-recv", "--port", link, "--calibration", calibration, "--output", cloud, "--settings", settings,
            timeout_s=1800,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert card.wait(timeout=60) == 0
    points = read_ply(cloud)
    points = points[points["quality"] > 0.6]
    return np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)
