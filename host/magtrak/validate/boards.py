"""Boards as references for the paper's tests: their corners in a picture, and where they stand."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Floats, Integers
from ..calibrate.board import Board
from ..calibrate.detect import Picture, detect
from ..camera import CameraModel
from ..errors import CalibrationError, MagtrakError

LEAST_CORNERS = 8


@dataclass(frozen=True)
class Target:
    """One or more boards that are fixed to each other.

    Attributes
    ----------
    boards : each with its pose (4, 4): points of the board's frame to the target's
    """

    boards: list[tuple[Board, Floats]]

    @classmethod
    def load(cls, path: Path) -> "Target":
        """From JSON: ``{"boards": [{"pattern": ..., "columns": ..., ..., "pose": [[...]]}]}``; a pose may be left out.

        Raises
        ------
        MagtrakError
            It can't be read, or describes no board.
        """
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            return cls([(_board(entry), np.array(entry.get("pose", np.eye(4)), float)) for entry in values["boards"]])
        except OSError as error:
            raise MagtrakError(f"the target {path} cannot be read: {error.strerror}") from None
        except (ValueError, KeyError, TypeError) as error:
            raise MagtrakError(f"the target {path} does not describe boards: {error!r}") from None


def _board(entry: dict[str, Any]) -> Board:
    band = entry.get("band_mm")
    return Board(
        str(entry.get("name", "board")),
        entry["pattern"],
        entry["columns"],
        entry["rows"],
        entry["square_mm"],
        entry.get("marker_mm", 0.0),
        entry.get("dictionary", "DICT_5X5_100"),
        first_marker=entry.get("first_marker", 0),
        band_mm=None if band is None else (band[0], band[1], band[2], band[3]),
    )


def corners(picture: Picture, board: Board) -> tuple[Integers, Floats]:
    """Numbers (N,) and pixels (N, 2) of a board's corners; :exc:`CalibrationError` where too few are seen."""
    found = detect(picture, board, "of the board")
    if len(found.ids) < LEAST_CORNERS:
        raise CalibrationError(
            f"{len(found.ids)} corners of board {board.name} are seen in the picture, {LEAST_CORNERS} are needed: is it"
            " this board, is it sharp and bright enough?"
        )
    return found.ids, found.corners


def pose(camera: CameraModel, points: Floats, pixels: Floats) -> Floats:
    """The 4 x 4 pose in C at which points (N, 3) are seen at pixels (N, 2).

    Least squares in the picture, from OpenCV's closed form. In air only.
    """
    import cv2
    from scipy.optimize import least_squares

    rays = camera.ray(pixels[:, 0], pixels[:, 1])
    flat = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
    good, turn, shift = cv2.solvePnP(points, flat, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    if not good:
        raise CalibrationError("no pose of the board explains its corners: is it the right board, and calibration?")

    def at(six: Floats) -> Floats:
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = cv2.Rodrigues(six[:3])[0], six[3:]
        return result

    def misses(six: Floats) -> Floats:
        here = at(six)
        return np.asarray((camera.project(points @ here[:3, :3].T + here[:3, 3]) - pixels).ravel())

    start = np.concatenate([turn.ravel(), shift.ravel()])
    return at(least_squares(misses, start, loss="soft_l1", f_scale=0.2, x_scale="jac").x)


def seen(camera: CameraModel, picture: Picture, target: Target) -> Floats:
    """The 4 x 4 pose of the target's frame in C."""
    points, pixels = [], []
    for board, place in target.boards:
        ids, at = corners(picture, board)
        flat = np.column_stack([board.points(ids), np.zeros(len(ids))])
        points.append(flat @ place[:3, :3].T + place[:3, 3])
        pixels.append(at)
    return pose(camera, np.concatenate(points), np.concatenate(pixels))


def on_plane(camera: CameraModel, u: Floats, v: Floats, plane: Floats) -> Floats:
    """Where the rays of pixels (N,) meet the plane Z = 0 of a frame of 4 x 4 pose ``plane``: (N, 3) of that frame."""
    rays = camera.ray(u, v)
    normal = plane[:3, 2]
    way = ((plane[:3, 3] - camera.centre) @ normal) / (rays @ normal)
    return np.asarray((camera.centre + way[:, None] * rays - plane[:3, 3]) @ plane[:3, :3])
