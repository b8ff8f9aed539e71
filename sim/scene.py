"""Scenes: a rig and what stands before it, read from TOML.

A scene is a file, or the name of one in ``sim/scenes``; every field is explained in ``default.toml`` there. A file with
``like = NAME`` takes the tables that it lacks from another scene.

``python -m sim.scene NAME --calibration FILE.json`` writes the calibration that belongs to a scene.
"""

import json
import tomllib
from dataclasses import dataclass, replace
from math import degrees, exp, pi
from pathlib import Path
from typing import Any

import click
import numpy as np

from . import optics, parts
from .encoder import Flaws
from .errors import SimError
from .motor import Motor, MotorParameters
from .optics import Camera, Laser
from .parts import Ambient, Object, Scan
from .playback import Playback, steady
from .surfaces import Floats, Surface
from .tables import Table
from .timing import Timing
from .water import Water

# The speed loop of a scene's settings: its poles, by placement (kp and ki of a plant of first order).
LOOP_RAD_S = 25.0
DAMPING = 0.9
REVERSALS = 60  # times from full speed to standstill in a scan
THERE_AND_BACK_S = 2.0  # shorter scans go there only

FOLDER = Path(__file__).parent / "scenes"


@dataclass(frozen=True)
class Scene:
    """Everything that is simulated around the card."""

    name: str
    camera: Camera
    timing: Timing
    laser: Laser
    counts_per_turn: int
    index_width_counts: int
    encoder_flaws: Flaws
    motor_parameters: MotorParameters
    motor_start_rad: float
    ambient: Ambient
    objects: tuple[Object, ...]
    scan: Scan
    water: Water | None = None

    @classmethod
    def load(cls, name: str | Path) -> "Scene":
        """A ready-made scene by name, or one from a file.

        Raises
        ------
        SimError : it can't be read, or a field is wrong; names file, field and value
        """
        path = _path(name)
        values = _read(path)
        if "like" in values:
            values = _read(_path(str(values.pop("like")))) | values
        return _scene(path.stem, Table(path, "", values))

    def override(
        self,
        frame_rate_hz: float | None = None,
        row_time_us: float | None = None,
        exposure_ms: float | None = None,
        speckle: float | None = None,
    ) -> "Scene":
        """The scene with another timing or contrast of the speckle. The picture's brightness stays, as if the gain
        followed the exposure.

        Raises
        ------
        SimError : it does not fit together
        """
        if speckle is not None and not 0 <= speckle < np.inf:
            raise SimError(f"the contrast of the speckle can't be {speckle:g}; give 0 or more")
        changes: dict[str, float | None] = {}
        if frame_rate_hz is not None:
            changes["frame_rate_hz"] = frame_rate_hz
        if row_time_us is not None:
            changes["row_time_s"] = row_time_us * 1e-6
        if exposure_ms is not None:
            changes["exposure_s"] = exposure_ms * 1e-3
        laser = self.laser if speckle is None else replace(self.laser, speckle=speckle)
        return replace(self, timing=replace(self.timing, **changes), laser=laser)  # type: ignore[arg-type]

    @property
    def surfaces(self) -> list[Surface]:
        """The surfaces of the objects."""
        return [item.surface for item in self.objects]

    def motor(self) -> Motor:
        """A motor that stands where the scene says, for the card's PWM to drive."""
        return Motor(
            self.motor_parameters,
            self.motor_start_rad,
            self.counts_per_turn,
            self.index_width_counts,
            self.encoder_flaws,
        )

    @property
    def scan_duty(self) -> float:
        """Duty that takes the motor from where it stands to the end of the nominal scan, in the scan's time."""
        time_s = float((self.scan.frames - 1) * self.timing.period_s + self.timing.rows(0.0)[-1])
        tau = self.motor_parameters.time_constant_s
        lag = tau * (1 - exp(-time_s / tau))  # lost while it gathers speed
        return self.motor_parameters.duty((self.scan.end_rad - self.motor_start_rad) / (time_s - lag))

    def settings(self) -> str:
        """Settings for the card (TOML) that scan the scene: sweeping, there and back where time allows it, with the
        speed loop tuned to the motor.
        """
        motor = self.motor_parameters
        low, high = degrees(self.scan.start_rad), degrees(self.scan.end_rad)
        scan_s = self.scan.frames * self.timing.period_s
        # From where it stands, past the index, to the far end, and back; reversals last three times as long.
        back = high - low if scan_s > THERE_AND_BACK_S else 0.0
        reversal_s = scan_s / REVERSALS
        speed = (high - degrees(self.motor_start_rad) + back) / (scan_s - 4 * reversal_s)
        per_deg_s = motor.damping_nm_s / motor.drive_nm(1.0) * pi / 180  # duty
        tau = motor.time_constant_s
        return f"""# The scene {self.name}: green laser, closed loop, sweeping.
[motor]
mode = "sweep"
sweep_deg = [{low:.3f}, {high:.3f}]
speed_deg_s = {speed:.3f}
acceleration_deg_s2 = {speed / reversal_s:.1f}
search_deg = 20
feed_forward = {per_deg_s:.5f}
friction = {motor.friction_nm / motor.drive_nm(1.0):.5f}
kp = {per_deg_s * (2 * DAMPING * LOOP_RAD_S * tau - 1):.5f}
ki = {per_deg_s * LOOP_RAD_S**2 * tau:.5f}
"""

    def playback(self, edge_rate_hz: float) -> Playback:
        """The nominal scan at an exactly constant speed, whatever the PWM."""
        angles = steady(self.scan.frames, self.scan.start_rad, self.scan.end_rad, self.timing)
        return Playback(angles, self.timing, self.counts_per_turn, edge_rate_hz, self.index_width_counts)

    def calibration(self) -> dict[str, Any]:
        """What an ideal calibration of this rig would give, in the format of calibration files."""
        values = optics.calibration(self.camera, self.laser, self.counts_per_turn, self.timing.offset_s)
        return values if self.water is None else values | {"ports": self.water.calibration()}

    def sight(self, directions: Floats) -> tuple[Floats, Floats]:
        """Starts (3,) or (N, 3) and directions of sights that leave the camera along (N, 3), outside of the rig."""
        return (np.zeros(3), directions) if self.water is None else self.water.sight(directions)

    def project(self, points: Floats) -> Floats:
        """(N, 2) pixel positions of points (N, 3) before the rig."""
        if self.water is None:
            return self.camera.project(points)
        inner, _, _ = self.water.camera.quickest(np.zeros_like(points), points, self.water.index)
        return self.camera.project(inner)

    def dimmed(self, light: Floats, way_mm: Floats) -> Floats:
        """(N, 3) parts of the room's light that come back from surfaces, after ways (N,) to the camera."""
        return light if self.water is None else self.water.dimmed(light, way_mm)

    def lit_from(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """For points (N, 3): alpha of the sheet through them, mm by which it moves there per rad (0 where it does not
        get to), and where its light comes from, (3,) or (N, 3), outside of the rig.
        """
        if self.water is None:
            return *self.laser.meets(self.laser.points(points)), self.laser.origin
        return self.water.meets(self.laser, points)


def _path(name: str | Path) -> Path:
    path = Path(name)
    if path.suffix != ".toml":
        path = FOLDER / f"{name}.toml"
        if not path.is_file():
            known = ", ".join(sorted(file.stem for file in FOLDER.glob("*.toml")))
            raise SimError(f"there is no scene called {name}; there are {known}, or give a .toml file")
    return path


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise SimError(f"the scene {path} can't be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SimError(f"the scene {path} is not valid TOML: {error}") from error


def _scene(name: str, table: Table) -> Scene:
    camera, timing = parts.read_camera(table.table("camera"))
    laser = parts.read_laser(table.table("laser"))
    counts, width, flaws = parts.read_encoder(table.table("encoder"))
    motor, start_rad = parts.read_motor(table.table("motor"))
    ambient = parts.read_ambient(table.table("ambient"))
    scan = parts.read_scan(table.table("scan"))
    water = parts.read_water(table.table("water")) if table.has("water") else None
    objects = tuple(parts.read_object(item) for item in table.tables("object"))
    table.finish()
    return Scene(name, camera, timing, laser, counts, width, flaws, motor, start_rad, ambient, objects, scan, water)


@click.command()
@click.argument("name")
@click.option("--calibration", "path", type=click.Path(path_type=Path), required=True, help="JSON file to write.")
@click.option("--settings", "settings", type=click.Path(path_type=Path), help="TOML file of settings to write as well.")
@click.option("--exposure", "exposure_ms", type=float, metavar="MS", help="Exposure, if not the scene's.")
def main(name: str, path: Path, settings: Path | None, exposure_ms: float | None) -> None:
    """Write the calibration (and settings) that belong to the scene NAME (a ready-made one, or a .toml file)."""
    try:
        scene = Scene.load(name).override(exposure_ms=exposure_ms)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(scene.calibration(), indent=2) + "\n")
        if settings is not None:
            settings.write_text(scene.settings())
    except SimError as error:
        raise click.ClickException(str(error)) from None
    except OSError as error:
        raise click.ClickException(f"the calibration {path} can't be written: {error.strerror}") from None


if __name__ == "__main__":
    main()
