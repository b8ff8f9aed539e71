"""Pictures of what is left over: the residuals of fits, where they lie and how they spread."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..arrays import Floats
from ..cloud.picture import require_matplotlib
from ..errors import OutputError
from .fits import CylinderFit, Fit, SphereFit

MOST_POINTS = 60_000


def draw(fits: Sequence[tuple[str, Fit]], path: Path, title: str = "") -> None:
    """Draw each fit's residuals on its surface, and their distribution, into a PNG file.

    Raises
    ------
    OutputError
        The file can't be written.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(fits) + 0.6, 7.2), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(fits), height_ratios=[2.2, 1], squeeze=False)
    for (name, fit), above, below in zip(fits, *axes, strict=True):
        kept = np.flatnonzero(fit.kept)
        if len(kept) > MOST_POINTS:
            kept = kept[np.linspace(0, len(kept) - 1, MOST_POINTS).astype(int)]
        off = fit.residuals[kept]
        limit = max(float(np.percentile(np.abs(off), 98)), 1e-6)
        across, down, labels = _unrolled(fit)
        style = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit, "linewidths": 0, "rasterized": True}
        shades = above.scatter(across[kept], down[kept], c=off, s=max(0.5, 6000 / len(kept)), **style)
        above.set(title=f"{name}: RMS {fit.rms:.3f} mm", xlabel=labels[0], ylabel=labels[1], aspect="equal")
        above.invert_yaxis()
        figure.colorbar(shades, ax=above, label="residual, mm", shrink=0.8)
        below.hist(off, bins=np.linspace(-2 * limit, 2 * limit, 81), color="0.35")
        below.set(xlabel="residual, mm", yticks=[])
        below.set_title(f"{len(fit.kept)} points, {100 * fit.trimmed:.1f} % left out", fontsize="medium")
    if title:
        figure.suptitle(title)
    try:
        figure.savefig(path, dpi=100, format="png")
    except OSError as error:
        raise OutputError(f"picture {path} cannot be written: {error.strerror}") from None


def _unrolled(fit: Fit) -> tuple[Floats, Floats, tuple[str, str]]:
    """Two coordinates of each point on the surface, mm."""
    if isinstance(fit, SphereFit):
        out = fit.points - fit.centre
        scale = fit.radius / np.linalg.norm(out, axis=1)
        return out[:, 0] * scale, out[:, 1] * scale, ("X from the centre, mm", "Y from the centre, mm")
    if isinstance(fit, CylinderFit):
        axis = fit.axis if fit.axis[1] > 0 else -fit.axis
        out = fit.points - fit.point
        front = -fit.point + (fit.point @ axis) * axis
        front = front / np.linalg.norm(front)
        around = np.arctan2(out @ np.cross(front, axis), out @ front)
        return around * fit.radius, out @ axis, ("around, mm", "along the axis, mm")
    return fit.points[:, 0], fit.points[:, 1], ("X, mm", "Y, mm")
