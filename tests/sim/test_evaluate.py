"""The judge against clouds whose errors are known.

The wall at Z = 2000 of the other tests; the motor turns by 1 mrad from picture to picture, and not during a picture.
"""

from math import atan, cos, pi

import numpy as np
import pytest
from click.testing import CliRunner

from sim import ply, surfaces
from sim.errors import SimError
from sim.evaluate import NEEDED, Judge, main, table
from sim.render import Renderer
from sim.scene import Scene
from sim.surfaces import Cylinder, Plane
from sim.truth import Truth, TruthLog
from tests.sim.rig import at, centroid, rig

FRAMES, HEIGHT = 6, 24
MIDDLE = atan(500 / 2000)
COUNT = 2 * pi / 8192
DTYPE = [(name, "<f8") for name in NEEDED]


def angle_of(frame: int) -> float:
    return MIDDLE + 1e-3 * (frame - 2)


def log_of(scene: Scene, frames: int = FRAMES, **options: bool) -> TruthLog:
    log = TruthLog(scene)
    for frame in range(frames):
        angle = angle_of(frame)
        log.rows(frame, 0, scene.timing.rows(0.02 * frame), lambda t, a=angle: np.full(np.shape(t), a), **options)
    return log


def wall_cloud(frames: int = FRAMES) -> np.ndarray:
    """The true points of the wall, one for each row and picture."""
    frame, row = (a.ravel() for a in np.mgrid[0:frames, 0:HEIGHT])
    cloud = np.zeros(frames * HEIGHT, DTYPE)
    alpha = MIDDLE + 1e-3 * (frame - 2)
    cloud["x"], cloud["y"], cloud["z"] = 2000 * np.tan(alpha) - 500, (row - 12) * 2.5, 2000
    cloud["scalar_frame"], cloud["scalar_row"], cloud["scalar_angle"] = frame, row, alpha
    cloud["scalar_column"] = 80 + cloud["x"] / 2.5
    return cloud


@pytest.fixture(scope="module")
def judge() -> Judge:
    scene = rig()
    return Judge(scene, log_of(scene).truth())


def test_a_perfect_cloud(judge: Judge) -> None:
    report = judge.judge(wall_cloud())
    assert report.points == report.clean.points == FRAMES * HEIGHT
    assert (report.edge.points, report.dark.points, report.first_frame) == (0, 0, 0)
    assert report.clean.rms < 1e-9
    assert report.lit_rows == report.found_rows == FRAMES * HEIGHT
    assert report.angle_max_rad < 1e-12


def test_known_distances(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud["z"] += np.where(np.arange(len(cloud)) % 2, 0.3, -0.5)
    cloud["z"][::24] += 4.0  # -0.5 becomes 3.5, in 6 of 144
    report = judge.judge(cloud)
    assert report.clean.points == len(cloud), "a large error must not change the class"
    assert report.clean.rms == pytest.approx(np.sqrt((72 * 0.09 + 66 * 0.25 + 6 * 12.25) / 144))
    assert report.clean.median == pytest.approx(0.4)
    assert report.clean.p95 == pytest.approx(np.percentile([0.3] * 72 + [0.5] * 66 + [3.5] * 6, 95))


def test_lost_rows(judge: Judge) -> None:
    cloud = wall_cloud()
    report = judge.judge(cloud[cloud["scalar_row"] >= 6])
    assert (report.lit_rows, report.found_rows) == (144, 108)
    assert report.found_share == 0.75


def test_points_where_the_laser_lit_nothing(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud["scalar_column"][:10] += 12
    report = judge.judge(cloud)
    assert report.dark.points == 10
    assert report.dark_share == pytest.approx(10 / 144)
    assert report.clean.points == 134


def test_laser_off() -> None:
    scene = rig()
    report = Judge(scene, log_of(scene, laser_on=False).truth()).judge(wall_cloud())
    assert (report.dark.points, report.lit_rows) == (144, 0)


def test_angle_errors(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud["scalar_angle"] += np.where(np.arange(len(cloud)) % 2, 0.02, -0.01) * COUNT + 2 * pi
    report = judge.judge(cloud)
    assert report.angle_mean_rad / COUNT == pytest.approx(0.005)
    assert report.angle_rms_rad / COUNT == pytest.approx(np.sqrt((4e-4 + 1e-4) / 2))
    assert report.angle_max_rad / COUNT == pytest.approx(0.02)


def test_finds_the_first_frame(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud = cloud[cloud["scalar_frame"] >= 2]
    cloud["scalar_frame"] -= 2
    report = judge.judge(cloud)
    assert report.first_frame == 2
    assert report.clean.rms < 1e-9
    # A bias of less than half a picture's movement is an error of the angle, not a shift.
    cloud = wall_cloud(5)
    cloud["scalar_angle"] += 0.4e-3
    assert judge.judge(cloud).first_frame == 0


def test_depth_step() -> None:
    """A step at X = 0, from the wall to a sheet at Z = 1990 on its right.

    Three sigma of the line (3 mm over cos alpha, seen at 2.5 mm a pixel) and half a pixel to each side of the step
    at column 80 are no place to measure; pixels that the step cuts are not, either.
    """
    scene = rig([Plane(pose=at(0, 0, 2000)), Plane((4000, 4000), at(2000, 0, 1990))])
    judge = Judge(scene, log_of(scene).truth())
    columns = np.linspace(60, 100, 401)
    zeros = np.zeros(401, np.int64)
    edge = judge.straddles(zeros, zeros + 7, columns)
    reach = 3 * 3 / cos(MIDDLE) / 2.5 + 0.5
    assert columns[edge].min() == pytest.approx(79 - reach, abs=0.3)
    # To the right the first whole pixel lies right of the one with the step, and the sheet is a little nearer.
    assert columns[edge].max() == pytest.approx(81 + reach, abs=0.6)
    assert np.all(np.diff(columns[edge]) < 0.11)


def test_spot_cut_by_the_border_of_the_picture() -> None:
    scene = rig()
    judge = Judge(scene, log_of(scene).truth())
    zeros = np.zeros(3, np.int64)
    assert judge.straddles(zeros, zeros, np.array([2.0, 80.0, 157.0])).tolist() == [True, False, True]


def test_straddling_grows_with_the_movement() -> None:
    scene = rig([Plane(pose=at(0, 0, 2000)), Plane((4000, 4000), at(2000, 0, 1990))], exposure_s=0.01)
    log = TruthLog(scene)
    log.rows(0, 0, scene.timing.rows(1.0), lambda t: MIDDLE + 1.0 * (t - 1.0))
    zero, column = np.zeros(1, np.int64), np.array([73.0])
    edge = Judge(scene, log.truth()).straddles(zero, zero, column)
    still = Judge(scene, log_of(scene).truth()).straddles(zero, zero, column)
    assert (edge[0], still[0]) == (True, False)


def test_a_rendered_line_triangulates_onto_the_surfaces() -> None:
    """Noise-free centroids, moving rows, distortion, a leaning plane off its axis: within 0.1 mm of the truth.

    The triangulation is this test's own: the ray meets the plane of the definition. The beam is thin, because the
    shading of a curved surface pulls the centroid of a wide one, by the square of its width.
    """
    scene = rig(
        [Plane(pose=at(0, 0, 2100)), Cylinder(150, 900, at(60, 0, 1950))],
        width=320, height=48, distortion=(-0.1, 0.05, 0.001, -0.001, 0.0), exposure_s=0.003, readout_delay_s=0.001,
        tilt_rad=0.02, offset_mm=3.0, waist_mm=1.5,
    )  # fmt: skip
    renderer, log = Renderer(scene), TruthLog(scene)

    def angle(t: np.ndarray) -> np.ndarray:
        return MIDDLE - 0.02 + 0.2 * t

    rows = []
    for frame in range(8):
        times = scene.timing.rows(0.1 * frame)
        log.rows(frame, 0, times, angle)
        light = renderer.light(0, 48, *renderer.exposure(*scene.timing.exposed(times), angle)).astype(float)
        bright = light.argmax(axis=1)
        # One piece of the line: the columns about the brightest.
        light[np.abs(np.arange(320) - bright[:, None]) > 8] = 0
        rows += [(frame, row, centroid(light)[row]) for row in range(48) if light[row].max() > 40]
    frame, row = np.array([r[:2] for r in rows]).T
    column = np.array([r[2] for r in rows])
    judge = Judge(scene, log.truth())

    alpha = scene.laser.alpha(angle(0.1 * frame + row * 100e-6 - 0.001 - 0.0015))
    n = np.stack([-np.sin(alpha) * cos(0.02), np.cos(alpha) * cos(0.02), np.full(len(alpha), np.sin(0.02))], axis=1)
    rays = scene.camera.rays(column, row)
    pose = np.array(scene.laser.camera_from_laser)
    goal = 3.0 + n @ (pose[:3, :3].T @ pose[:3, 3])
    points = rays * (goal / np.sum(n * (rays @ pose[:3, :3]), axis=1))[:, None]
    cloud = np.zeros(len(rows), DTYPE)
    cloud["x"], cloud["y"], cloud["z"] = points.T
    cloud["scalar_frame"], cloud["scalar_row"], cloud["scalar_column"] = frame, row, column
    cloud["scalar_angle"] = alpha
    report = judge.judge(cloud)
    assert report.clean.points > 200
    on_wall = surfaces.distance(scene.surfaces[:1], points) < surfaces.distance(scene.surfaces[1:], points)
    assert 40 < on_wall.sum() < 200, "both have to be measured"
    assert report.clean.rms < 0.1
    assert report.clean.median < 0.05
    assert report.dark.points == 0
    assert report.angle_max_rad < 1e-12


def write(path, cloud: np.ndarray) -> None:
    names = {"<f4": "float", "<f8": "double"}
    fields = [f"property {names[dtype]} {name}\n" for name, dtype in cloud.dtype.descr]
    head = f"ply\nformat binary_little_endian 1.0\ncomment made by hand\nelement vertex {len(cloud)}\n"
    path.write_bytes((head + "".join(fields) + "end_header\n").encode() + cloud.tobytes())


def quick_cloud() -> np.ndarray:
    cloud = wall_cloud(1)
    return cloud.astype([(name, "<f4") for name in NEEDED])


def test_command(tmp_path) -> None:
    scene = Scene.load("quick")
    log = TruthLog(scene)
    log.rows(0, 0, scene.timing.rows(0.0), lambda t: np.full(np.shape(t), 0.3))
    log.save(tmp_path / "new" / "truth.npz")
    truth = Truth.load(tmp_path / "new" / "truth.npz", scene)
    assert truth.motor_rad.shape == (1, 120, 3)
    assert np.all(truth.motor_rad == 0.3)
    for name in ("scan", "paper"):
        write(tmp_path / f"{name}.ply", quick_cloud())
    arguments = [str(tmp_path / "scan.ply"), "--scene", "quick", "--truth", str(tmp_path / "new" / "truth.npz")]
    result = CliRunner().invoke(main, [*arguments, "--compare", str(tmp_path / "paper.ply")])
    assert result.exit_code == 0, result.output
    assert "spot on one surface" in result.output
    assert result.output.split()[:2] == ["scan", "paper"]
    same = CliRunner().invoke(
        main, [*arguments, "--compare", str(tmp_path / "paper.ply"), "--compare-truth", arguments[-1]]
    )
    assert same.output == result.output
    missing = CliRunner().invoke(main, [*arguments[:-1], str(tmp_path / "none.npz")])
    assert missing.exit_code == 1
    assert missing.output.startswith("Error: the truth")
    assert len(missing.output.splitlines()) == 1


def test_table_names_every_figure(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud["z"] += 0.25
    text = table({"scan": judge.judge(cloud), "empty": judge.judge(cloud[:0])})
    lines = dict(line.rsplit(maxsplit=2)[:2] for line in text.splitlines()[1:])
    assert lines["points"] == "144"
    assert lines["  RMS, mm"] in ("0.250", "nan")
    assert lines["  that gave a point, %"] == "100.00"


def test_truth_of_another_scene(tmp_path) -> None:
    log_of(rig()).save(tmp_path / "truth.npz")
    with pytest.raises(SimError, match="belongs to the scene rig, not default"):
        Truth.load(tmp_path / "truth.npz", Scene.load("default"))
    (tmp_path / "bad.npz").write_text("no")
    with pytest.raises(SimError, match=r"the truth .*bad\.npz can't be read"):
        Truth.load(tmp_path / "bad.npz", rig())


def test_cloud_of_another_scan(judge: Judge) -> None:
    cloud = wall_cloud()
    cloud["scalar_frame"] += 1
    with pytest.raises(SimError, match="the truth has 6 frames of 24 rows; do they belong together"):
        judge.judge(cloud)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "is cut short"),
        (lambda data: data.replace(b"ply", b"plx", 1), "not a binary little-endian PLY"),
        (lambda data: data.replace(b"little", b"big", 1), "not a binary little-endian PLY"),
        (lambda data: data.replace(b"scalar_row", b"scalar_raw", 1), "has no property scalar_row"),
        (lambda data: data.replace(b"element vertex", b"element face", 1), "does not begin with vertices"),
        (lambda data: data.replace(b"property float x", b"property list x", 1), "not a plain number"),
        (lambda data: b"", "not a binary little-endian PLY"),
    ],
)
def test_damaged_clouds(tmp_path, damage, message: str) -> None:
    path = tmp_path / "cloud.ply"
    write(path, quick_cloud())
    assert len(ply.read(path, NEEDED)) == HEIGHT
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(SimError, match=message):
        ply.read(path, NEEDED)
