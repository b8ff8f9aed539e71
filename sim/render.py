"""Pictures of a scene, row by row.

A row is rendered when it arrives at the card, from where the motor was while the row was exposed; nothing is
asked of the motor's future. Most of the work is done once per scene: each sub-pixel knows which point of which
surface it sees, whether the laser reaches that point, and at which angle of the plane. A frame then touches
only what lies near the plane.

What a pixel collects: the room's light, and the sheet's Gaussian at each sub-pixel's point, averaged over the
exposure (Gauss-Legendre quadrature, as many nodes as the movement needs), times range, incidence and
colour; speckle multiplies the laser's light of a pixel; gain, noise, black level, rounding and clipping follow.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from . import surfaces
from .blur import smear
from .haze import Haze
from .optics import Camera
from .scene import Scene
from .surfaces import Floats, Ints

ACROSS = 3
"""Sub-pixels of a pixel along a row."""

DOWN = 2
"""Sub-pixels of a pixel along a column."""

REACH = 5.0
"""Beyond so many sigma from the plane there is no light."""

BLOCK = 16
"""Rows that are traced together."""

AngleOfTime = Callable[[Floats], Floats]
"""Motor angles (rad) at times (s); arrays of any shape."""

Single = npt.NDArray[np.float32]


@dataclass(frozen=True)
class View:
    """What the sub-pixels see; arrays of (height, width * DOWN * ACROSS), a pixel's sub-pixels side by side.

    Members
    -------
    face : number of the face, -1 for none
    alpha : angle of the plane (rad) that goes through the point
    sigma : half width of the sheet there, as an angle (rad); 0 where no laser light arrives
    level : grey levels of the brightest channel in the middle of the sheet
    lit : whether the laser reaches the point
    ambient : (height, width, 3) grey levels of the room's light
    """

    face: npt.NDArray[np.int16]
    alpha: Single
    sigma: Single
    level: Single
    lit: npt.NDArray[np.bool_]
    ambient: Single


def offsets() -> tuple[Floats, Floats]:
    """Columns and rows of a pixel's sub-pixels, from its centre, in the order of :class:`View`."""
    across = (np.arange(ACROSS) + 0.5) / ACROSS - 0.5
    down = (np.arange(DOWN) + 0.5) / DOWN - 0.5
    return np.tile(across, DOWN), np.repeat(down, ACROSS)


def look(scene: Scene) -> View:
    """Trace every sub-pixel of the scene's camera."""
    rays = _rays(scene.camera)
    # A few rows at a time: the temporaries stay within the cache.
    blocks = [_trace(scene, rays[first : first + BLOCK]) for first in range(0, len(rays), BLOCK)]
    whole = View(*(np.concatenate([getattr(block, name) for block in blocks]) for name in View.__annotations__))
    blur_px = scene.camera.blur_px
    return replace(whole, ambient=smear(smear(whole.ambient, blur_px, 0), blur_px, 1)) if blur_px else whole


@lru_cache(maxsize=1)
def _rays(camera: Camera) -> Floats:
    """(height, width * DOWN * ACROSS, 3) directions of the sub-pixels: the same for all scenes of a camera."""
    du, dv = offsets()
    u = (np.arange(camera.width)[:, None] + du).ravel()
    v = np.tile(dv, camera.width)
    rays = np.stack([camera.rays(u, row + v) for row in range(camera.height)])
    rays.setflags(write=False)
    return rays


def _trace(scene: Scene, rays: Floats) -> View:
    shape = rays.shape[:2]
    directions = rays.reshape(-1, 3)
    starts, directions = scene.sight(directions)
    hits = surfaces.nearest(scene.surfaces, starts, directions)
    seen = hits.face >= 0
    points = starts + directions * np.where(seen, hits.t, 1.0)[:, None]
    albedo = colours(scene, hits.face, points)

    ambient = scene.dimmed(shade(scene, hits.normal)[:, None] * albedo, hits.t) * np.asarray(scene.ambient.colour)
    per_pixel = ambient.reshape(shape[0], scene.camera.width, -1, 3).mean(axis=2)

    # The laser.
    laser = scene.laser
    alpha, speed_mm, source = scene.lit_from(points)
    beam = points - source
    distance = np.linalg.norm(beam, axis=1)
    incidence = np.maximum(-np.sum(hits.normal * beam, axis=1) / distance, 0.0)
    lit = seen & (incidence > 0) & (speed_mm > 0)
    source = np.broadcast_to(source, points.shape)
    lit[lit] = surfaces.visible(scene.surfaces, source[lit], points[lit])
    response = np.asarray(laser.response)
    reflectance = albedo @ response / response.sum()
    level = np.where(lit, laser.level(distance) * incidence * reflectance, 0.0)
    sigma_mm = laser.sigma_mm(distance)
    if scene.water is not None:
        level *= scene.water.laser_kept(laser, distance + np.where(seen, hits.t, 0.0))
        sigma_mm = np.hypot(sigma_mm, scene.water.scatter_mrad * distance / 1000)
    sigma = np.where(lit, sigma_mm / np.where(lit, speed_mm, 1.0), 0.0)
    return View(
        hits.face.astype(np.int16).reshape(shape),
        alpha.astype(np.float32).reshape(shape),
        sigma.astype(np.float32).reshape(shape),
        level.astype(np.float32).reshape(shape),
        lit.reshape(shape),
        per_pixel.astype(np.float32),
    )


def colours(scene: Scene, face: Ints, points: Floats) -> Floats:
    """(N, 3) parts of red, green and blue that points (N, 3) on faces (N,) reflect; 0 where there is no face."""
    result = np.zeros((len(face), 3))
    for number, item in enumerate(scene.objects):
        mine = np.flatnonzero(face // surfaces.FACES_MAX == number)
        result[mine] = item.colour(points[mine])
    return result


def shade(scene: Scene, normal: Floats) -> Floats:
    """(N,) part of the room's light that arrives at faces of the given normals: from everywhere, and from one side."""
    to_light = np.asarray(scene.ambient.direction) / np.linalg.norm(scene.ambient.direction)
    diffuse = scene.ambient.diffuse
    return np.asarray(diffuse + (1 - diffuse) * np.maximum(normal @ to_light, 0.0))


class Renderer:
    """Renders rows of a scene.

    Parameters
    ----------
    scene : what is seen
    seed : of noise and speckle; a picture depends on scene, seed, number of the frame and movement alone, not
        on the portions in which its rows are asked for
    """

    def __init__(self, scene: Scene, seed: int = 0) -> None:
        self.scene = scene
        self.seed = seed
        self.view = look(scene)
        lit = self.view.sigma > 0
        self._finest_rad = float(self.view.sigma[lit].min()) if lit.any() else np.inf
        self._middle = float(np.mean(self.view.alpha[lit])) if lit.any() else 0.0
        self._haze = Haze.of(scene) if scene.water is not None and scene.water.glow else None
        self._mix = (np.asarray(scene.laser.response) * scene.camera.gain).astype(np.float32)
        self._frame: int | None = None

    def rows(
        self,
        frame: int,
        first: int,
        last: int,
        row_times_s: npt.ArrayLike,
        angle: AngleOfTime,
        laser_on: bool = True,
    ) -> npt.NDArray[np.uint8]:
        """Rows ``first`` to ``last`` - 1 of picture ``frame``: (last - first, width, 3), red, green, blue.

        Parameters
        ----------
        row_times_s : (last - first,) arrival of column 0 of each of these rows
        angle : of the motor; asked for times within the rows' exposures only
        laser_on : whether the laser shone
        """
        camera, laser = self.scene.camera, self.scene.laser
        picture = self.view.ambient[first:last] * np.float32(camera.gain) + np.float32(camera.black_level)
        self._draw(frame)
        if laser_on:
            start, end = self.scene.timing.exposed(np.asarray(row_times_s, dtype=np.float64))
            light = self.light(first, last, *self.exposure(start, end, angle))
            if laser.speckle:
                light = light * self._speckle[first:last]
            picture += light[:, :, None] * self._mix
        if camera.noise:
            picture += self._noise[first:last]
        # Half up; truncation is enough once everything is positive.
        np.clip(picture + np.float32(0.5), 0, 255, out=picture)
        return picture.astype(np.uint8)

    def light(self, first: int, last: int, alphas: Floats, weights: Floats) -> Single:
        """The laser's light without speckle, noise and gain: (last - first, width), grey levels of the brightest
        channel.

        Parameters
        ----------
        alphas : (rows, nodes) angles of the plane, within half a turn of the scene
        weights : (nodes,) their parts of the exposure
        """
        view = self.view
        low, high = alphas.min(axis=1), alphas.max(axis=1)
        middle = ((low + high) / 2).astype(np.float32)[:, None]
        half = ((high - low) / 2).astype(np.float32)[:, None]
        sigma = view.sigma[first:last]
        # (sigma is 0 where no light arrives: such a point is near only by accident, and its level is 0.)
        near = np.abs(view.alpha[first:last] - middle) < np.float32(REACH) * sigma + half
        where = np.flatnonzero(near)
        row = where // near.shape[1]
        alpha, sigma = view.alpha[first:last].ravel()[where], np.maximum(sigma.ravel()[where], np.float32(1e-9))
        total = np.zeros(len(where), np.float32)
        for node, weight in enumerate(weights):
            z = (alphas[:, node].astype(np.float32)[row] - alpha) / sigma
            total += np.float32(weight) * np.exp(np.float32(-0.5) * z * z)
        total *= view.level[first:last].ravel()[where] / np.float32(ACROSS * DOWN)
        size = (last - first) * self.scene.camera.width
        summed = np.bincount(where // (ACROSS * DOWN), weights=total, minlength=size)
        light = summed.astype(np.float32).reshape(last - first, -1)
        if self._haze is not None:
            light += self._haze.glow(slice(first, last), alphas @ weights)
        # Along the rows only: a row is due before the next one's angle is known, and the line is nearly upright.
        return smear(light, self.scene.camera.blur_px, 1)

    def exposure(self, start: Floats, end: Floats, angle: AngleOfTime) -> tuple[Floats, Floats]:
        """(rows, nodes) angles of the plane from ``start`` to ``end`` (rows,), and the (nodes,) weights of their mean.

        ``angle`` gives the motor's angle for whatever start and end count in.
        """
        laser = self.scene.laser
        ends = laser.alpha(angle(np.stack([start, end])))
        span = float(np.abs(ends[1] - ends[0]).max(initial=0.0))
        # A movement of one sigma needs 3 nodes for 1e-4 of the light; faster ones in proportion.
        count = int(np.clip(3 + 2 * np.ceil(span / self._finest_rad), 3, 65)) if np.any(end > start) else 1
        nodes, weights = np.polynomial.legendre.leggauss(count)
        middle, half = (start + end) / 2, (end - start) / 2
        alphas = laser.alpha(angle(middle[:, None] + half[:, None] * nodes))
        turns = np.round((alphas[:, :1] - self._middle) / (2 * np.pi))
        return alphas - 2 * np.pi * turns, weights / 2

    def _draw(self, frame: int) -> None:
        """Noise and speckle of a picture, drawn when its first row is asked for."""
        if frame == self._frame:
            return
        camera, laser = self.scene.camera, self.scene.laser
        random = np.random.Generator(np.random.SFC64([self.seed, frame]))
        if camera.noise:
            noise = random.standard_normal((camera.height, camera.width, 3), dtype=np.float32)
            noise *= np.float32(camera.noise)
            self._noise = noise
        if laser.speckle:
            # Fully developed speckle, averaged over a pixel: a gamma distribution with mean 1.
            shape = 1 / laser.speckle**2
            speckle = random.standard_gamma(shape, (camera.height, camera.width), dtype=np.float32)
            self._speckle = speckle / np.float32(shape)
        self._frame = frame
