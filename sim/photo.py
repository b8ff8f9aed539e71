"""Pictures of a scene at rest, in the light of the room: what a calibration board is photographed for.

Finer than the row-by-row renderer: each pixel that sees a board or an edge is sampled :data:`FINE` x :data:`FINE`
times, and the lens's blur acts on these samples, before the pixels gather them, as it does in a camera.

``python -m sim.photo SCENE PICTURE.png [--target FILE.json]`` takes one; the file then tells what is known of the
boards in the scene: their prints, and how they stand to the first of them.
"""

import json
from functools import lru_cache
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from . import surfaces
from .blur import smear
from .errors import SimError
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
    picture = smear(smear(fine, sigma, 0, FINE), sigma, 1, FINE).astype(np.float64)
    picture *= np.asarray(scene.ambient.colour if colour is None else colour) * camera.gain
    random = np.random.default_rng([seed, 0x9E3779B9])
    picture += camera.black_level + camera.noise * random.standard_normal(picture.shape)
    return np.asarray(np.clip(picture + 0.5, 0, 255), dtype=np.uint8)


@lru_cache(maxsize=4)
def _rays(camera: Camera, fine: int) -> Floats:
    """(N, 3) directions of ``fine`` x ``fine`` samples of each pixel, row by row of the samples.

    Each lies somewhere in its own cell, and those of a pixel in different parts of theirs: an edge along the rows or
    columns would else move by whole cells, and corners by a twentieth of a pixel.

    Source: A. Kensler, "Correlated multi-jittered sampling", Pixar 13-01, 2013.
    """
    random = np.random.default_rng(fine)
    order = random.permutation(fine)
    at = np.arange(camera.width * fine)
    rows = []
    for row in range(camera.height * fine):
        shift = random.random((2, len(at))) if fine > 1 else np.full((2, len(at)), 0.5)
        across, down = (order[row % fine] + shift[0]) / fine, (order[at % fine] + shift[1]) / fine
        rows.append(camera.rays((at + across) / fine - 0.5, (row + down) / fine - 0.5))
    rays = np.concatenate(rows)
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


def target(scene: Scene) -> dict[str, list[dict[str, object]]]:
    """What whoever made the boards of a scene knows of them; their poses are relative to the first."""
    known: list[dict[str, object]] = []
    first: Floats | None = None
    for item in scene.objects:
        if item.board is None or not isinstance(item.surface, surfaces.Plane):
            continue
        pose = item.board.pose(item.surface)
        first = pose if first is None else first
        known.append(item.board.describe() | {"pose": (np.linalg.inv(first) @ pose).round(9).tolist()})
    return {"boards": known}


@click.command()
@click.argument("name", metavar="SCENE")
@click.argument("picture", type=click.Path(path_type=Path))
@click.option("--target", "target_path", type=click.Path(path_type=Path), help="JSON file about the boards to write.")
@click.option("--light", type=click.FloatRange(0, 255), default=225.0, show_default=True, help="Grey level of white.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the noise.")
def main(name: str, picture: Path, target_path: Path | None, light: float, seed: int) -> None:
    """Take a picture of SCENE in the light of the room, with the laser off."""
    from PIL import Image

    try:
        scene = Scene.load(name)
        Image.fromarray(photo(scene, seed, (light, light, light))).save(picture)
        if target_path is not None:
            target_path.write_text(json.dumps(target(scene), indent=1) + "\n")
    except SimError as error:
        raise click.ClickException(str(error)) from None
    except (OSError, ValueError) as error:
        raise click.ClickException(f"the picture {picture} can't be written: {error}") from None


if __name__ == "__main__":
    main()
