"""A picture of a cloud: a big view at a slant, one from the front, one from above."""

import importlib.util
from pathlib import Path

import numpy as np

from ..arrays import Floats, Records
from ..errors import MagtrakError, OutputError

# So many points fill the picture; more only take time.
MAX_POINTS = 400_000


def require_matplotlib() -> None:
    """:exc:`MagtrakError` where pictures cannot be drawn."""
    if importlib.util.find_spec("matplotlib") is None:
        raise MagtrakError("pictures need matplotlib: pip install 'magtrak[picture]'")


def draw(cloud: Records, path: Path, title: str = "") -> None:
    """Draw points (any structured array with x, y, z in mm, camera frame) into a PNG file.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if len(cloud) > MAX_POINTS:
        cloud = cloud[np.linspace(0, len(cloud) - 1, MAX_POINTS).astype(int)]
    points = np.stack([cloud["x"], cloud["y"], cloud["z"]], axis=-1).astype(np.float64)
    low, high = np.percentile(points[:, 2], [0.5, 99.5])
    style = {"cmap": "viridis_r", "vmin": low, "vmax": high, "linewidths": 0, "rasterized": True}

    figure = Figure(figsize=(16, 8.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.6, 1], height_ratios=[2, 1])
    slant, front, above = (figure.add_subplot(part) for part in (grid[:, 0], grid[0, 1], grid[1, 1]))

    turned = _turn(points, yaw_deg=24, pitch_deg=14)
    order = np.argsort(-turned[:, 2])
    shades = slant.scatter(turned[order, 0], -turned[order, 1], s=1.6, c=points[order, 2], **style)
    slant.set(title=title or f"{len(points)} points, seen from the upper right", aspect="equal")
    slant.axis("off")

    order = np.argsort(-points[:, 2])
    front.scatter(points[order, 0], points[order, 1], s=0.7, c=points[order, 2], **style)
    front.set(title="from the front", xlabel="X, mm", ylabel="Y, mm", aspect="equal")
    front.invert_yaxis()
    above.scatter(points[:, 0], points[:, 2], s=0.5, c=points[:, 2], **style)
    above.set(title="from above", xlabel="X, mm", ylabel="Z, mm", aspect="equal")
    for axes in (front, above):
        axes.grid(True, linewidth=0.4, alpha=0.5)
        axes.set_axisbelow(True)
    figure.colorbar(shades, ax=[front, above], label="depth Z, mm", aspect=50).ax.invert_yaxis()
    try:
        figure.savefig(path, dpi=100, format="png")
    except OSError as error:
        raise OutputError(f"picture {path} cannot be written: {error.strerror}") from None


def _turn(points: Floats, yaw_deg: float, pitch_deg: float) -> Floats:
    """Points as seen by one who has walked round their centre: to the right by yaw and up by pitch."""
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    centre = np.median(points, axis=0)
    return np.asarray((points - centre) @ about_y.T @ about_x.T)
