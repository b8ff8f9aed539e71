"""How far the points of a scan lie from the true surfaces, and whether all were found that could be.

``python -m sim.evaluate --scene NAME --truth TRUTH.npz CLOUD.ply [--compare OTHER.ply [--compare-truth TRUTH.npz]]``

Every point is sorted by what the truth says about its row and column, never by its error:

dark
    the laser lit nothing there: within :data:`NEIGHBOURS` px of the column its noise-free light stays below
    :data:`DARK` grey levels.
edge
    the laser's spot straddles an edge: within three sigma of the line (its width, as the surface there
    shows it, with the movement during the exposure) plus half a pixel there is another face, a point that the
    laser does not reach, or the border of the picture. Part of the spot is missing or lies elsewhere.
clean
    all others: the whole spot lies on one face.

A row of a picture is *lit* where the noise-free light of its brightest pixel reaches :data:`LIT` grey levels.
Grey levels are those of the camera's brightest channel.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt

from . import ply, surfaces
from .errors import SimError
from .render import ACROSS, DOWN, Renderer
from .scene import Scene
from .surfaces import Floats, Ints
from .truth import PARTS, Truth

DARK = 4.0
NEIGHBOURS = 2
LIT = 40.0

NEEDED = ("x", "y", "z", "scalar_frame", "scalar_row", "scalar_column", "scalar_angle")


@dataclass(frozen=True)
class Errors:
    """Statistics of distances, mm; not a number without points."""

    points: int
    rms: float
    median: float
    p95: float

    @classmethod
    def of(cls, distances: Floats) -> "Errors":
        """Statistics of (N,) distances."""
        if not len(distances):
            return cls(0, np.nan, np.nan, np.nan)
        rms = float(np.sqrt(np.mean(distances**2)))
        return cls(len(distances), rms, float(np.median(distances)), float(np.percentile(distances, 95)))


@dataclass(frozen=True)
class Report:
    """What is known of a cloud.

    Members
    -------
    first_frame : picture of the simulation that the cloud calls frame 0
    points : all
    clean, edge, dark : see the module
    lit_rows, found_rows : lit rows of the pictures from the cloud's first to its last, and those that have a point
    angle_mean_rad, angle_rms_rad, angle_max_rad : error of the points' alpha
    counts_per_turn : to say the same in counts
    """

    first_frame: int
    points: int
    clean: Errors
    edge: Errors
    dark: Errors
    lit_rows: int
    found_rows: int
    angle_mean_rad: float
    angle_rms_rad: float
    angle_max_rad: float
    counts_per_turn: int

    @property
    def dark_share(self) -> float:
        """Part of the points where the laser lit nothing."""
        return self.dark.points / self.points if self.points else 0.0

    @property
    def found_share(self) -> float:
        """Part of the lit rows that gave a point."""
        return self.found_rows / self.lit_rows if self.lit_rows else 1.0


class Judge:
    """Knows a scene and what happened in a scan of it, and judges clouds.

    Parameters
    ----------
    scene, truth : as they were
    """

    def __init__(self, scene: Scene, truth: Truth) -> None:
        self.scene = scene
        self.truth = truth
        self._renderer = Renderer(scene)
        view = self._renderer.view
        height, width = scene.camera.height, scene.camera.width
        subs = ACROSS * DOWN
        ids = np.where(view.lit, view.face, -1).reshape(height, width, subs)
        # A pixel is whole where all its sub-pixels see one lit face; runs of whole pixels of one face follow.
        whole = np.where((ids == ids[..., :1]).all(axis=2), ids[..., 0], -1)
        columns = np.arange(width)
        breaks = np.ones((height, width), np.bool_)
        breaks[:, 1:] = (whole[:, 1:] != whole[:, :-1]) | (whole[:, 1:] < 0)
        self._run_first = np.maximum.accumulate(np.where(breaks, columns, 0), axis=1)
        ends = np.ones((height, width), np.bool_)
        ends[:, :-1] = breaks[:, 1:]
        self._run_last = np.minimum.accumulate(np.where(ends, columns, width)[:, ::-1], axis=1)[:, ::-1]
        self._whole = whole >= 0
        alpha = view.alpha.reshape(height, width, DOWN, ACROSS)
        # rad per px, within the pixel; meaningful where the pixel is whole.
        self._slope = np.abs((alpha[..., -1] - alpha[..., 0]).mean(axis=2)) * (ACROSS / (ACROSS - 1))
        self._sigma = view.sigma.reshape(height, width, subs).mean(axis=2)

    def light(self, frame: int) -> Floats:
        """(height, width) noise-free laser light of a picture in grey levels of the brightest channel."""
        motor = np.nan_to_num(self.truth.motor_rad[frame])
        fit = np.linalg.solve(np.vander(PARTS, 3), motor.T)  # the parabola through the three angles of each row

        def angle(part: Floats) -> Floats:
            row = fit if part.ndim == 2 and part.shape[0] == 2 else fit[:, :, None]
            return np.asarray((row[0] * part + row[1]) * part + row[2])

        zeros = np.zeros(len(motor))
        light = self._renderer.light(0, len(motor), *self._renderer.exposure(zeros, zeros + 1, angle))
        known = self.truth.laser_on[frame] & np.isfinite(self.truth.motor_rad[frame, :, 1])
        return np.where(known[:, None], light * self.scene.camera.gain, 0.0)

    def alpha(self, frames: Ints, rows: Ints) -> Floats:
        """True angle of the plane at the middle of the exposure."""
        return self.scene.laser.alpha(self.truth.motor_rad[frames, rows, 1])

    def straddles(self, frames: Ints, rows: Ints, columns: Floats) -> npt.NDArray[np.bool_]:
        """Whether the spot at each position goes over an edge; see the module."""
        at = np.clip(np.rint(columns).astype(np.int64), 0, self.scene.camera.width - 1)
        motor = self.truth.motor_rad[frames, rows]
        # A uniform movement over a span s has the standard deviation s / sqrt(12).
        sigma = np.hypot(self._sigma[rows, at], (motor[:, 2] - motor[:, 0]) / np.sqrt(12))
        reach = 3 * sigma / np.maximum(self._slope[rows, at], 1e-9) + 0.5
        inside = (columns - reach >= self._run_first[rows, at]) & (columns + reach <= self._run_last[rows, at])
        return np.asarray(~(self._whole[rows, at] & inside))

    def judge(self, cloud: npt.NDArray[Any], first_frame: int | None = None) -> Report:
        """Judge a cloud with the properties :data:`NEEDED`.

        Parameters
        ----------
        first_frame : picture that the cloud calls frame 0; by default the first, or where the angles contradict that,
            the one that fits them best

        Raises
        ------
        SimError : the cloud has points that the truth knows nothing of
        """
        frames, rows = cloud["scalar_frame"].astype(np.int64), cloud["scalar_row"].astype(np.int64)
        columns = cloud["scalar_column"].astype(np.float64)
        count, height = self.truth.laser_on.shape
        if len(cloud) and (frames.max() >= count or frames.min() < 0 or rows.max() >= height or rows.min() < 0):
            raise SimError(
                f"the cloud has frames to {frames.max()} and rows to {rows.max()}, and the truth has {count} frames of "
                f"{height} rows; do they belong together?"
            )
        if first_frame is None:
            first_frame = self._align(frames, rows, cloud["scalar_angle"])
        frames = frames + first_frame
        if len(cloud) and frames.max() >= count:
            raise SimError(f"the cloud has {frames.max() + 1} frames, and the truth {count}; do they belong together?")

        points = np.stack([cloud[name] for name in "xyz"], axis=1).astype(np.float64)
        distances = surfaces.distance(self.scene.surfaces, points)
        edge = self.straddles(frames, rows, columns)
        dark, lit_rows, found_rows = self._light_at(frames, rows, columns)
        error = _wrap(cloud["scalar_angle"].astype(np.float64) - self.alpha(frames, rows))
        some = len(error) > 0
        return Report(
            first_frame,
            len(cloud),
            Errors.of(distances[~edge & ~dark]),
            Errors.of(distances[edge & ~dark]),
            Errors.of(distances[dark]),
            lit_rows,
            found_rows,
            float(error.mean()) if some else np.nan,
            float(np.sqrt(np.mean(error**2))) if some else np.nan,
            float(np.abs(error).max()) if some else np.nan,
            self.scene.counts_per_turn,
        )

    def _light_at(self, frames: Ints, rows: Ints, columns: Floats) -> tuple[npt.NDArray[np.bool_], int, int]:
        """Which points are dark; how many rows are lit, and how many of these have a point."""
        dark = np.ones(len(frames), np.bool_)
        lit_rows = found_rows = 0
        for frame in range(int(frames.min()), int(frames.max()) + 1) if len(frames) else ():
            light = self.light(frame)
            lit = light.max(axis=1) >= LIT
            mine = np.flatnonzero(frames == frame)
            found = np.zeros(len(lit), np.bool_)
            found[rows[mine]] = True
            lit_rows += int(lit.sum())
            found_rows += int((lit & found).sum())
            near = np.rint(columns[mine]).astype(np.int64)[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
            near = np.clip(near, 0, light.shape[1] - 1)
            dark[mine] = light[rows[mine][:, None], near].max(axis=1) < DARK
        return dark, lit_rows, found_rows

    def _align(self, frames: Ints, rows: Ints, angles: npt.NDArray[Any]) -> int:
        """Picture that frame 0 is: 0 if the angles allow it."""
        if not len(frames):
            return 0
        room = len(self.truth.laser_on) - int(frames.max())
        if room <= 1:
            return 0
        errors = [self._misfit(angles, frames + first, rows) for first in range(room)]
        best = int(np.argmin(errors))
        # An error of the angle must not be taken for a shift: only half a frame's movement or more is one.
        steps = np.abs(np.diff(self.truth.motor_rad[:, 0, 1]))
        return best if errors[0] - errors[best] > np.median(steps[np.isfinite(steps)]) / 2 else 0

    def _misfit(self, angles: npt.NDArray[Any], frames: Ints, rows: Ints) -> float:
        """Median error of the angles; infinite where they belong to rows that were never sent."""
        error = np.abs(_wrap(angles - self.alpha(frames, rows)))
        return float(np.median(error)) if np.isfinite(error).all() else np.inf


def _wrap(angle: npt.NDArray[Any]) -> Floats:
    """Angles within half a turn of 0."""
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi, dtype=np.float64)


def table(reports: dict[str, Report]) -> str:
    """Reports side by side, by name."""
    lines: list[tuple[str, list[str]]] = [("", list(reports))]

    def line(title: str, *texts: str) -> None:
        lines.append((title, list(texts)))

    every = list(reports.values())
    line("points", *(f"{r.points}" for r in every))
    for title, kind in (("spot on one surface", "clean"), ("spot over an edge", "edge"), ("laser lit nothing", "dark")):
        line(title, *(f"{getattr(r, kind).points}" for r in every))
        if kind == "dark":
            line("  share of all, %", *(f"{100 * r.dark_share:.3f}" for r in every))
            continue
        for name, what in (("RMS", "rms"), ("median", "median"), ("95th percentile", "p95")):
            line(f"  {name}, mm", *(f"{getattr(getattr(r, kind), what):.3f}" for r in every))
    line("lit rows", *(f"{r.lit_rows}" for r in every))
    line("  that gave a point, %", *(f"{100 * r.found_share:.2f}" for r in every))
    for title, scale, digits in (("counts", None, 3), ("deg", 180 / np.pi, 5)):
        for name, what in (("mean", "angle_mean_rad"), ("RMS", "angle_rms_rad"), ("greatest", "angle_max_rad")):
            factors = [r.counts_per_turn / (2 * np.pi) if scale is None else scale for r in every]
            texts = [f"{getattr(r, what) * f:.{digits}f}" for r, f in zip(every, factors, strict=True)]
            line(f"angle error, {name}, {title}", *texts)
    widths = [max(len(texts[i]) for _, texts in lines) for i in range(len(every))]
    left = max(len(title) for title, _ in lines)
    return "\n".join(
        title.ljust(left) + "".join(f"  {text.rjust(width)}" for text, width in zip(texts, widths, strict=True))
        for title, texts in lines
    )


@click.command()
@click.argument("cloud", type=click.Path(path_type=Path))
@click.option("--scene", "name", default="default", show_default=True, help="Scene that was scanned.")
@click.option("--truth", "truth_path", type=click.Path(path_type=Path), required=True, help="Log of the virtual card.")
@click.option("--compare", type=click.Path(path_type=Path), help="Another cloud of the same scan, shown beside.")
@click.option(
    "--compare-truth",
    type=click.Path(path_type=Path),
    help="Log of the other cloud, if it is of another scan.",
)
@click.option("--first-frame", type=int, help="Picture that the cloud calls frame 0.")
def main(
    cloud: Path,
    name: str,
    truth_path: Path,
    compare: Path | None,
    compare_truth: Path | None,
    first_frame: int | None,
) -> None:
    """Print the error of the points of CLOUD (PLY) against the true surfaces of a scene."""
    try:
        scene = Scene.load(name)
        judge = Judge(scene, Truth.load(truth_path, scene))
        report = judge.judge(ply.read(cloud, NEEDED), first_frame)
        reports = {cloud.stem: report}
        if compare is not None:
            other = ply.read(compare, NEEDED)
            if compare_truth is None:
                reports[compare.stem] = judge.judge(other, report.first_frame)
            else:
                reports[compare.stem] = Judge(scene, Truth.load(compare_truth, scene)).judge(other, first_frame)
    except SimError as error:
        raise click.ClickException(str(error)) from None
    click.echo(table(reports))


if __name__ == "__main__":
    main()
