"""Scenes on which nothing was tuned: spheres, a cylinder and a wall before the rig, placed by chance.

A seed and a distance make a scene. Bodies are at least 60 mm in radius; camera and laser see all of what is measured of
them, and the laser turns over them as fast as in the ready-made scenes. They are as bright as somebody would set
the exposure to have them: the line's peak at :data:`PEAK` grey levels on what is nearest, were it to face the laser.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magtrak.validate.segments import LIMB
from sim.parts import pose_of
from sim.scene import Scene
from sim.surfaces import Cylinder, Floats, Plane, Sphere, Surface, visible

RIG = "rig"
NEAREST_MM = 560.0
"""Middles of bodies "at 0.5 m": what camera and laser both see begins at half a metre."""

PEAK = 230.0
SPEED_RAD_S = np.radians(15.0)
"""About, of the laser: widens the line during the exposure."""

BORDER_PX = 8.0
APART_PX = 14.0
"""At least, between outlines of two bodies in the picture."""

MARGIN_DEG = 1.5
"""Scanned on both sides of what is to be seen."""

TRIES = 4000


@dataclass(frozen=True)
class Body:
    """A surface, and points (N, 3) of it with their outward normals, all round."""

    surface: Sphere | Cylinder
    points: Floats
    normals: Floats

    def facing(self, places: list[Floats], cosine: float) -> Floats:
        """The points that face all of ``places`` better than with a cosine."""
        good = np.ones(len(self.points), bool)
        for place in places:
            way = self.points - place
            good &= -np.sum(way * self.normals, axis=1) > cosine * np.linalg.norm(way, axis=1)
        return self.points[good]


def bodies_scene(distance_mm: float, seed: int) -> str:
    """Two to four spheres and a cylinder about a distance, before a wall: the text of a scene file."""
    rng = np.random.default_rng([seed, round(distance_mm), 7])
    rig = Scene.load(RIG)
    least, most = max(60.0, 0.03 * distance_mm), max(66.0, 0.06 * distance_mm)
    # Equal spheres are told by their order, others by their sizes, which therefore differ clearly.
    base = rng.uniform(least, most / 1.25) if most > 1.25 * least else rng.uniform(least, most)
    wide = 640 * distance_mm / 800 > 12 * most  # there is room for more than two
    radii = base * rng.choice([1.0, 1.25] if most > 1.25 * least else [1.0], rng.integers(2, 5) if wide else 2)
    pipe = float(rng.uniform(least, most))
    shapes: list[tuple[float, float | None]] = [(float(radius), None) for radius in radii]
    shapes.append((pipe, float(pipe * (rng.uniform(3.0, 5.0) if wide else 2.5))))
    wall = Plane(pose=pose_of((0, 0, distance_mm * rng.uniform(1.2, 1.35)), np.radians([*rng.uniform(-8, 8, 2), 0])))
    placed: list[Body] = []
    for attempt in range(TRIES):
        if attempt % 400 == 399:
            placed = []  # they stand in each other's way: all anew
        radius, height = shapes[len(shapes) - 1 - len(placed)]  # the cylinder, which is the largest, first
        body = _body(rig, radius, height, distance_mm, rng)
        if _stands_free(rig, [*placed, body], wall):
            placed.append(body)
            if len(placed) == len(shapes):
                return _text(rig, f"bodies at {distance_mm:g} mm, seed {seed}", placed, wall)
    raise AssertionError(f"no room was found for the bodies at {distance_mm:g} mm with seed {seed}")


def wall_scene(distance_mm: float, seed: int) -> str:
    """A wall alone, leaning by chance."""
    rng = np.random.default_rng([seed, round(distance_mm), 8])
    turn = np.radians([*rng.uniform(-10, 10, 2), 0])
    wall = Plane(pose=pose_of((0, 0, distance_mm * rng.uniform(0.98, 1.02)), turn))
    return _text(Scene.load(RIG), f"a wall at {distance_mm:g} mm, seed {seed}", [], wall)


def write(folder: Path, name: str, text: str) -> str:
    """The scene as a file of its own name; the file."""
    path = folder / f"{name}.toml"
    path.write_text(text)
    return f"{path}"


def _body(rig: Scene, radius: float, height: float | None, distance_mm: float, rng: np.random.Generator) -> Body:
    """Somewhere in the picture, turned somehow."""
    pixel = rng.uniform(0, [[rig.camera.width, rig.camera.height]])
    ray = rig.camera.rays(*pixel.T)[0]
    position = ray / ray[2] * distance_mm * rng.uniform(0.96, 1.04)
    if height is None:
        normals = _round(400)
        return Body(Sphere(radius, pose_of(position, np.zeros(3))), position + radius * normals, normals)
    pose = pose_of(position, np.radians([rng.uniform(-15, 15), 0.0, rng.uniform(-60, 60)]))
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(-0.5, 0.5, 12) * height)
    normals = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1).reshape(-1, 3)
    points = radius * normals + np.stack([0 * along, along, 0 * along], axis=-1).reshape(-1, 3)
    turn = pose[:3, :3].T
    return Body(Cylinder(radius, height, pose), points @ turn + position, normals @ turn)


def _round(count: int) -> Floats:
    """Directions (N, 3) spread evenly over a sphere, along a spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def _stands_free(rig: Scene, bodies: list[Body], wall: Plane) -> bool:
    """Whether each body is in the picture, apart from the others, and nothing is between it and camera or laser."""
    camera, laser = np.zeros(3), rig.laser.origin
    newest = bodies[-1]
    size = np.array([rig.camera.width, rig.camera.height])
    outline = rig.project(newest.facing([camera], 0.0))
    if not np.all((outline > BORDER_PX) & (outline < size - 1 - BORDER_PX)):
        return False
    if wall.intersect(camera, newest.points).t.min() < 1.02:  # in units of the way to each point
        return False
    for other in bodies[:-1]:
        there = rig.project(other.facing([camera], 0.0))
        if np.linalg.norm(there[:, None] - outline, axis=2).min() < APART_PX:
            return False
    surfaces: list[Surface] = [body.surface for body in bodies]
    return all(
        visible(surfaces, place, body.facing([camera, laser], LIMB - 0.15)).all()
        for place in (camera, laser)
        for body in bodies
    )


def _text(rig: Scene, title: str, bodies: list[Body], wall: Plane) -> str:
    """The scene file: only so much is scanned as the bodies need, or the whole picture where there are none."""
    if bodies:
        lit = np.concatenate([body.points for body in bodies])
    else:
        lit = _seen_of(rig, wall)
    motor = np.degrees((rig.lit_from(lit)[0] - rig.laser.zero_rad) * rig.laser.sense)
    low, high = max(1.0, float(motor.min()) - MARGIN_DEG), float(motor.max()) + MARGIN_DEG
    start = np.degrees(rig.motor_start_rad)
    whole = np.degrees(rig.scan.end_rad + (rig.scan.end_rad - rig.scan.start_rad)) - start
    frames = int(np.ceil(rig.scan.frames * (high - start + high - low) / whole))
    near = lit[:, 2] < np.median(lit[:, 2]) + 1  # bodies show their near half
    albedo = _albedo(rig, lit[near])
    parts = [f'# By chance: {title}.\n\nlike = "{RIG}"\n', _scan(frames, low, high), _object("plane", wall, albedo)]
    for body in bodies:
        item = body.surface
        fields = f"radius_mm = {item.radius!r}\n"
        if isinstance(item, Cylinder):
            fields += f"height_mm = {item.height!r}\n"
        parts.append(_object(type(item).__name__.lower(), item, albedo, fields))
    return "\n".join(parts)


def _seen_of(rig: Scene, wall: Plane) -> Floats:
    """Points of the wall along the picture's border."""
    u, v = np.meshgrid(np.linspace(0, rig.camera.width - 1, 9), np.linspace(0, rig.camera.height - 1, 9))
    rays = rig.camera.rays(u.ravel(), v.ravel())
    return np.asarray(rays * wall.intersect(np.zeros(3), rays).t[:, None])


def _albedo(rig: Scene, lit: Floats) -> float:
    """So bright that the line's peak is right on the nearest tenth of the points."""
    camera, laser = rig.camera, rig.laser
    reach = np.linalg.norm(lit - laser.origin, axis=1)
    px_per_mm = camera.matrix[0][0] / lit[:, 2]
    sheet = laser.sigma_mm(reach) * px_per_mm
    moved = SPEED_RAD_S * rig.timing.exposure_s * reach * px_per_mm / np.sqrt(12)
    peak = laser.level(reach) * sheet / np.sqrt(sheet**2 + moved**2 + camera.blur_px**2)
    return float(min(0.9, PEAK / np.percentile(peak, 90)))


def _scan(frames: int, low: float, high: float) -> str:
    return f"[scan]\nframes = {frames}\nstart_deg = {low:.3f}\nend_deg = {high:.3f}\n"


def _object(shape: str, item: Surface, albedo: float, fields: str = "") -> str:
    position, turn = item.pose[:3, 3], Rotation.from_matrix(item.pose[:3, :3]).as_rotvec(degrees=True)
    return (
        f'[[object]]\nshape = "{shape}"\n{fields}position_mm = {position.tolist()}\nrotation_deg = {turn.tolist()}\n'
        f"albedo = [{albedo:.4f}, {albedo:.4f}, {albedo:.4f}]\n"
    )
