"""Scenes simple enough to be worked out by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.optics import Camera, Laser
from sim.parts import Ambient, Object, Scan
from sim.scene import Scene
from sim.surfaces import Plane, Surface
from sim.timing import Timing

WHITE = (1.0, 1.0, 1.0)
LASER = Laser(
    camera_from_laser=((0, 1, 0, -500), (0, 0, 1, 0), (1, 0, 0, 0), (0, 0, 0, 1)),
    offset_mm=0.0,
    tilt_rad=0.0,
    zero_rad=0.0,
    sense=1,
    peak=200.0,
    reference_mm=2000.0,
    waist_mm=3.0,
    divergence_rad=0.0,
    response=(0.25, 1.0, 0.125),
    speckle=0.0,
)


def at(x: float, y: float, z: float) -> np.ndarray:
    """A pose that only shifts."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def rig(
    surfaces: Sequence[Surface] = (Plane(pose=at(0, 0, 2000)),),
    *,
    width: int = 160,
    height: int = 24,
    focal_px: float = 800,
    exposure_s: float = 0.0,
    readout_delay_s: float = 0.0,
    noise: float = 0.0,
    ambient: float = 0.0,
    distortion: tuple[float, ...] = (0.0,) * 5,
    **laser: object,
) -> Scene:
    """White surfaces; the camera's centre is a pixel's; frames of 20 ms, rows of 0.1 ms; the quick scene's motor."""
    matrix = ((focal_px, 0.0, width // 2), (0.0, focal_px, height // 2), (0.0, 0.0, 1.0))
    quick = Scene.load("quick")
    return replace(
        quick,
        name="rig",
        camera=Camera(width, height, matrix, distortion, noise, 1.0, 0.0),
        timing=Timing(height, 50, 100e-6, exposure_s, readout_delay_s),
        laser=replace(LASER, **laser),
        ambient=Ambient((ambient,) * 3, (0.0, 0.0, -1.0), 0.0),
        objects=tuple(Object(surface, WHITE) for surface in surfaces),
        scan=Scan(4, 0.0, 0.1),
    )


def centroid(light: np.ndarray) -> np.ndarray:
    """Centre of gravity of each row."""
    return light @ np.arange(light.shape[1]) / light.sum(axis=1)
