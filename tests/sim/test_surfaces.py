"""Rays on surfaces, with numbers worked out by hand."""

import numpy as np
import pytest

from sim.surfaces import FACES_MAX, Box, Cylinder, Plane, Sphere, Surface, distance, nearest, visible


def moved(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def one(surface: Surface, origin: tuple[float, ...], direction: tuple[float, ...]) -> tuple[float, int, list[float]]:
    hits = surface.intersect(origin, np.array([direction]))
    return float(hits.t[0]), int(hits.face[0]), hits.normal[0].tolist()


def test_plane() -> None:
    plane = Plane(pose=moved(0, 0, 1000))
    assert one(plane, (0, 0, 0), (0, 0, 2)) == (500, 0, [0, 0, -1])
    assert one(plane, (0, 0, 2000), (0, 0, -1)) == (1000, 0, [0, 0, 1])
    assert one(plane, (0, 0, 0), (0, 0, -1)) == (np.inf, -1, [0, 0, 0])
    assert one(plane, (0, 0, 0), (1, 0, 0)) == (np.inf, -1, [0, 0, 0])
    # 3-4-5: the ray (3, 0, 4) meets Z = 1000 at X = 750.
    assert one(plane, (0, 0, 0), (0.6, 0, 0.8))[0] == pytest.approx(1250)


def test_rectangle() -> None:
    plane = Plane((200, 100), moved(0, 0, 1000))
    assert one(plane, (99, 49, 0), (0, 0, 1))[1] == 0
    assert one(plane, (101, 0, 0), (0, 0, 1))[1] == -1
    assert one(plane, (0, 51, 0), (0, 0, 1))[1] == -1
    assert plane.distance([[103, 54, 1000], [0, 0, 988], [103, 50, 1004]]) == pytest.approx([5, 12, 5])


def test_turned_plane() -> None:
    """Turned by 90 degrees about Y, the plane z = 0 becomes X = 300."""
    pose = np.array([[0, 0, 1, 300], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    t, face, normal = one(Plane(pose=pose), (0, 0, 0), (1, 0, 0))
    assert (t, face) == (300, 0)
    assert normal == pytest.approx([-1, 0, 0])


@pytest.mark.parametrize(
    ("origin", "direction", "t", "face", "normal"),
    [
        ((-500, 0, 0), (1, 0, 0), 400, 0, (-1, 0, 0)),
        ((500, 0, 0), (-1, 0, 0), 400, 1, (1, 0, 0)),
        ((0, -500, 0), (0, 1, 0), 450, 2, (0, -1, 0)),
        ((0, 500, 0), (0, -1, 0), 450, 3, (0, 1, 0)),
        ((0, 0, -500), (0, 0, 1), 475, 4, (0, 0, -1)),
        ((0, 0, 500), (0, 0, -1), 475, 5, (0, 0, 1)),
        ((0, 0, 0), (1, 0, 0), 100, 1, (-1, 0, 0)),  # from inside
        ((0, 60, -500), (0, 0, 1), np.inf, -1, (0, 0, 0)),
        ((500, 0, 0), (1, 0, 0), np.inf, -1, (0, 0, 0)),
    ],
)
def test_box(origin, direction, t, face, normal) -> None:
    hit = one(Box((200, 100, 50)), origin, direction)
    assert hit[:2] == (t, face)
    assert hit[2] == pytest.approx(normal)


def test_box_distance() -> None:
    box = Box((200, 100, 50))
    points = [[103, 54, 0], [0, 0, 0], [90, 0, 0], [103, 54, 37], [100, 50, 25]]
    assert box.distance(points) == pytest.approx([5, 25, 10, 13, 0])


def test_cylinder() -> None:
    cylinder = Cylinder(50, 200, moved(0, 0, 1000))
    assert one(cylinder, (0, 0, 0), (0, 0, 1)) == (950, 0, [0, 0, -1])
    # 30-40-50: beside the axis by 30 the wall is 40 before it.
    t, face, normal = one(cylinder, (30, 0, 0), (0, 0, 1))
    assert (t, face) == (960, 0)
    assert normal == pytest.approx([0.6, 0, -0.8])
    assert one(cylinder, (10, -500, 1000), (0, 1, 0)) == (400, 1, [0, -1, 0])
    assert one(cylinder, (10, 500, 1000), (0, -1, 0)) == (400, 2, [0, 1, 0])
    assert one(cylinder, (0, 0, 1000), (0, 0, 1))[:2] == (50, 0)
    assert one(cylinder, (51, 0, 0), (0, 0, 1))[1] == -1
    assert one(cylinder, (0, 101, 0), (0, 0, 1))[1] == -1
    assert cylinder.distance([[0, 0, 940], [0, 0, 1000], [53, 104, 1000], [0, 99, 1000]]) == pytest.approx(
        [10, 50, 5, 1]
    )


def test_sphere() -> None:
    sphere = Sphere(50, moved(0, 0, 1000))
    assert one(sphere, (0, 0, 0), (0, 0, 1)) == (950, 0, [0, 0, -1])
    t, face, normal = one(sphere, (0, 30, 0), (0, 0, 1))
    assert (t, face) == (960, 0)
    assert normal == pytest.approx([0, 0.6, -0.8])
    assert one(sphere, (0, 0, 1000), (1, 0, 0))[0] == 50
    assert one(sphere, (0, 51, 0), (0, 0, 1))[1] == -1
    assert sphere.distance([[0, 0, 940], [0, 0, 1000], [30, 40, 1000]]) == pytest.approx([10, 50, 0])


@pytest.mark.parametrize(
    "surface", [Plane((300, 200)), Box((200, 100, 50)), Cylinder(50, 200), Sphere(80)], ids=lambda s: type(s).__name__
)
def test_hits_lie_on_the_surface(surface: Surface) -> None:
    """Distance and intersection say the same, and normals face the ray."""
    seed = 5
    print("seed", seed)
    random = np.random.default_rng(seed)
    origins = random.normal(0, 150, (4000, 3))
    directions = random.normal(0, 1, (4000, 3))
    hits = surface.intersect(origins, directions)
    hit = np.isfinite(hits.t)
    assert hit.sum() > 200
    points = origins[hit] + hits.t[hit, None] * directions[hit]
    assert surface.distance(points).max() < 1e-9
    assert np.all(np.sum(hits.normal[hit] * directions[hit], axis=1) <= 0)
    assert np.linalg.norm(hits.normal[hit], axis=1) == pytest.approx(np.ones(hit.sum()))


def test_nearest_numbers_faces_and_shadows_fall() -> None:
    surfaces = [Plane(pose=moved(0, 0, 1000)), Sphere(50, moved(0, 0, 500))]
    hits = nearest(surfaces, (0, 0, 0), np.array([[0, 0, 1.0], [1, 0, 1]]))
    assert hits.t == pytest.approx([450, 1000])
    assert hits.face.tolist() == [FACES_MAX, 0]
    # The sphere's shadow on the wall from 0, 0, 0: radius 50 / sqrt(500^2 - 50^2) * 1000 = 100.504.
    points = np.array([[100.4, 0, 1000], [100.6, 0, 1000], [0, 0, 450], [0, 0, 550]])
    assert visible(surfaces, (0, 0, 0), points).tolist() == [False, True, True, False]
    assert distance(surfaces, np.array([[0, 0, 440.0], [0, 0, 990]])) == pytest.approx([10, 10])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(-1), "radius of a sphere has to be positive, not -1"),
        (lambda: Box((1, 0, 1)), "size of a box has to be positive, not 0"),
        (lambda: Plane(pose=np.eye(3)), "4 x 4"),
        (lambda: Plane(pose=2 * np.eye(4)), "rotation"),
    ],
)
def test_refuses(make, message) -> None:
    with pytest.raises(ValueError, match=message):
        make()
