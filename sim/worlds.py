"""What can surround the virtual card: a scene with its motor, or pictures with given angles."""

import numpy as np

from .motor import Drive
from .pictures import Pictures
from .playback import Angles, Playback
from .render import Renderer
from .scene import Scene
from .timing import Timing
from .trajectory import Floats
from .truth import TruthLog

EDGE_CLOCKS = 64
"""Clocks between two encoder edges when a playback travels to its first picture."""


class SceneWorld:
    """A scene; its motor is driven by the card's PWM, its laser by the card's enable.

    Parameters
    ----------
    scene : rig and objects
    truth : where the true angles go
    seed : of noise and speckle
    """

    def __init__(self, scene: Scene, truth: TruthLog | None, seed: int) -> None:
        self.width, self.height, self.frames = scene.camera.width, scene.camera.height, scene.scan.frames
        self.timing = scene.timing
        self.drive: Drive = scene.motor()
        self._renderer = Renderer(scene, seed)
        self._truth = truth

    def start(self, at_s: float) -> float:
        """The first picture comes at once."""
        return at_s

    def rows(self, frame: int, first: int, times_s: Floats, lit: bool) -> np.ndarray:
        if self._truth is not None:
            self._truth.rows(frame, first, times_s, self.drive.angle, lit)
        return self._renderer.rows(frame, first, first + len(times_s), times_s, self.drive.angle, lit)


class PictureWorld:
    """Pictures in a row; the motor is where their angles say, whatever the PWM.

    Parameters
    ----------
    pictures : all of one size
    angles : one pair for each picture
    """

    def __init__(self, pictures: Pictures, angles: Angles, timing: Timing, counts_per_turn: int, clock_hz: int) -> None:
        self.width, self.height, self.frames = pictures.width, pictures.height, len(pictures)
        self.timing = timing
        self.drive: Drive = (playback := Playback(angles, timing, counts_per_turn, clock_hz / EDGE_CLOCKS))
        self._playback = playback
        self._pictures = pictures
        self._shown = -1

    def start(self, at_s: float) -> float:
        """The motor sets off, past the index mark; the first picture comes when it is there."""
        return self._playback.start(at_s)

    def rows(self, frame: int, first: int, times_s: Floats, lit: bool) -> np.ndarray:
        if frame != self._shown:
            self._picture = self._pictures[frame % self.frames]
            self._shown = frame
        return self._picture[first : first + len(times_s)]
