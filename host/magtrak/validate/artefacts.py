"""Artefacts of known size in scans, in the manner of VDI/VDE 2634 part 2 (optical systems with area probing).

What that guideline asks for and this does not: its ten places in the measuring volume and its acceptance by a maker's
limits. The figures are its own: size and form error of probing on a sphere, sphere spacing error, flatness error, each
from a Gaussian fit with at most three in a thousand points out of the range of the form; and the RMS, which does not
hang on single points. Several clouds of the same scene give the repeatability: the standard deviation of each figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..arrays import Floats, Records
from ..errors import MagtrakError
from .fits import Fit, PlaneFit, fit_plane
from .report import Line
from .segments import find_cylinder, find_planes, find_spheres

PAPER = "about 10 mm at 2 m"
PARALLEL = 0.03
"""Radians by which the planes of a step may lean against each other."""


@dataclass(frozen=True)
class Result:
    """What a test says.

    Attributes
    ----------
    lines : the figures
    fits : (name, fit) of the last cloud, for the picture
    """

    lines: list[Line]
    fits: list[tuple[str, Fit]] = field(default_factory=list)


def planes(clouds: Sequence[Records]) -> Result:
    """Flatness of the largest plane in each cloud; how steady it is where there are several."""
    fits = [_largest(cloud) for cloud in clouds]
    lines = [*_form("plane", fits, paper=PAPER)]
    if len(fits) > 1:
        middle = fits[0].points[fits[0].kept].mean(axis=0)
        heights = [float(fit.height(middle[None])[0]) for fit in fits]
        lines.append(Line("  repeatability of its place", _spread(heights)))
        leans = [float(np.arccos(np.clip(fit.normal @ fits[0].normal, -1, 1))) for fit in fits[1:]]
        lines.append(Line("  greatest lean against the first", float(np.degrees(max(leans))) * 60, "arcmin"))
        lines.append(Line("  repeatability, patch by patch", _patches(fits)))
    return Result(lines, [("plane", fits[-1])])


def spheres(clouds: Sequence[Records], radii: Sequence[float], distances: Sequence[float] = ()) -> Result:
    """Sizes, forms and spacings of spheres.

    Parameters
    ----------
    clouds : of the same scene
    radii : nominal, mm; equal ones are taken from left to right
    distances : nominal, mm, of the first to the second, the second to the third ...
    """
    if len(distances) > max(len(radii) - 1, 0):
        raise MagtrakError(f"{len(distances)} distances need {len(distances) + 1} spheres, {len(radii)} are given")
    found = [find_spheres(cloud, radii) for cloud in clouds]
    lines: list[Line] = []
    for number, radius in enumerate(radii):
        mine = [fits[number] for fits in found]
        name = f"sphere {number + 1}"
        lines += _size(name, [fit.radius for fit in mine], radius) + _form("  probing", mine)
    for number, (a, b) in enumerate(pairwise(range(len(radii)))):
        gaps = [float(np.linalg.norm(fits[a].centre - fits[b].centre)) for fits in found]
        nominal = distances[number] if number < len(distances) else None
        lines += _size(f"distance of spheres {a + 1} and {b + 1}", gaps, nominal)
    return Result(lines, [(f"sphere {number + 1}", fit) for number, fit in enumerate(found[-1])])


def cylinders(clouds: Sequence[Records], radius: float) -> Result:
    """Radius and form of a cylinder."""
    fits = [find_cylinder(cloud, radius) for cloud in clouds]
    lines = _size("cylinder", [fit.radius for fit in fits], radius) + _form("  form", fits)
    return Result(lines, [("cylinder", fits[-1])])


def steps(clouds: Sequence[Records], height: float) -> Result:
    """Height of a step between two parallel planes."""
    found = [_step(cloud, height) for cloud in clouds]
    lines = _size("step", [size for size, _, _ in found], height)
    lines += _form("  lower plane", [low for _, low, _ in found]) + _form(
        "  upper plane", [high for _, _, high in found]
    )
    return Result(lines, [("lower plane", found[-1][1]), ("upper plane", found[-1][2])])


def shapes(cloud: Records, radius: float, size: tuple[float, float, float]) -> Result:
    """The paper's second example, a cylinder and a box: are the shapes kept?

    Parameters
    ----------
    cloud : of the scene
    radius : of the cylinder, mm
    size : of the box, mm; of its faces two upright ones are seen
    """
    cylinder = find_cylinder(cloud, radius)
    left, right = _box(cloud, size)
    angle = float(np.degrees(np.arccos(np.clip(left.normal @ right.normal, -1, 1))))
    no_figure = "superposed by eye: no figure"
    lines = _size("cylinder", [cylinder.radius], radius, "radius", no_figure) + _form("  form", [cylinder], PAPER)
    lines.append(Line("box: angle of its faces", angle, "deg", 90.0, no_figure))
    lines += _form("  left face", [left], PAPER) + _form("  right face", [right], PAPER)
    return Result(lines, [("cylinder", cylinder), ("left face", left), ("right face", right)])


def _largest(cloud: Records) -> PlaneFit:
    found = find_planes(cloud)
    if not found:
        raise MagtrakError("no plane was found in the cloud: scan a flat wall or plate that fills much of the view")
    return found[0]


def _step(cloud: Records, height: float) -> tuple[float, PlaneFit, PlaneFit]:
    """Height, lower and upper plane; the height is measured from the larger plane to the other's middle."""
    found = find_planes(cloud)
    best: tuple[float, PlaneFit, PlaneFit] | None = None
    for number, one in enumerate(found):
        for other in found[number + 1 :]:
            if np.arccos(np.clip(one.normal @ other.normal, -1, 1)) > PARALLEL:
                continue
            size = float(one.height(other.points[other.kept]).mean())
            near, far = (one, other) if size < 0 else (other, one)
            # Both ways, for the planes are not quite parallel as measured.
            back = -float(other.height(one.points[one.kept]).mean())
            mean = (abs(size) + abs(back)) / 2
            if best is None or abs(mean - height) < abs(best[0] - height):
                best = mean, far, near
    if best is None or abs(best[0] - height) > 0.2 * height:
        seen = "no two parallel planes" if best is None else f"the nearest is {best[0]:.1f} mm"
        raise MagtrakError(f"no step of {height:g} mm was found ({seen}): was it in view, is the height right?")
    return best


def _box(cloud: Records, size: tuple[float, float, float]) -> tuple[PlaneFit, PlaneFit]:
    """The two upright faces of a box that are seen, from left to right.

    The largest piece is the background. Another one that is no single plane is cut in two: from the plane that most of
    it lies on, what is left over makes the second.
    """
    from .segments import pieces, positions

    points = positions(cloud)
    reach = float(np.linalg.norm(size)) * 1.1
    for piece in pieces(cloud)[1:]:
        body = points[piece]
        if np.ptp(body, axis=0).max() > reach:
            continue
        first = fit_plane(body)
        rest = body[np.abs(first.residuals) > max(6 * first.rms, 2.0)]
        if len(rest) < 0.1 * len(body):
            continue
        second = fit_plane(rest)
        faces = [_refined(body, one, other) for one, other in ((first, second), (second, first))]
        if abs(np.degrees(np.arccos(np.clip(faces[0].normal @ faces[1].normal, -1, 1))) - 90) < 10:
            return tuple(sorted(faces, key=lambda face: face.points[:, 0].mean()))  # type: ignore[return-value]
    raise MagtrakError(f"no box of {size[0]:g} x {size[1]:g} x {size[2]:g} mm was found: are two of its faces in view?")


def _refined(body: Floats, one: PlaneFit, other: PlaneFit) -> PlaneFit:
    """Points of ``body`` that are clearly nearer to ``one``: not within 8 mm of the edge."""
    near, far = np.abs(one.height(body)), np.abs(other.height(body))
    return fit_plane(body[(near < 5) & (far > 8)])


def _size(name: str, values: Sequence[float], nominal: float | None, what: str = "", paper: str = "") -> list[Line]:
    title = f"{name}: {what}" if what else (f"{name}: radius" if name.startswith(("sphere", "cylinder")) else name)
    lines = [Line(title, float(np.mean(values)), "mm", nominal, paper)]
    if len(values) > 1:
        lines.append(Line("  repeatability", _spread(values)))
    return lines


def _form(name: str, fits: Sequence[Fit], paper: str = "") -> list[Line]:
    rms = float(np.sqrt(np.mean([fit.rms**2 for fit in fits])))
    out = 100 * float(np.mean([fit.trimmed for fit in fits]))
    return [
        Line(f"{name}, form error, RMS", rms, "mm", None, paper),
        Line(f"{name}, form error, range (99.7 %)", max(fit.form for fit in fits)),
        Line(f"{name}, points left out", out, "%"),
    ]


def _spread(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1))


def _patches(fits: Sequence[PlaneFit], count: int = 12) -> float:
    """RMS difference of the mean heights above the first plane of the patches of a grid, over all pairs of clouds."""
    first = fits[0]
    spread = first.points[first.kept] - first.points[first.kept].mean(axis=0)
    frame = np.linalg.svd(spread, full_matrices=False)[2]
    span = np.abs(spread @ frame[:2].T).max(axis=0)
    means = []
    for fit in fits:
        used = fit.points[fit.kept]
        at = (used - first.points[first.kept].mean(axis=0)) @ frame[:2].T
        cell = np.clip(((at / span + 1) / 2 * count).astype(int), 0, count - 1) @ [count, 1]
        number = np.bincount(cell, minlength=count * count)
        sums = np.bincount(cell, weights=first.height(used), minlength=count * count)
        means.append(np.where(number >= 20, sums / np.maximum(number, 1), np.nan))
    return float(np.sqrt(np.nanmean(np.nanvar(np.array(means), axis=0, ddof=1))))
