"""Calibrations simulated on the observation level: corners and rows with noise, of a rig unknown to the tools.

All geometry is ``sim.optics``'s or written here; nothing of it is the host's.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from magtrak.calibrate.board import A3, LARGE, Board
from magtrak.calibrate.joint import difference
from magtrak.calibrate.observations import Lines, Observations, View
from magtrak.calibrate.procedure import error_table
from magtrak.calibrate.rig import CAMERA, ENCODER, LASER
from magtrak.calibrate.solve import Solution
from magtrak.calibration import Calibration, CameraCalibration
from magtrak.laser import Laser as HostLaser
from magtrak.triangulate import triangulate
from sim.optics import Camera, Laser

WIDTH, HEIGHT = 640, 480
COUNTS = 8192
FRAME_RATE, ROW_S = 50.0, 0.8 * 0.02 / HEIGHT


@dataclass(frozen=True)
class TrueRig:
    """What the tools shall find.

    Attributes
    ----------
    harmonics : counts, cos and sin once and twice a turn
    time_s : time offset
    """

    camera: Camera
    laser: Laser
    time_s: float = 0.0
    harmonics: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    counts_per_turn: int = COUNTS

    def position(self, counts: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """The motor's true position where the encoder shows ``counts`` at a row's time."""
        x = counts + rate * self.time_s
        turn = 2 * np.pi * x / self.counts_per_turn
        c1, s1, c2, s2 = self.harmonics
        return x + c1 * np.cos(turn) + s1 * np.sin(turn) + c2 * np.cos(2 * turn) + s2 * np.sin(2 * turn)

    def planes(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """n . P = d of positions in counts: (N, 3), (N,)."""
        alpha = self.laser.alpha(2 * np.pi * position / self.counts_per_turn)
        tilt = self.laser.tilt_rad
        n = np.stack(
            [-np.sin(alpha) * np.cos(tilt), np.cos(alpha) * np.cos(tilt), np.full_like(alpha, np.sin(tilt))], -1
        )
        pose = np.asarray(self.laser.camera_from_laser)
        n = n @ pose[:3, :3].T
        return n, n @ pose[:3, 3] + self.laser.offset_mm


def rotation(turn: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return np.eye(3)
    x, y, z = turn / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def random_rig(rng: np.random.Generator) -> TrueRig:
    """A rig as in the paper, 0.5 m from camera to laser at 2 m, and everything a little off."""
    f = 800 + rng.normal(0, 10)
    matrix = (
        (f, 0.0, 319.5 + rng.normal(0, 8)),
        (0.0, f * (1 + rng.normal(0, 1e-3)), 239.5 + rng.normal(0, 8)),
        (0.0, 0.0, 1.0),
    )
    k = (rng.normal(-0.12, 0.05), rng.normal(0.08, 0.05), rng.normal(0, 5e-4), rng.normal(0, 5e-4), 0.0)
    camera = Camera(WIDTH, HEIGHT, matrix, k, 0.0, 1.0, 0.0)
    down = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # axis down, light forward at alpha = 0
    pose = np.eye(4)
    pose[:3, :3] = rotation(rng.normal(0, 0.02, 3)) @ down
    pose[:3, 3] = [-500 + rng.normal(0, 10), rng.normal(0, 10), rng.normal(0, 10)]
    # Aimed so that alpha = 0.25 rad meets the camera's axis at 2 m.
    laser = Laser(
        tuple(map(tuple, pose)),
        rng.normal(0, 1.0),
        rng.normal(0, 0.01),
        rng.normal(0.1, 0.1),
        int(rng.choice([-1, 1])),
        180.0,
        2000.0,
        0.5,
        0.3,
        (0.1, 1.0, 0.1),
        0.0,
    )
    return TrueRig(camera, laser, rng.normal(-8e-3, 3e-3), tuple(rng.normal(0, (1.0, 1.0, 0.3, 0.3))))


@dataclass
class Procedure:
    """The guided procedure, and what goes wrong with it.

    Parameters
    ----------
    views : placements, half of them of each board
    angles : laser images of each placement, swept forward and backward in turn
    corner_px, line_px, angle_counts : noise, 1 sigma
    outliers : part of the rows that are off by up to 5 px
    true_boards : boards as they really are, where not as described
    """

    views: int = 30
    angles: int = 3
    corner_px: float = 0.05
    line_px: float = 0.025
    angle_counts: float = 0.01
    outliers: float = 0.0
    scale_sigma: float = 0.0
    rate_deg_s: float = 7.5
    boards: tuple[Board, ...] = (A3, LARGE)
    distances_mm: tuple[tuple[float, float], ...] = ((450.0, 1300.0), (1200.0, 3000.0))
    tilt_rad: float = 0.6
    both_ways: bool = True
    poses: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    def observe(self, rig: TrueRig, rng: np.random.Generator) -> Observations:
        """Corners and lines of random placements."""
        views = []
        self.poses = []
        boards = [replace(board, scale_sigma=self.scale_sigma) for board in self.boards]
        scales = [1 + rng.normal(0, self.scale_sigma) if self.scale_sigma else 1.0 for _ in boards]
        while len(views) < self.views:
            which = len(views) % len(boards)
            near, far = self.distances_mm[which]
            pose = self._place(rig, boards[which], near, far, rng)
            view = self._view(rig, f"view {len(views) + 1}", boards[which], scales[which], pose, rng)
            if view is not None:
                views.append(view)
                self.poses.append(pose)
        return Observations(rig.camera.width, rig.camera.height, views, rig.counts_per_turn)

    def _place(
        self, rig: TrueRig, board: Board, near: float, far: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """The board's middle somewhere in the picture, tilted, in some views on its side."""
        distance = np.exp(rng.uniform(np.log(near), np.log(far)))
        u, v = rng.uniform(0.15, 0.85) * WIDTH, rng.uniform(0.15, 0.85) * HEIGHT
        middle = rig.camera.rays([u], [v])[0] * distance
        turn = rotation(np.append(rng.uniform(-self.tilt_rad, self.tilt_rad, 2), 0))
        turn = turn @ rotation(np.array([0, 0, rng.choice([0.0, np.pi / 2, -np.pi / 2]) + rng.normal(0, 0.1)]))
        width, height = board.size_mm
        return turn, middle - turn @ [width / 2, height / 2, 0]

    def _view(
        self,
        rig: TrueRig,
        name: str,
        board: Board,
        scale: float,
        pose: tuple[np.ndarray, np.ndarray],
        rng: np.random.Generator,
    ) -> View | None:
        turn, shift = pose
        ids = np.arange(board.corners)
        flat = np.c_[board.points(ids) * scale, np.zeros(len(ids))]
        points = flat @ turn.T + shift
        if points[:, 2].min() < 100:
            return None
        px = rig.camera.project(points)
        inside = (px > 5).all(1) & (px < [WIDTH - 6, HEIGHT - 6]).all(1)
        if inside.sum() < 12:
            return None
        ids, px = ids[inside], px[inside]
        px = px + rng.normal(0, self.corner_px, px.shape)
        lines = self.lines(rig, board, pose, rng) if self.angles else Lines()
        if self.angles and len(np.unique(lines.image)) < self.angles:
            return None
        return View(name, board, ids, px, lines)

    def lines(self, rig: TrueRig, board: Board, pose: tuple[np.ndarray, np.ndarray], rng: np.random.Generator) -> Lines:
        """Laser lines on the board's band, at places spread over it."""
        turn, shift = pose
        assert board.band_mm is not None
        left, top, right, bottom = board.band_mm
        parts = []
        for image in range(self.angles):
            x = left + (right - left) * (image + rng.uniform(0.2, 0.8)) / self.angles
            y = top + (bottom - top) * (image + rng.uniform(0.2, 0.8)) / self.angles
            target = turn @ [x, y, 0] + shift
            alpha, _ = rig.laser.meets(rig.laser.points(target[None]))
            middle = rig.laser.sense * (alpha[0] - rig.laser.zero_rad) / (2 * np.pi) * rig.counts_per_turn
            sign = (-1.0) ** image if self.both_ways else 1.0
            rate = sign * rig.counts_per_turn * self.rate_deg_s / 360
            parts.append(self.line(rig, pose, image, float(middle), rate, board.band_mm, rng))
        return Lines(
            *(np.concatenate([getattr(p, n) for p in parts]) for n in ("image", "row", "column", "counts", "rate"))
        )

    def line(
        self,
        rig: TrueRig,
        pose: tuple[np.ndarray, np.ndarray],
        image: int,
        middle: float,
        rate: float,
        band: tuple[float, float, float, float] | None,
        rng: np.random.Generator,
    ) -> Lines:
        """One image of the line, the encoder at ``middle`` counts in its middle row; rows within the band."""
        turn, shift = pose
        row = self.rows(rig, pose, band)
        if len(row) < 5:
            return Lines()
        counts = middle + rate * ROW_S * (row - HEIGHT / 2)
        rates = np.full(len(row), rate)
        wobble = rng.normal(0, self.angle_counts) if self.angle_counts else 0.0
        n, d = rig.planes(rig.position(counts + wobble, rates))

        def height(u: np.ndarray) -> np.ndarray:
            rays = rig.camera.rays(u, row)
            points = rays * ((turn[:, 2] @ shift) / (rays @ turn[:, 2]))[:, None]
            return np.sum(n * points, 1) - d

        u = np.full(len(row), WIDTH / 2.0)
        step = 1.0
        for _ in range(12):  # Newton with a numerical slope
            here = height(u)
            slope = (height(u + step) - here) / step
            before, u = u, np.clip(u - here / slope, -200.0, WIDTH + 200.0)
            if np.abs(u - before).max() < 1e-9:
                break
            step = 1e-3
        rays = rig.camera.rays(u, row)
        points = rays * ((turn[:, 2] @ shift) / (rays @ turn[:, 2]))[:, None]
        local = (points - shift) @ turn
        use = (u > 8) & (u < WIDTH - 9) & (np.abs(height(u)) < 1e-6) & (points[:, 2] > 100)
        if band is not None:
            left, top, right, bottom = band
            margin = 12 * points[:, 2] / 800
            use &= (local[:, 0] > left + margin) & (local[:, 0] < right - margin)
            use &= (local[:, 1] > top + margin / 6) & (local[:, 1] < bottom - margin / 6)
        if use.sum() < 5:
            return Lines()
        u = u + rng.normal(0, self.line_px, len(row)) if self.line_px else u
        if self.outliers:
            wrong = rng.random(len(row)) < self.outliers
            u = np.where(wrong, u + rng.uniform(-5, 5, len(row)), u)
        return Lines(np.full(len(row), image)[use], row[use], u[use], counts[use], rates[use])

    @staticmethod
    def rows(
        rig: TrueRig, pose: tuple[np.ndarray, np.ndarray], band: tuple[float, float, float, float] | None
    ) -> np.ndarray:
        """Rows of the picture in which the band may be seen."""
        if band is None:
            return np.arange(HEIGHT, dtype=float)
        turn, shift = pose
        left, top, right, bottom = band
        flat = np.array([[x, y, 0.0] for x in np.linspace(left, right, 9) for y in (top, bottom)])
        points = flat @ turn.T + shift
        seen = rig.camera.project(points[points[:, 2] > 100])[:, 1]
        if not len(seen):
            return np.zeros(0)
        return np.arange(max(np.floor(seen.min()), 0), min(np.ceil(seen.max()), HEIGHT - 1) + 1)


@dataclass(frozen=True)
class PlaneError:
    """What a calibration makes of a perfect plane that faces the camera, mm: RMS from the plane fitted to it, greatest
    distance of a point from where it is, and relative error of lengths on it.
    """

    form: float
    place: float
    scale: float


def plane_error(true: TrueRig, found: Calibration, distance_mm: float) -> PlaneError:
    """Triangulates, without noise, what the true rig sees of the plane Z = distance."""
    wide, high = true.camera.width, true.camera.height
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(10, wide - 11, 24), np.linspace(10, high - 11, 18)))
    real = true.camera.rays(u, v) * distance_mm
    alpha, _ = true.laser.meets(true.laser.points(real))
    position = true.laser.sense * (alpha - true.laser.zero_rad) / (2 * np.pi) * true.counts_per_turn
    counts = position.copy()
    for _ in range(6):  # what the encoder shows there, time offset aside
        counts -= replace(true, time_s=0.0).position(counts, np.zeros_like(counts)) - position
    camera = found.camera.build()
    planes = found.laser.planes(found.laser.alpha(counts))
    points = triangulate(camera.centre, camera.ray(u, v), *planes).points
    middle = points.mean(0)
    normal = np.linalg.svd(points - middle)[2][2]
    form = np.sqrt(np.mean(((points - middle) @ normal) ** 2))
    spread = [np.sqrt(np.mean(np.sum((cloud - cloud.mean(0)) ** 2, 1))) for cloud in (points, real)]
    return PlaneError(float(form), float(np.linalg.norm(points - real, axis=1).max()), float(spread[0] / spread[1] - 1))


def as_calibration(found: Solution) -> Calibration:
    """What a file would hold of a fit."""
    rig = found.rig
    assert rig.laser is not None
    camera = CameraCalibration("brown-conrady", WIDTH, HEIGHT, rig.matrix, rig.camera[4:], rig.time_s)
    return Calibration(camera, replace(rig.laser, error_table=error_table(rig)))


def deviations(true: TrueRig, found: Solution) -> dict[str, tuple[float, float]]:
    """Name of each shared parameter: estimate less truth, and its sigma."""
    rig = found.rig
    m, k = true.camera.matrix, true.camera.distortion
    real = np.array([m[0][0], m[1][1], m[0][2], m[1][2], *k])
    result = {name: rig.camera[i] - real[i] for i, name in enumerate(CAMERA)}
    if rig.laser is not None:
        laser = true.laser
        host = HostLaser(
            np.asarray(laser.camera_from_laser),
            laser.offset_mm,
            laser.tilt_rad,
            laser.zero_rad,
            laser.sense,
            true.counts_per_turn,
        )
        result |= dict(zip(LASER, -difference(host, rig.laser), strict=True))
        result["time"] = rig.time_s - true.time_s
        result |= {name: rig.harmonics[i] - true.harmonics[i] for i, name in enumerate(ENCODER[1:])}
    return {name: (float(value), found.sigma(name)) for name, value in result.items() if name in found.names}
