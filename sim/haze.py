"""The glow of the sheet in the water: what a camera sees of the light before it falls on anything.

A sight crosses the sheets of a range of angles, from one near the camera to the one at the surface. Where it does is
interpolated in 1 / distance between the two; the glow falls with the distance and with what the water takes away.
It is single scattering without shadows: a faint, wide background to the line, brighter towards the near side.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import surfaces
from .optics import Laser
from .scene import Scene
from .surfaces import Floats
from .water import Water

NEAR_MM = 250.0
ENDLESS_MM = 20_000.0


@dataclass(frozen=True)
class Haze:
    """What is known of each pixel's sight; arrays of (height, width).

    Members
    -------
    near, far : alpha of the sheet :data:`NEAR_MM` before the port, and at the surface
    way_mm : from the port to the surface
    water, laser : of the scene
    """

    near: Floats
    far: Floats
    way_mm: Floats
    water: Water
    laser: Laser

    @classmethod
    def of(cls, scene: Scene) -> "Haze":
        """Trace the middles of the pixels."""
        assert scene.water is not None
        camera = scene.camera
        v, u = np.indices((camera.height, camera.width), dtype=np.float64)
        starts, directions = scene.sight(camera.rays(u.ravel(), v.ravel()))
        way = np.clip(surfaces.nearest(scene.surfaces, starts, directions).t, NEAR_MM + 1, ENDLESS_MM)
        near = scene.lit_from(starts + NEAR_MM * directions)[0]
        far = scene.lit_from(starts + way[:, None] * directions)[0]
        shape = v.shape
        return cls(near.reshape(shape), far.reshape(shape), way.reshape(shape), scene.water, scene.laser)

    def glow(self, rows: slice, alpha: Floats) -> npt.NDArray[np.float32]:
        """Grey levels (rows, width) of the brightest channel for the angles (rows,) of the sheet."""
        near, far, end = self.near[rows], self.far[rows], self.way_mm[rows]
        part = (alpha[:, None] - far) / (near - far)
        way = 1 / (1 / end + np.clip(part, 0, 1) * (1 / NEAR_MM - 1 / end))
        light = self.water.glow * (1000 / way) * self.water.laser_kept(self.laser, 2 * way)
        return np.where((part >= 0) & (part <= 1), light, 0.0).astype(np.float32)
