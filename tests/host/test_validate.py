"""Fits and artefacts on clouds whose errors are known, made by casting rays at the simulator's surfaces."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from magtrak.cli.magtrak import main
from magtrak.cli.validate import _beside
from magtrak.cloud.picture import require_matplotlib
from magtrak.cloud.ply import write_ply
from magtrak.cloud.points import POINT
from magtrak.errors import MagtrakError
from magtrak.validate import artefacts
from magtrak.validate.fits import axis_of, fit_cylinder, fit_plane, fit_sphere
from magtrak.validate.picture import draw
from magtrak.validate.report import Line, table
from magtrak.validate.segments import find_cylinder, find_planes, find_spheres, pieces
from sim import surfaces
from sim.parts import pose_of
from sim.surfaces import Box, Cylinder, Plane, Sphere, Surface
from tests.sim.rig import at

NOISE_MM = 0.2


def cast(scene: list[Surface], seed: int = 1, noise: float = NOISE_MM, twice: bool = True) -> np.ndarray:
    """A cloud: columns of the picture are frames, there and back; every point moves along its sight by the noise."""
    rng = np.random.default_rng(seed)
    columns, rows = np.arange(220), np.arange(150)
    frame, row = (a.ravel() for a in np.meshgrid(columns, rows, indexing="ij"))
    parts = []
    for start in (0, len(columns) + 5) if twice else (0,):
        rays = np.stack([(frame - 110) / 250, (row - 75) / 190, np.ones(len(frame))], axis=-1)
        hits = surfaces.nearest(scene, (0, 0, 0), rays)
        seen = hits.face >= 0
        points = rays[seen] * (hits.t[seen] + rng.normal(0, noise, seen.sum()))[:, None]
        cloud = np.zeros(seen.sum(), POINT)
        cloud["x"], cloud["y"], cloud["z"] = points.T
        cloud["scalar_frame"], cloud["scalar_row"] = frame[seen] + start, row[seen]
        cloud["quality"] = 1
        parts.append(cloud)
    return np.concatenate(parts)


WALL = Plane(pose=pose_of((0, 0, 2400), np.array([0.03, 0.05, 0.0])))
SPHERES = [WALL, Sphere(100, at(-350, -150, 1900)), Sphere(100, at(150, -180, 1950)), Sphere(75, at(-300, 250, 1850))]


@pytest.fixture(scope="module")
def spheres() -> np.ndarray:
    return cast(SPHERES)


def test_plane_by_hand() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    z = 100 + np.array([0.1, -0.1, 0.05, -0.05, 0.0])[((x + 2 * y) % 5).astype(int)]
    fit = fit_plane(np.stack([x, y, z], axis=-1))
    assert fit.normal == pytest.approx([0, 0, -1], abs=0.01)
    assert fit.distance == pytest.approx(-100, abs=0.05)
    assert fit.rms == pytest.approx(np.sqrt(0.005), rel=0.01)
    assert fit.form == pytest.approx(0.2, rel=0.01)
    assert fit.trimmed == 0
    assert fit.height(np.array([[5.0, 5, 90]])) == pytest.approx([10], abs=0.02)


def test_fits_do_not_see_a_fifth_of_strangers() -> None:
    rng = np.random.default_rng(7)
    about = rng.normal(size=(4000, 3)) * [1, 1, 0.4] - [0, 0, 0.7]
    ball = about / np.linalg.norm(about, axis=1, keepdims=True) * (80 + rng.normal(0, 0.2, (4000, 1))) + [10, 20, 1800]
    strangers = rng.uniform([-80, -60, 1700], [100, 100, 1900], (800, 3))
    fit = fit_sphere(np.concatenate([ball, strangers]))
    print(f"radius {fit.radius:.4f} +- {fit.radius_sigma:.4f}, centre {fit.centre}")
    assert fit.radius == pytest.approx(80, abs=5 * fit.radius_sigma)
    assert fit.radius_sigma < 0.05
    assert fit.centre == pytest.approx([10, 20, 1800], abs=0.05)
    assert 0.12 < fit.trimmed < 0.2
    assert fit.rms == pytest.approx(0.2, rel=0.05)


def test_cylinder_of_any_direction() -> None:
    rng = np.random.default_rng(8)
    for seed in range(4):
        axis = np.random.default_rng(seed).normal(size=3)
        axis /= np.linalg.norm(axis)
        u = np.linalg.svd(axis[None])[2][1:]
        angle, along = rng.uniform(0, 2.4, 3000), rng.uniform(-200, 200, 3000)
        size = 60 + rng.normal(0, 0.1, 3000)
        points = along[:, None] * axis + (size * np.cos(angle))[:, None] * u[0] + (size * np.sin(angle))[:, None] * u[1]
        points += [100, -50, 2000]
        assert abs(axis_of(points) @ axis) > np.cos(0.05)
        fit = fit_cylinder(points)
        assert fit.radius == pytest.approx(60, abs=5 * fit.radius_sigma)
        assert fit.radius_sigma < 0.05
        assert abs(fit.axis @ axis) == pytest.approx(1, abs=1e-6)
        assert fit.rms == pytest.approx(0.1, rel=0.1)


def test_range_of_the_form_leaves_three_in_a_thousand_out() -> None:
    rng = np.random.default_rng(9)
    points = np.column_stack([rng.uniform(-500, 500, (4000, 2)), 1000 + rng.uniform(-0.5, 0.5, 4000)])
    whole = fit_plane(points).form
    points[:10, 2] += 1.1  # of 4000, 12 may be left out; none is beyond the trim of 4 sigma
    fit = fit_plane(points)
    assert fit.trimmed == 0
    assert np.ptp(fit.residuals) > 1.4
    assert fit.form == pytest.approx(whole, abs=0.02)


def test_too_few_points() -> None:
    with pytest.raises(MagtrakError, match="29 points are too few for a surface"):
        fit_plane(np.zeros((29, 3)))


def test_pieces_are_bodies_seen_twice(spheres: np.ndarray) -> None:
    found = pieces(spheres)
    assert len(found) == 4
    for piece, item in zip(found[1:], (SPHERES[1], SPHERES[2], SPHERES[3]), strict=True):
        assert item.distance(np.stack([spheres[piece][n] for n in "xyz"], -1)).max() < 6 * NOISE_MM


def test_spheres(spheres: np.ndarray) -> None:
    for fit, (radius, centre) in zip(
        find_spheres(spheres, [100, 100, 75]),
        ((100, (-350, -150, 1900)), (100, (150, -180, 1950)), (75, (-300, 250, 1850))),
        strict=True,
    ):
        assert fit.radius == pytest.approx(radius, abs=0.05)
        assert fit.centre == pytest.approx(centre, abs=0.05)
    distance = float(np.linalg.norm([500, -30, 50]))
    clouds = [spheres, cast(SPHERES, 2)]
    lines = {line.what: line for line in artefacts.spheres(clouds, [100, 100], [distance]).lines}
    assert lines["distance of spheres 1 and 2"].error == pytest.approx(0, abs=0.05)
    assert lines["sphere 2: radius"].error == pytest.approx(0, abs=0.05)
    assert 0 < lines["  repeatability"].value < 0.1
    with pytest.raises(MagtrakError, match=r"no sphere of radius 60 mm was found \(radii found: none\)"):
        find_spheres(spheres, [60])
    with pytest.raises(MagtrakError, match=r"no sphere of radius 75 mm was found"):
        find_spheres(spheres, [75, 75])
    with pytest.raises(MagtrakError, match="2 distances need 3 spheres, 2 are given"):
        artefacts.spheres([spheres], [100, 100], [500, 500])


def test_a_bent_sphere_shows_its_form_error_not_a_wrong_radius() -> None:
    bumpy = cast(SPHERES, noise=0.05)
    middle = np.array([-350, -150, 1900])
    out = np.stack([bumpy[n] for n in "xyz"], -1) - middle
    mine = np.linalg.norm(out, axis=1) < 110
    wave = 1 + 0.01 * np.sin(out[mine, 0] / 3)
    for number, name in enumerate("xyz"):
        bumpy[name][mine] = middle[number] + out[mine, number] * wave
    (fit,) = find_spheres(bumpy, [100])
    assert fit.rms == pytest.approx(1 / np.sqrt(2), rel=0.1)
    assert fit.radius == pytest.approx(100, abs=0.3)


def test_cylinder_and_box_of_the_second_example() -> None:
    turn = np.array([0, np.radians(40), 0])
    scene = [WALL, Box((380, 620, 300), pose_of((-270, 200, 1880), turn)), Cylinder(160, 900, at(330, 100, 1900))]
    cloud = cast(scene)
    lines = {line.what: line for line in artefacts.shapes(cloud, 160, (380, 620, 300)).lines}
    assert lines["cylinder: radius"].error == pytest.approx(0, abs=0.1)
    assert lines["box: angle of its faces"].error == pytest.approx(0, abs=0.1)
    for face in ("left", "right"):
        # The noise is along the sight, the faces stand at a slant.
        assert 0.4 * NOISE_MM < lines[f"  {face} face, form error, RMS"].value < NOISE_MM
    with pytest.raises(MagtrakError, match=r"no cylinder of radius 90 mm was found \(radii found: 1\d\d\.\d\)"):
        find_cylinder(cloud, 90)
    with pytest.raises(MagtrakError, match="no box of 380 x 620 x 300 mm was found"):
        artefacts.shapes(cast([WALL, scene[2]]), 160, (380, 620, 300))


@pytest.mark.parametrize("lean_deg", [40.0, 62.0])
def test_a_cylinder_whose_end_is_seen(lean_deg: float) -> None:
    """A short one that leans towards the camera: its flat end, all of one normal, has many of the points, or most."""
    pose = pose_of((100, -60, 1900), np.radians([lean_deg, 0, 25]))
    cloud = cast([WALL, Cylinder(160, 330, pose)])
    local = (np.stack([cloud[name] for name in "xyz"], axis=-1) - pose[:3, 3]) @ pose[:3, :3]
    across = np.hypot(local[:, 0], local[:, 2])
    end = (np.abs(local[:, 1] - 165) < 2) & (across < 150) | (np.abs(local[:, 1] + 165) < 2) & (across < 150)
    side = (np.abs(across - 160) < 2) & (np.abs(local[:, 1]) < 160)
    print(f"{end.sum()} points on the end, {side.sum()} on the side")
    assert (end.sum() > side.sum()) == (lean_deg > 50)
    fit = find_cylinder(cloud, 160)
    assert fit.radius == pytest.approx(160, abs=0.2)
    assert abs(fit.axis @ pose[:3, 1]) == pytest.approx(1, abs=1e-5)
    assert 0.4 * NOISE_MM < fit.rms < NOISE_MM


def test_step() -> None:
    lean = np.array([0.1, -0.05, 0.02])
    low, high = (pose_of(np.array([x, 20, 1950]), lean) for x in (-160, 120))
    high[:3, 3] = low[:3, 3] + low[:3, :3] @ [260, 0, -45]
    cloud = cast([WALL, Plane((220, 300), low), Plane((220, 300), high)])
    lines = {line.what: line for line in artefacts.steps([cloud], 45).lines}
    assert lines["step"].error == pytest.approx(0, abs=0.05)
    with pytest.raises(MagtrakError, match=r"no step of 80 mm was found \(the nearest is 45\.\d mm\)"):
        artefacts.steps([cloud], 80)


def test_plane_and_its_repeatability() -> None:
    first = cast([WALL], 1, twice=False)
    moved = cast([Plane(pose=WALL.pose @ at(0, 0, 0.5))], 2, twice=False)
    lines = {line.what: line for line in artefacts.planes([first, moved]).lines}
    assert lines["plane, form error, RMS"].value == pytest.approx(NOISE_MM, rel=0.1)
    assert lines["  repeatability of its place"].value == pytest.approx(0.5 / np.sqrt(2), rel=0.1)
    assert lines["  repeatability, patch by patch"].value == pytest.approx(0.5 / np.sqrt(2), rel=0.15)
    assert lines["  greatest lean against the first"].value < 0.3


def test_no_plane_and_no_scan() -> None:
    with pytest.raises(MagtrakError, match="the cloud is empty"):
        find_planes(np.zeros(0, POINT))
    with pytest.raises(MagtrakError, match="the cloud has no property scalar_frame"):
        find_planes(np.zeros(10, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    with pytest.raises(MagtrakError, match="no plane was found"):
        artefacts.planes([cast([Sphere(500, at(0, 0, 2000))], twice=False)])


def test_table_leaves_out_empty_columns() -> None:
    text = table([Line("a", 1.25), Line("b", 2.0, "deg", 1.5, "some")], "Title")
    assert text.splitlines()[0] == "Title"
    assert "the paper's way" not in text
    assert text.splitlines()[-1].split() == ["b", "2.000", "1.500", "+0.500", "deg", "some"]
    assert "the paper's way" in table([Line("a", 1.0, other=3.0)])


def test_picture(tmp_path: Path, spheres: np.ndarray) -> None:
    require_matplotlib()
    fits = artefacts.spheres([spheres], [100]).fits + artefacts.planes([spheres]).fits
    draw(fits, tmp_path / "a.png", "title")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(MagtrakError, match="cannot be written"):
        draw(fits, tmp_path / "none" / "a.png")


def test_command(tmp_path: Path, spheres: np.ndarray) -> None:
    cloud = tmp_path / "scan.ply"
    write_ply(cloud, [spheres])
    run = CliRunner().invoke
    done = run(main, ["validate", "spheres", str(cloud), "--radius", "100", "--radius", "75"])
    assert done.exit_code == 0, done.output
    assert "sphere 2: radius" in done.output
    for arguments, message in (
        (["plane"], "give at least one cloud (PLY), or --virtual DIR"),
        (["spheres", str(cloud)], "--radius is needed: the nominal size of the artefact in mm"),
        (["step", str(cloud), "--height", "33"], "no step of 33 mm was found"),
        (["cylinder", str(cloud), "--radius", "50"], "no cylinder of radius 50 mm was found"),
        (["plane", str(tmp_path / "none.ply")], "none.ply cannot be read: No such file"),
        (["plane", str(cloud), "--virtual", str(tmp_path)], "give either clouds or --virtual"),
        (["camera"], "--calibration is needed, or --virtual DIR"),
        (["laser", "--calibration", "a", "--board-picture", "b", "--target", "c"], "give a cloud (PLY) of the board"),
    ):
        done = run(main, ["validate", *arguments])
        assert done.exit_code == 1
        assert message in done.output
        assert len(done.output.strip().splitlines()) == 1, done.output


def test_the_papers_way_stands_beside_line_by_line() -> None:
    first, second, rough = (cast([WALL], seed, noise, twice=False) for seed, noise in ((1, 0.2), (2, 0.2), (3, 1.0)))
    beside = _beside(artefacts.planes([first, second]), artefacts.planes, rough)
    others = {line.what: line.other for line in beside.lines}
    assert others["plane, form error, RMS"] == artefacts.planes([rough]).lines[0].value
    assert others["  repeatability, patch by patch"] is None
    ball = artefacts.planes([first])
    assert _beside(ball, artefacts.planes, cast([Sphere(500, at(0, 0, 2000))], twice=False)) is ball
