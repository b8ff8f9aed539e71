"""The model that is fitted: camera, board poses, laser, encoder, time; and what it predicts of each observation.

Every parameter has a local coordinate, 0 at the present estimate; :meth:`Rig.moved` takes a step in them. Rotations
move by a small turn in their own frame, so that no parametrisation of them is ever singular.

==================== ========= =============================================================================
``fx fy cx cy``      px        pinhole
``k1 k2 p1 p2 k3``             distortion, OpenCV's order
``axis_x axis_y``    rad       turn of the laser's axis about X_L and Y_L
``shift_x shift_y``  mm        shift of the axis along X_L and Y_L
``tilt zero``        rad       of the laser plane; angle at the index
``offset``           mm        of the laser plane from the axis
``time``             s         time offset: rate times it is added to the counts
``cos1 sin1``        counts    once-a-turn error of the encoder (an eccentric disc)
``cos2 sin2``        counts    twice-a-turn error
``scale``                      of each board, relative
(pose)               rad, mm   turn and shift of each board, 6 a view
(angle)              counts    error of the angle of each laser image
==================== ========= =============================================================================
"""

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Floats, Integers
from ..camera import BrownConrady
from ..laser import Laser
from .observations import Observations

CAMERA = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
LASER = ("axis_x", "axis_y", "shift_x", "shift_y", "tilt", "offset", "zero")
ENCODER = ("time", "cos1", "sin1", "cos2", "sin2")

STEPS = dict.fromkeys(CAMERA[:4], 1e-3) | dict.fromkeys(CAMERA[4:], 1e-6)
STEPS |= dict(zip(LASER, (1e-6, 1e-6, 1e-3, 1e-3, 1e-6, 1e-3, 1e-6), strict=True))
STEPS |= dict(zip(ENCODER, (1e-5, 1e-3, 1e-3, 1e-3, 1e-3), strict=True))
"""Steps of the numerical derivatives; each moves the predictions by some 1e-3 px."""

SCALE_STEP = 1e-6
POSE_STEPS = (1e-6, 1e-6, 1e-6, 1e-3, 1e-3, 1e-3)
ANGLE_STEP = 1e-3
UNDISTORTION_STEPS = 25


def turned(rotations: Floats, turns: Floats) -> Floats:
    """R Exp(w) for rotations (..., 3, 3) and turns (..., 3) in rad. Source: Rodrigues' formula."""
    angle = np.linalg.norm(turns, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(turns, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        a = np.where(angle > 1e-8, np.sin(angle) / angle, 1.0)
        b = np.where(angle > 1e-8, (1 - np.cos(angle)) / angle**2, 0.5)
    return np.asarray(rotations @ (np.eye(3) + a * cross + b * cross @ cross))


@dataclass(frozen=True)
class Rig:
    """An estimate of everything.

    Attributes
    ----------
    camera : (9,), see :data:`CAMERA`
    rotations, translations : (V, 3, 3), (V, 3): from B of each view to C
    scales : (boards,)
    laser : None where only the camera is calibrated; its error table is used and kept
    time_s : time offset
    harmonics : (4,) cos1, sin1, cos2, sin2
    angles : (images,) counts
    """

    camera: Floats
    rotations: Floats
    translations: Floats
    scales: Floats
    laser: Laser | None = None
    time_s: float = 0.0
    harmonics: Floats = field(default_factory=lambda: np.zeros(4))
    angles: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def matrix(self) -> Floats:
        fx, fy, cx, cy = self.camera[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def names(self) -> list[str]:
        """The shared parameters, in the order of :meth:`moved`."""
        laser = [*LASER, *ENCODER] if self.laser is not None else []
        return [*CAMERA, *laser, *(f"scale{number}" for number in range(len(self.scales)))]

    def moved(self, shared: Floats, poses: Floats | None = None, angles: Floats | None = None) -> "Rig":
        """After a step: ``shared`` as :meth:`names`, ``poses`` (V, 6), ``angles`` (images,)."""
        rig = replace(self, camera=self.camera + shared[:9])
        at = 9
        if self.laser is not None:
            rig = replace(
                rig,
                laser=moved_laser(self.laser, shared[9:16]),
                time_s=self.time_s + float(shared[16]),
                harmonics=self.harmonics + shared[17:21],
            )
            at = 21
        rig = replace(rig, scales=self.scales + shared[at:])
        if poses is not None:
            rig = replace(
                rig,
                rotations=turned(self.rotations, poses[:, :3]),
                translations=self.translations + poses[:, 3:],
            )
        return rig if angles is None else replace(rig, angles=self.angles + angles)


def moved_laser(laser: Laser, step: Floats) -> Laser:
    """After a step in :data:`LASER`."""
    pose = laser.camera_from_laser.copy()
    pose[:3, 3] += pose[:3, :2] @ step[2:4]
    pose[:3, :3] = turned(pose[:3, :3], np.array([step[0], step[1], 0.0]))
    return replace(
        laser,
        camera_from_laser=pose,
        tilt_rad=laser.tilt_rad + float(step[4]),
        offset_mm=laser.offset_mm + float(step[5]),
        zero_rad=laser.zero_rad + float(step[6]),
    )


def harmonic(counts: Floats, harmonics: Floats, counts_per_turn: int) -> Floats:
    """Counts to add at positions ``counts``: the encoder's error once and twice a turn."""
    turn = 2 * np.pi * counts / counts_per_turn
    c1, s1, c2, s2 = harmonics
    return np.asarray(c1 * np.cos(turn) + s1 * np.sin(turn) + c2 * np.cos(2 * turn) + s2 * np.sin(2 * turn))


class Predictions:
    """Compares a rig with observations.

    Attributes
    ----------
    corner_view : (N,) view of each corner
    line_view, line_image : (M,) view and image (numbered through all views) of each row
    """

    def __init__(self, seen: Observations) -> None:
        self.width, self.height = seen.width, seen.height
        self.counts_per_turn = seen.counts_per_turn
        boards = [board.name for board in seen.boards]
        self.board_of_view: Integers = np.array([boards.index(view.board.name) for view in seen.views])
        numbers = np.arange(len(seen.views))
        self.corner_view: Integers = np.repeat(numbers, [len(view.ids) for view in seen.views])
        self.corner_at: Floats = np.concatenate([view.board.points(view.ids) for view in seen.views])
        self.corner_px: Floats = np.concatenate([view.corners for view in seen.views])
        self.line_view: Integers = np.repeat(numbers, [len(view.lines) for view in seen.views])
        parts = [view.lines for view in seen.views]
        self.row: Floats = np.concatenate([part.row for part in parts])
        self.column: Floats = np.concatenate([part.column for part in parts])
        self.counts: Floats = np.concatenate([part.counts for part in parts])
        self.rate: Floats = np.concatenate([part.rate for part in parts])
        images: list[Integers] = []
        first = 0
        for part in parts:
            found, numbered = np.unique(part.image, return_inverse=True)
            images.append(first + numbered)
            first += len(found)
        self.images = first
        self.line_image: Integers = np.concatenate(images)
        self._known_rays: dict[tuple[bytes, bytes], Floats] = {}

    def model(self, rig: Rig) -> BrownConrady:
        return BrownConrady(rig.matrix, rig.camera[4:], self.width, self.height, UNDISTORTION_STEPS)

    def corners(self, rig: Rig, shift: Floats | None = None) -> Floats:
        """(N, 2) predicted less seen, px; ``shift`` (N, 3) mm in B adds to where the corners are."""
        scale = rig.scales[self.board_of_view][self.corner_view]
        flat = np.concatenate([self.corner_at * scale[:, None], np.zeros((len(scale), 1))], axis=1)
        if shift is not None:
            flat = flat + shift
        points = np.einsum("nij,nj->ni", rig.rotations[self.corner_view], flat) + rig.translations[self.corner_view]
        return self.model(rig).project(points) - self.corner_px

    def heights(self, rig: Rig, columns: Floats | None = None) -> Floats:
        """(M,) signed distance from the laser plane, mm, of where each row's ray meets its board."""
        points = self.on_board(rig, self._rays(rig, self.column if columns is None else columns))
        normals, distance = self.planes(rig)
        return np.asarray(np.einsum("ni,ni->n", normals, points) - distance)

    def _rays(self, rig: Rig, columns: Floats) -> Floats:
        """(M, 3) rays of the rows; kept, for most steps leave the camera as it is."""
        key = (rig.camera.tobytes(), columns.tobytes())
        if key not in self._known_rays:
            if len(self._known_rays) >= 4:
                self._known_rays.pop(next(iter(self._known_rays)))
            self._known_rays[key] = self.model(rig).ray(columns, self.row)
        return self._known_rays[key]

    def on_board(self, rig: Rig, rays: Floats) -> Floats:
        """(M, 3) points of C where the rays of the rows meet their boards."""
        normal = rig.rotations[:, :, 2]
        distance = np.einsum("vi,vi->v", normal, rig.translations)[self.line_view]
        return np.asarray(rays * (distance / np.einsum("ni,ni->n", normal[self.line_view], rays))[:, None])

    def planes(self, rig: Rig) -> tuple[Floats, Floats]:
        """Laser plane of each row: normals (M, 3), distances (M,)."""
        assert rig.laser is not None
        counts = self.counts + self.rate * rig.time_s + rig.angles[self.line_image]
        counts = counts + harmonic(counts, rig.harmonics, self.counts_per_turn)
        return rig.laser.planes(rig.laser.alpha(counts))

    def slopes(self, rig: Rig) -> Floats:
        """(M,) mm of :meth:`heights` for a px of column: turns heights into errors of the column."""
        step = 0.05
        return (self.heights(rig, self.column + step) - self.heights(rig, self.column - step)) / (2 * step)
