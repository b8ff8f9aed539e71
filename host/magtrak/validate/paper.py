"""The paper's own tests: of the camera (eq 11, Table 1), of the laser (eq 12), and of a slit on a plane (Example 1).

They measure what they test by something else: a board whose place a picture tells. The paper's figures stand beside
ours as printed there, its evident slips corrected: Table 1's errors are 0.89 and 1.87 mm, and its laser's distances,
193 mm over 2108 mm, make 5.231 degrees, where the encoder said 5.0.
"""

from math import degrees

import numpy as np

from ..arrays import Booleans, Floats, Numbers, Records
from ..calibrate.detect import Picture
from ..calibrate.linear import linear_camera
from ..calibration import Calibration
from ..camera import CameraModel, Projection
from ..errors import MagtrakError
from ..laser import Laser
from .artefacts import Result
from .boards import Target, corners, on_plane, pose, seen
from .report import Line

MARGIN_MM = 12.0
"""So far from the border of the blank band the line is measured."""

LEAST_ROWS = 8
TABLE_1 = ("0.89 mm on its plane X = 0", "1.87 mm on its plane Y = 0")


def camera_test(calibration: Calibration, picture: Picture, target: Target) -> Result:
    """Eq 11: one coordinate of a point is known (it lies on a board), the picture gives the other two.

    Every second corner places the target, the others are measured. Beside it the paper's way: a 3 x 4 matrix from the
    same corners, and eq 11 solved for two coordinates; it needs boards in two planes.
    """
    camera = calibration.camera.build()
    known, tested = [], []
    for number, (board, place) in enumerate(target.boards):
        ids, pixels = corners(picture, board)
        flat = np.column_stack([board.points(ids), np.zeros(len(ids))])
        half = (ids % (board.columns - 1) + ids // (board.columns - 1)) % 2 == 0
        known.append((flat[half] @ place[:3, :3].T + place[:3, 3], pixels[half]))
        tested.append((number, place, flat[~half], pixels[~half]))
    points, pixels = (np.concatenate(parts) for parts in zip(*known, strict=True))
    there = pose(camera, points, pixels)
    linear = Projection(linear_camera(points, pixels).matrix) if len(target.boards) > 1 else None
    lines = []
    for number, place, flat, at in tested:
        ours = on_plane(camera, at[:, 0], at[:, 1], there @ place) - flat
        theirs = None
        if linear is not None:
            # The matrix is from the target's frame: the board's plane is given in it.
            theirs = _rms(np.linalg.norm((on_plane(linear, at[:, 0], at[:, 1], place) - flat)[:, :2], axis=1))
        error = np.linalg.norm(ours[:, :2], axis=1)
        paper = TABLE_1[number] if number < len(TABLE_1) else ""
        lines.append(Line(f"board {number + 1}: {len(at)} corners, RMS", _rms(error), "mm", None, paper, theirs))
        lines.append(Line(f"board {number + 1}: greatest", float(error.max())))
    return Result(lines)


def laser_test(calibration: Calibration, cloud: Records, picture: Picture, target: Target) -> Result:
    """Eq 12: where the line falls on a plane tells the laser's angle; the encoder tells it too.

    The plane is a board whose place the picture tells; where the line is on it, camera and board alone say.
    """
    camera, laser = calibration.camera.build(), calibration.laser
    board_pose = seen(camera, picture, target)
    frames, on_band = _band(camera, cloud, board_pose, target)
    pose_l = laser.camera_from_laser
    rows = []
    for frame in np.unique(frames[on_band]):
        mine = on_band & (frames == frame)
        if mine.sum() < LEAST_ROWS:
            continue
        at = on_plane(camera, *_pixels(cloud[mine]), board_pose) @ board_pose[:3, :3].T + board_pose[:3, 3]
        local = (at - pose_l[:3, 3]) @ pose_l[:3, :3]
        rows.append((cloud["scalar_angle"][mine].mean(), _angle_through(laser, local).mean(), *local.mean(axis=0)))
    if len(rows) < 3:
        raise MagtrakError(
            f"{len(rows)} pictures have the line on the board's blank band, 3 are needed: sweep the laser across it"
        )
    encoder, real, *_ = table = np.array(rows).T
    error = np.degrees(real - encoder)
    ahead = np.argmin(np.abs(encoder))
    turned = int(np.argmin(np.abs(encoder - encoder[ahead] - np.radians(5))))
    across = float(table[3][turned] - table[3][ahead])
    lines = [
        Line("d_theta, from the axis to the plane", float(table[2][turned]), "mm", None, "2108 mm"),
        Line("d_a, the line's way on it", abs(across), "mm", None, "193 mm"),
        Line("angle by the encoder", degrees(encoder[turned] - encoder[ahead]), "deg", None, "5.0 deg"),
        Line("angle by the distances (eq 12)", degrees(real[turned] - real[ahead]), "deg", None, "5.231 deg"),
        Line("  error", degrees(real[turned] - real[ahead]) - degrees(encoder[turned] - encoder[ahead]), "deg", None,
             "0.231 deg"),
        Line(f"error of the angle over {len(error)} pictures: mean", float(error.mean()), "deg"),
        Line("  RMS about it", float(error.std()), "deg"),
        Line("  the same at the plane, RMS of all", _rms(np.radians(error)) * float(np.mean(table[2])), "mm", None,
             "8.5 mm"),
    ]  # fmt: skip
    return Result(lines)


def slit_test(
    calibration: Calibration, cloud: Records, picture: Picture, target: Target, angle_rad: float, other: Records | None
) -> Result:
    """Example 1: one slit on a plane, reconstructed; how far from the plane it comes out, and how far along it.

    Parameters
    ----------
    angle_rad : the picture whose angle is nearest to it is taken
    other : the same by the paper's method, shown beside
    """
    camera = calibration.camera.build()
    board_pose = seen(camera, picture, target)
    ours = _slit(camera, cloud, board_pose, target, angle_rad)
    theirs = (None, None, None) if other is None else _slit(camera, other, board_pose, target, angle_rad)[1:]
    names = ("off the plane, mean", "off the plane, RMS about it", "along the plane, mean")
    papers = ("17 mm (Y_L)", "", "13 mm (X_L)")
    lines = [Line("angle of the laser", degrees(ours[0]), "deg", None, "10 deg")]
    lines += [
        Line(name, value, "mm", None, paper, beside)
        for name, value, paper, beside in zip(names, ours[1:], papers, theirs, strict=True)
    ]
    return Result(lines)


def _slit(
    camera: CameraModel, cloud: Records, board_pose: Floats, target: Target, angle_rad: float
) -> tuple[float, float, float, float]:
    frames, on_band = _band(camera, cloud, board_pose, target)
    numbers = [n for n in np.unique(frames[on_band]) if (on_band & (frames == n)).sum() >= LEAST_ROWS]
    if not numbers:
        raise MagtrakError("no picture has the line on the board's blank band: sweep the laser across the board")
    angles = np.array([cloud["scalar_angle"][frames == n].mean() for n in numbers])
    best = int(np.argmin(np.abs(angles - angle_rad)))
    mine = on_band & (frames == numbers[best])
    points = np.stack([cloud[name][mine] for name in "xyz"], axis=-1).astype(np.float64)
    local = (points - board_pose[:3, 3]) @ board_pose[:3, :3]
    true = on_plane(camera, *_pixels(cloud[mine]), board_pose)
    off = local[:, 2]
    along = float(np.linalg.norm((local - true)[:, :2].mean(axis=0)))
    return float(angles[best]), float(abs(off.mean())), float(off.std()), along


def _band(camera: CameraModel, cloud: Records, board_pose: Floats, target: Target) -> tuple[Numbers, Booleans]:
    """Frame of each point, and whether its pixel looks at the blank band of the first board."""
    board, place = target.boards[0]
    at = on_plane(camera, *_pixels(cloud), board_pose @ place)[:, :2]
    inside = board.on_band(at)
    for side in ([MARGIN_MM, 0], [-MARGIN_MM, 0], [0, MARGIN_MM], [0, -MARGIN_MM]):
        inside &= board.on_band(at + side)
    return cloud["scalar_frame"], inside


def _pixels(cloud: Records) -> tuple[Floats, Floats]:
    return cloud["scalar_column"].astype(np.float64), cloud["scalar_row"].astype(np.float64)


def _angle_through(laser: Laser, local: Floats) -> Floats:
    """Angles at which the plane goes through points (N, 3) of L, on the side where the light is."""
    rho = np.cos(laser.tilt_rad) * np.hypot(local[:, 0], local[:, 1])
    lead = np.arcsin((laser.offset_mm - np.sin(laser.tilt_rad) * local[:, 2]) / rho)
    return np.asarray(np.arctan2(local[:, 1], local[:, 0]) - lead)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
