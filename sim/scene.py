"""Scenes: a rig and what stands before it, read from TOML.

A scene is a file, or the name of one in ``sim/scenes``; every field is explained in ``default.toml`` there. A file with
``like = NAME`` takes the tables that it lacks from another scene.

``python -m sim.scene NAME --calibration FILE.json`` writes the calibration that belongs to a scene.
"""

import json
import tomllib
from dataclasses import dataclass, replace
from math import cos, degrees, exp, pi, radians, sin
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt

from . import optics
from .boards import Board
from .encoder import Flaws
from .errors import SimError
from .motor import INDEX_WIDTH_COUNTS, Motor, MotorParameters
from .optics import Camera, Laser
from .playback import Playback, steady
from .surfaces import Box, Cylinder, Floats, Plane, Sphere, Surface
from .tables import Table
from .timing import Timing
from .water import Pane, Water

# The speed loop of a scene's settings: its poles, by placement (kp and ki of a plant of first order).
LOOP_RAD_S = 25.0
DAMPING = 0.9
REVERSALS = 60  # times from full speed to standstill in a scan
THERE_AND_BACK_S = 2.0  # shorter scans go there only

FOLDER = Path(__file__).parent / "scenes"


@dataclass(frozen=True)
class Ambient:
    """Light of the room: ``colour`` in grey levels on a white surface that faces ``direction``; ``diffuse`` of it
    comes from everywhere.
    """

    colour: tuple[float, ...]
    direction: tuple[float, ...]
    diffuse: float


@dataclass(frozen=True)
class Object:
    """A surface and its colour: the parts of red, green and blue that it reflects, less where a board is printed."""

    surface: Surface
    albedo: tuple[float, ...]
    board: Board | None = None

    def colour(self, points: Floats) -> Floats:
        """(N, 3) parts of red, green and blue that points (N, 3) of the surface reflect."""
        albedo = np.broadcast_to(np.asarray(self.albedo), (len(points), 3))
        if self.board is None:
            return albedo
        assert isinstance(self.surface, Plane)
        return np.asarray(albedo * self.board.white(self.surface, points)[:, None])


@dataclass(frozen=True)
class Scan:
    """The nominal scan: the motor's angle at the first row of all and at the last."""

    frames: int
    start_rad: float
    end_rad: float


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


def _pose(table: Table) -> Floats:
    """``position_mm``, and ``rotation_deg`` as an axis times an angle."""
    position = table.numbers("position_mm", (3,))
    return pose_of(position, np.radians(table.numbers("rotation_deg", (3,), (0.0, 0.0, 0.0))))


def pose_of(position: npt.ArrayLike, turn: Floats) -> Floats:
    """The 4 x 4 pose at a position, turned by an axis times an angle (rad)."""
    pose = np.eye(4)
    pose[:3, 3] = position
    angle = float(np.linalg.norm(turn))
    if angle:
        x, y, z = turn / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        pose[:3, :3] += sin(angle) * cross + (1 - cos(angle)) * cross @ cross
    return pose


def _object(table: Table) -> Object:
    shape = table.choice("shape", ("plane", "box", "cylinder", "sphere", "board"))
    pose = _pose(table)
    surface: Surface
    board: Board | None = None
    try:
        if shape == "plane":
            size = table.numbers("size_mm", (0, 2), ())
            surface = Plane((size[0], size[1]) if size else None, pose)
        elif shape == "box":
            x, y, z = table.numbers("size_mm", (3,))
            surface = Box((x, y, z), pose)
        elif shape == "cylinder":
            surface = Cylinder(table.number("radius_mm"), table.number("height_mm"), pose)
        elif shape == "board":
            board = _board(table)
            surface = Plane(board.size_mm, pose)
        else:
            surface = Sphere(table.number("radius_mm"), pose)
    except ValueError as error:
        table.fail("shape", f"{shape} can't be: {error}")
    albedo = table.numbers("albedo", (3,), low=0, high=1)
    table.finish()
    return Object(surface, albedo, board)


def _board(table: Table) -> Board:
    pattern = table.choice("pattern", ("charuco", "chessboard"))
    square_mm = table.number("square_mm", above=0)
    left, top, right, bottom = table.numbers("margins_mm", (4,), Board.margins_mm, low=0)
    board = Board(
        pattern,
        table.integer("columns", low=3, high=100),
        table.integer("rows", low=3, high=100),
        square_mm,
        table.number("marker_mm", 0.75 * square_mm if pattern == "charuco" else 0.0, low=0),
        table.word("dictionary", Board.dictionary),
        table.integer("first_marker", 0, low=0),
        (left, top, right, bottom),
        table.boolean("mirrored", False),
    )
    if pattern == "charuco":
        _ = board.print  # so that what can't be printed is found now
    return board


def _camera(table: Table) -> tuple[Camera, Timing]:
    camera = Camera(
        table.integer("width", low=16, high=4096),
        table.integer("height", low=16, high=4096),
        table.matrix("matrix", 3, 3),
        table.numbers("distortion", (4, 5, 8), (0.0,) * 5),
        table.number("noise", low=0),
        table.number("gain", 1.0, above=0),
        table.number("black_level", 0.0, low=0),
        table.number("blur_px", 0.0, low=0),
    )
    if camera.matrix[0][0] <= 0 or camera.matrix[1][1] <= 0 or camera.matrix[2] != (0.0, 0.0, 1.0):
        table.fail("matrix", f"needs positive focal lengths and the last row 0, 0, 1, not {camera.matrix}")
    row_time_us = table.number("row_time_us", 0.0, low=0)
    timing = Timing(
        camera.height,
        table.number("frame_rate_hz", above=0),
        row_time_us * 1e-6 if row_time_us else None,
        table.number("exposure_ms", low=0) * 1e-3,
        table.number("readout_delay_ms", low=0) * 1e-3,
    )
    table.finish()
    return camera, timing


def _laser(table: Table) -> Laser:
    matrix = table.matrix("camera_from_laser", 4, 4)
    try:
        Plane(None, matrix)  # checks that it is a rigid transformation
    except ValueError as error:
        table.fail("camera_from_laser", f"is not a pose: {error}")
    sense = table.integer("sense", 1, low=-1, high=1)
    if sense == 0:
        table.fail("sense", "has to be 1 or -1, not 0")
    laser = Laser(
        matrix,
        table.number("offset_mm", 0.0),
        radians(table.number("tilt_deg", 0.0)),
        radians(table.number("zero_deg", 0.0)),
        sense,
        table.number("peak", low=0),
        table.number("reference_mm", above=0),
        table.number("waist_mm", above=0),
        table.number("divergence_mrad", low=0) * 1e-3,
        table.numbers("response", (3,), low=0, high=1),
        table.number("speckle", low=0),
    )
    if max(laser.response) != 1:
        table.fail("response", f"has to have 1 as its greatest number, not {max(laser.response):g}")
    table.finish()
    return laser


def _water(table: Table) -> Water:
    panes = []
    for part in ("camera_port", "laser_port"):
        port = table.table(part)
        normal = np.array(port.numbers("normal", (3,), (0.0, 0.0, 1.0)))
        if not np.linalg.norm(normal):
            port.fail("normal", "has to point into the water, not be 0, 0, 0")
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        thickness, index = port.number("thickness_mm", 8.0, low=0), port.number("glass_index", 1.49, low=1)
        panes.append(Pane(port.number("distance_mm", above=0), (x, y, z), thickness, index))
        port.finish()
    water = Water(
        table.number("index", 1.333, low=1),
        panes[0],
        panes[1],
        table.number("apex_beam_mm", 0.0),
        table.number("apex_axis_mm", 0.0),
        table.numbers("attenuation_per_m", (3,), (0.0, 0.0, 0.0), low=0),
        table.numbers("veil", (3,), (0.0, 0.0, 0.0), low=0, high=1),
        table.number("scatter_mrad", 0.0, low=0),
        table.number("glow", 0.0, low=0),
    )
    table.finish()
    return water


def _scene(name: str, table: Table) -> Scene:
    camera, timing = _camera(table.table("camera"))
    laser = _laser(table.table("laser"))
    encoder = table.table("encoder")
    counts = encoder.integer("counts_per_turn", low=16)
    if counts % 4:
        encoder.fail("counts_per_turn", f"has to be divisible by 4, not {counts}")
    width = encoder.integer("index_width_counts", min(INDEX_WIDTH_COUNTS, counts // 4), high=counts - 1)
    flaws = Flaws(
        encoder.number("line_error_counts", 0.0, low=0),
        encoder.number("jitter_us", 0.0, low=0) * 1e-6,
        encoder.integer("seed", 0, low=0),
    )
    encoder.finish()
    motor = table.table("motor")
    parameters = MotorParameters(
        motor.number("supply_v", above=0),
        motor.number("resistance_ohm", above=0),
        motor.number("torque_constant_nm_a", above=0),
        motor.number("inertia_kg_m2", above=0),
        motor.number("viscous_nm_s", low=0),
        motor.number("friction_nm", low=0),
        motor.number("stiction_nm", 0.0, low=0),
        motor.number("supply_ripple", 0.0, low=0),
        motor.number("ripple_hz", 100.0, above=0),
    )
    start_rad = radians(motor.number("start_deg"))
    motor.finish()
    light = table.table("ambient")
    ambient = Ambient(
        light.numbers("colour", (3,), low=0, high=255),
        light.numbers("direction", (3,)),
        light.number("diffuse", low=0),
    )
    if not np.linalg.norm(ambient.direction):
        light.fail("direction", "has to point somewhere, not be 0, 0, 0")
    light.finish()
    scan_table = table.table("scan")
    scan = Scan(
        scan_table.integer("frames"),
        radians(scan_table.number("start_deg")),
        radians(scan_table.number("end_deg")),
    )
    scan_table.finish()
    water = _water(table.table("water")) if table.has("water") else None
    objects = tuple(_object(item) for item in table.tables("object"))
    table.finish()
    return Scene(
        name, camera, timing, laser, counts, width, flaws, parameters, start_rad, ambient, objects, scan, water
    )


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
