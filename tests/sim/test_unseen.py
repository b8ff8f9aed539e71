"""Scenes by chance: what they promise holds for any seed."""

from pathlib import Path

import numpy as np
import pytest

from sim.scene import Scene
from sim.surfaces import Cylinder, Plane, Sphere, nearest
from tests.support import unseen


@pytest.mark.parametrize("distance_mm", [unseen.NEAREST_MM, 1000.0, 2000.0, 3000.0])
@pytest.mark.parametrize("seed", [11, 12])
def test_bodies(distance_mm: float, seed: int, tmp_path: Path) -> None:
    text = unseen.bodies_scene(distance_mm, seed)
    assert text == unseen.bodies_scene(distance_mm, seed) != unseen.bodies_scene(distance_mm, seed + 10)
    scene = Scene.load(unseen.write(tmp_path, "bodies", text))
    wall, pipe, *balls = scene.surfaces
    assert isinstance(wall, Plane)
    assert isinstance(pipe, Cylinder)
    assert len(balls) in (2, 3, 4)
    for body in (pipe, *balls):
        assert isinstance(body, Cylinder | Sphere)
        assert body.radius >= 60
        assert abs(body.pose[2, 3] / distance_mm - 1) <= 0.04
        # Whoever looks at the middle of a body sees it before everything else, and the scan passes over it.
        middle = body.pose[:3, 3]
        for place in (np.zeros(3), scene.laser.origin):
            face = nearest(scene.surfaces, place, (middle - place)[None]).face[0]
            assert scene.surfaces[face // 8] is body
        motor = scene.laser.sense * (scene.lit_from(middle[None])[0][0] - scene.laser.zero_rad)
        assert scene.scan.start_rad < motor < scene.scan.end_rad
    # The pictures show all bodies and the wall round them.
    rays = scene.camera.rays(*(grid.ravel() for grid in np.meshgrid(np.arange(0, 640, 8), np.arange(0, 480, 8))))
    seen = np.unique(nearest(scene.surfaces, np.zeros(3), rays).face // 8)
    assert seen.tolist() == list(range(len(scene.surfaces)))


def test_a_wall_leans_and_fills_the_picture(tmp_path: Path) -> None:
    scene = Scene.load(unseen.write(tmp_path, "wall", unseen.wall_scene(2000.0, 11)))
    (wall,) = scene.surfaces
    assert isinstance(wall, Plane)
    assert abs(wall.pose[2, 3] - 2000) <= 40
    assert 0 < np.degrees(np.arccos(wall.pose[2, 2])) < 15
    assert scene.scan.start_rad == pytest.approx(np.radians(1))
