"""Pictures of a scene at rest, in the light of the room: what a calibration board is photographed for.

Finer than the row-by-row renderer: each pixel that sees a board or an edge is sampled :data:`FINE` x :data:`FINE`
times, and the lens's blur acts on these samples, before the pixels gather them, as it does in a camera.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from . import surfaces
from .blur import smear
from .optics import Camera
from .render import colours, shade
from .scene import Scene
from .surfaces import FACES_MAX, Floats, Ints

FINE = 4
"""Samples of a pixel along each axis, where there is something to see."""


def photo(scene: Scene, seed: int = 0, colour: tuple[float, float, float] | None = None) -> npt.NDArray[np.uint8]:
    """(height, width, 3) red, green, blue.

    Parameters
    ----------
    scene : what is seen; the laser is off
    seed : of the noise
    colour : grey levels of the room's light on white that faces it, if not the scene's
    """
    camera = scene.camera
    height, width = camera.height, camera.width
    centres = _rays(camera, 1)
    face, light = _light(scene, centres)
    coarse = face.reshape(height, width)
    boards = [number for number, item in enumerate(scene.objects) if item.board is not None]
    busy = _grow(np.isin(coarse // FACES_MAX, boards)) | _edges(coarse)
    # Everything at the fine pitch: plain pixels are repeated, busy ones are sampled.
    fine = np.repeat(np.repeat(light.astype(np.float32).reshape(height, width, 3), FINE, axis=0), FINE, axis=1)
    where = np.flatnonzero(np.repeat(np.repeat(busy, FINE, axis=0), FINE, axis=1))
    fine.reshape(-1, 3)[where] = _light(scene, _rays(camera, FINE)[where])[1]
    sigma = camera.blur_px * FINE
    fine = smear(smear(fine, sigma, 0), sigma, 1)
    picture = fine.reshape(height, FINE, width, FINE, 3).mean(axis=(1, 3), dtype=np.float64)
    picture *= np.asarray(scene.ambient.colour if colour is None else colour) * camera.gain
    random = np.random.default_rng([seed, 0x9E3779B9])
    picture += camera.black_level + camera.noise * random.standard_normal(picture.shape)
    return np.asarray(np.clip(picture + 0.5, 0, 255), dtype=np.uint8)


@lru_cache(maxsize=4)
def _rays(camera: Camera, fine: int) -> Floats:
    """(N, 3) directions of ``fine`` x ``fine`` samples of each pixel, row by row of the samples."""
    u = (np.arange(camera.width * fine) + 0.5) / fine - 0.5
    v = (np.arange(camera.height * fine) + 0.5) / fine - 0.5
    rays = np.concatenate([camera.rays(u, np.full(len(u), row)) for row in v])
    rays.setflags(write=False)
    return rays


def _light(scene: Scene, directions: Floats) -> tuple[Ints, Floats]:
    """Faces (N,) and the part of the room's light, (N, 3), that comes back along rays."""
    starts, directions = scene.sight(directions)
    hits = surfaces.nearest(scene.surfaces, starts, directions)
    points = starts + directions * np.where(hits.face >= 0, hits.t, 1.0)[:, None]
    light = shade(scene, hits.normal)[:, None] * colours(scene, hits.face, points)
    return hits.face, scene.dimmed(light, hits.t)


def _edges(face: Ints) -> npt.NDArray[np.bool_]:
    """Pixels whose neighbours see another face."""
    edge = np.zeros(face.shape, np.bool_)
    across, down = face[:, 1:] != face[:, :-1], face[1:] != face[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return _grow(edge)


def _grow(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The mask and its neighbours."""
    result = mask.copy()
    result[:, 1:] |= mask[:, :-1]
    result[:, :-1] |= mask[:, 1:]
    result[1:] |= result[:-1].copy()
    result[:-1] |= result[1:].copy()
    return result
