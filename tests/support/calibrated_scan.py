"""From pictures to clouds: a session of the simulated rig, its lines through the virtual card, a calibration by the
commands, and scans with it. The tools see pictures, encoder edges and the boards' descriptions, nothing else.

Pictures and recordings take long and are kept in ``build/calibrated_scan``, by the content of all they are made from;
neither knows of a calibration. Scans received live are made anew.
"""

import json
from dataclasses import dataclass
from pathlib import Path

from magtrak.calibration import Calibration
from magtrak.validate.virtual import COLOUR
from sim.cached import BUILD, cached
from sim.scene import FOLDER, Scene
from sim.session import timing_of
from sim.verilator import card_verilog
from tests.support.calibration_rig import TrueRig
from tests.support.virtual import run, virtual_card

RIG = "rig"
KEPT = BUILD / "calibrated_scan"
ROOT = BUILD.parent

BINARY = '[peak]\ndetector = "binary"\n'
"""The paper's way: the mean of the gated pixels. To be replayed with ``--angle bare``."""


HOST = (
    "settings.py", "settings_file.py", "gate.py", "motor.py", "card.py", "link.py", "recording.py", "frames.py",
    "angle.py", "edges.py", "calibrate/capture.py",
)  # fmt: skip
"""Of the host, what decides on recordings and lines."""


@dataclass(frozen=True)
class Pictures:
    """How a session is taken.

    Parameters
    ----------
    scene : name or file of the rig
    views, frames : views of boards, lit pictures of each
    seed : of poses and noise
    """

    scene: str = RIG
    views: int = 30
    frames: int = 4
    seed: int = 1

    @property
    def what(self) -> Scene:
        return Scene.load(self.scene)


def take_session(pictures: Pictures, folder: Path) -> Path:
    """A session in ``folder``: pictures, and lines through the gateware."""
    session = folder / "session"
    session.mkdir(parents=True)
    parts: list[str | bytes] = [_text("sim"), *_scene_texts(pictures.scene), repr(pictures)]
    with cached(KEPT, "session", *parts) as (place, making):
        if making is not None:
            options = ["--scene", pictures.scene, "--views", f"{pictures.views}", "--frames", f"{pictures.frames}"]
            _done("python", "-m", "sim.session", making, *options, "--seed", f"{pictures.seed}")
    for part in ("pictures", "truth", "session.json"):
        (session / part).symlink_to(place / part)
    with cached(KEPT, "lines", *parts, *_chain()) as (lines, making):
        if making is not None:
            (making / "session.json").write_text((place / "session.json").read_text())
            _measure_lines(place, making)
    (session / "lines.csv").symlink_to(lines / "lines.csv")
    return session


def _measure_lines(pictures: Path, out: Path) -> None:
    """The laser's pictures through the gateware."""
    values = json.loads((pictures / "session.json").read_text())
    options = ["--frames", pictures / "laser", "--angles", pictures / "angles.csv"]
    options += ["--frame-rate", f"{values['frame_rate_hz']}", "--row-time", f"{values['row_time_us']}"]
    options += ["--counts-per-turn", f"{values['counts_per_turn']}"]
    with virtual_card(out / "card", *options) as card:
        _done("magtrak", "calibrate", "lines", out, "--port", out / "card")
        assert card.wait(timeout=60) == 0


def calibrate(session: Path, output: Path, *options: str | Path) -> str:
    """The joint calibration by its command; what it prints."""
    return _done("magtrak", "calibrate", "joint", session, "--output", output, *options)


def calibrate_ports(session: Path, air: Path, rule: Path, output: Path) -> str:
    """The ports from a session under water by the command; what it prints."""
    return _done("magtrak", "calibrate", "ports", session, "--calibration", air, "--measured", rule, "--output", output)


def true_rig(scene: str = RIG) -> TrueRig:
    """What the tools shall find. The pictures of a session are exposed otherwise than those of a scan."""
    what = Scene.load(scene)
    return TrueRig(what.camera, what.laser, 0.0, counts_per_turn=what.counts_per_turn)


def true_calibration(session: Path, path: Path) -> Path:
    """The true calibration of a session's rig as a file."""
    truth = json.loads((session / "truth" / "truth.json").read_text())
    path.write_text(json.dumps(truth["calibration"]))
    return path


def recording(scene: str, settings: str = COLOUR) -> Path:
    """A scan of a scene (name or file) as the card sent it: ``scan.mcap``; see :func:`_scan`."""
    parts = [_text("sim"), *_scene_texts(scene), *_chain(), settings]
    with cached(KEPT, Path(scene).stem, *parts) as (place, making):
        if making is not None:
            calibration = making / "calibration.json"
            calibration.write_text(json.dumps(Scene.load(scene).calibration()))
            _scan(scene, settings, 0, calibration, making, "--record", making / "scan.mcap")
            (making / "cloud.ply").unlink()
    return place / "scan.mcap"


def live_scan(scene: str, calibration: Path, seed: int, folder: Path) -> Path:
    """The cloud of a scene (name or file) as ``magtrak-recv`` makes it from the virtual card's stream, with a
    calibration; ``seed`` is that of the scan's noise. Made anew each time, in a folder of its own in ``folder``.
    """
    out = folder / f"{Path(scene).stem}-live"
    out.mkdir()
    _scan(scene, COLOUR, seed, calibration, out)
    return out / "cloud.ply"


def _scan(scene: str, settings: str, seed: int, calibration: Path, out: Path, *options: str | Path) -> None:
    """Scan a scene with the virtual card: ``cloud.ply`` in ``out``.

    The settings tell by how much the scan's time offset differs from the session's: half the difference of the
    exposures, which whoever scans has chosen.
    """
    toml = out / "scan.toml"
    _done("python", "-m", "sim.scene", scene, "--calibration", out / "true.json", "--settings", toml)
    (out / "true.json").unlink()
    what = Scene.load(scene)
    shift = what.timing.offset_s - timing_of(what).offset_s
    toml.write_text(toml.read_text() + f"[camera]\ntime_offset_s = {shift:.9f}\n" + settings)
    with virtual_card(out / "card", "--scene", scene, "--seed", f"{seed}") as card:
        _done(
            "magtrak-recv", "--port", out / "card", "--calibration", calibration, "--output", out / "cloud.ply",
            "--settings", toml, *options,
        )  # fmt: skip
        assert card.wait(timeout=60) == 0


def replay(recorded: Path, calibration: Path, cloud: Path, *options: str) -> Path:
    """The cloud of a recording with a calibration, by the command."""
    _done("magtrak", "replay", recorded, "--calibration", calibration, "--output", cloud, *options)
    return cloud


def expected_form_mm(calibration: Calibration, distance_m: float) -> float:
    """What the file itself says of a plane at a distance: form error, 95th percentile."""
    entry = next(item for item in calibration.extra["expected"] if item["distance_mm"] == 1000 * distance_m)
    return float(entry["form_mm"])


def _done(command: str, *options: str | Path) -> str:
    done = run(command, *options, timeout_s=3600)
    assert done.returncode == 0, f"{command} {' '.join(map(str, options))}: {done.stderr}"
    return done.stdout


def _text(folder: str) -> bytes:
    return b"\0".join(path.read_bytes() for path in sorted((ROOT / folder).glob("*.py")))


def _scene_texts(scene: str) -> list[bytes]:
    path = Path(scene) if scene.endswith(".toml") else FOLDER / f"{scene}.toml"
    return [path.read_bytes(), (FOLDER / f"{RIG}.toml").read_bytes()]


def _chain() -> list[str | bytes]:
    """All between pixels and a recording, or lines: the card, what it is told, and what its bytes are taken for."""
    host = ROOT / "host" / "magtrak"
    return [card_verilog(), _text("host/magtrak/protocol"), *((host / name).read_bytes() for name in HOST)]
