"""What really happened in a scan: where the motor was while each row was exposed."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from .errors import SimError
from .scene import Scene
from .surfaces import Floats

PARTS = np.array([0.0, 0.5, 1.0])
"""Parts of the exposure at which the angle is kept: its start, middle and end."""


@dataclass(frozen=True)
class Truth:
    """A log that was read back.

    Members
    -------
    motor_rad : (frames, rows, 3) angles of the motor at :data:`PARTS` of each row's exposure, unwrapped, 0 at the
        index mark; not a number where a row was never sent
    laser_on : (frames, rows) whether the laser shone
    """

    motor_rad: Floats
    laser_on: npt.NDArray[np.bool_]

    @classmethod
    def load(cls, path: Path, scene: Scene) -> "Truth":
        """Read a log and make sure that it belongs to the scene; :exc:`SimError` says what is wrong."""
        try:
            with np.load(path) as file:
                truth = cls(file["motor_rad"], file["laser_on"])
                name = str(file["scene"])
        except (OSError, ValueError, KeyError, BadZipFile, EOFError) as error:
            raise SimError(f"the truth {path} can't be read: {error}") from error
        if name != scene.name:
            raise SimError(f"the truth {path} belongs to the scene {name}, not {scene.name}")
        shape = truth.motor_rad.shape
        if shape[1:] != (scene.camera.height, 3) or truth.laser_on.shape != shape[:2]:
            raise SimError(f"the truth {path} has an unexpected shape, {shape}; make it again with this scene")
        return truth


class TruthLog:
    """Collects the truth while a scan runs.

    Parameters
    ----------
    scene : what is scanned
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._motor: list[Floats] = []
        self._laser: list[npt.NDArray[np.bool_]] = []

    def rows(
        self,
        frame: int,
        first: int,
        row_times_s: npt.ArrayLike,
        angle: Callable[[Floats], Floats],
        laser_on: bool = True,
    ) -> None:
        """Note rows of picture ``frame``, from ``first`` on; the parameters are those of ``Renderer.rows``."""
        height = self._scene.camera.height
        while len(self._motor) <= frame:
            self._motor.append(np.full((height, 3), np.nan))
            self._laser.append(np.zeros(height, np.bool_))
        start, end = self._scene.timing.exposed(np.asarray(row_times_s, dtype=np.float64))
        rows = slice(first, first + len(start))
        self._motor[frame][rows] = angle(start[:, None] + (end - start)[:, None] * PARTS)
        self._laser[frame][rows] = laser_on

    def truth(self) -> Truth:
        """What was collected so far."""
        height = self._scene.camera.height
        return Truth(
            np.array(self._motor).reshape(-1, height, 3), np.array(self._laser, dtype=np.bool_).reshape(-1, height)
        )

    def save(self, path: Path) -> None:
        """Write an ``.npz`` file; :exc:`SimError` where that is not possible."""
        truth = self.truth()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("wb") as file:
                np.savez_compressed(
                    file, motor_rad=truth.motor_rad, laser_on=truth.laser_on, scene=np.array(self._scene.name)
                )
        except OSError as error:
            raise SimError(f"the truth {path} can't be written: {error.strerror}") from error
