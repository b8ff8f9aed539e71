"""What a scene consists of beside the rig's optics, and how the tables of a scene file are read.

Each reader takes a :class:`.tables.Table`, which tells file, field and value of what is wrong as a :exc:`.SimError`.
"""

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from .boards import Board
from .encoder import Flaws
from .motor import INDEX_WIDTH_COUNTS, MotorParameters
from .optics import Camera, Laser
from .surfaces import Box, Cylinder, Floats, Plane, Sphere, Surface
from .tables import Table
from .timing import Timing
from .water import Pane, Water


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


def read_object(table: Table) -> Object:
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


def read_camera(table: Table) -> tuple[Camera, Timing]:
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


def read_laser(table: Table) -> Laser:
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


def read_encoder(table: Table) -> tuple[int, int, Flaws]:
    """Counts a turn, width of the index mark in counts, and flaws."""
    counts = table.integer("counts_per_turn", low=16)
    if counts % 4:
        table.fail("counts_per_turn", f"has to be divisible by 4, not {counts}")
    width = table.integer("index_width_counts", min(INDEX_WIDTH_COUNTS, counts // 4), high=counts - 1)
    flaws = Flaws(
        table.number("line_error_counts", 0.0, low=0),
        table.number("jitter_us", 0.0, low=0) * 1e-6,
        table.integer("seed", 0, low=0),
    )
    table.finish()
    return counts, width, flaws


def read_motor(table: Table) -> tuple[MotorParameters, float]:
    """The motor, and where it stands (rad)."""
    parameters = MotorParameters(
        table.number("supply_v", above=0),
        table.number("resistance_ohm", above=0),
        table.number("torque_constant_nm_a", above=0),
        table.number("inertia_kg_m2", above=0),
        table.number("viscous_nm_s", low=0),
        table.number("friction_nm", low=0),
        table.number("stiction_nm", 0.0, low=0),
        table.number("supply_ripple", 0.0, low=0),
        table.number("ripple_hz", 100.0, above=0),
    )
    start_rad = radians(table.number("start_deg"))
    table.finish()
    return parameters, start_rad


def read_ambient(table: Table) -> Ambient:
    ambient = Ambient(
        table.numbers("colour", (3,), low=0, high=255),
        table.numbers("direction", (3,)),
        table.number("diffuse", low=0),
    )
    if not np.linalg.norm(ambient.direction):
        table.fail("direction", "has to point somewhere, not be 0, 0, 0")
    table.finish()
    return ambient


def read_scan(table: Table) -> Scan:
    scan = Scan(
        table.integer("frames"),
        radians(table.number("start_deg")),
        radians(table.number("end_deg")),
    )
    table.finish()
    return scan


def read_water(table: Table) -> Water:
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
