"""What a calibration says of itself: as text, and as a picture of coverage and residuals."""

from pathlib import Path

import numpy as np

from ..arrays import Floats
from ..calibration import Calibration
from ..cloud.picture import require_matplotlib
from ..errors import OutputError
from ..ports import Ports
from .procedure import Result, cells

WORST = 3


def describe(calibration: Calibration) -> str:
    """What a file holds, sigmas where it has them."""
    camera, laser = calibration.camera, calibration.laser
    sigmas = calibration.extra.get("sigmas", {})
    of_camera, of_laser = sigmas.get("camera", {}), sigmas.get("laser", {})
    lines = [f"camera    {camera.model}, {camera.width} x {camera.height} px"]
    if camera.model == "projection":
        lines += ["  " + "  ".join(f"{value:12.5g}" for value in row) for row in camera.matrix]
    else:
        k = camera.matrix
        for name, value in (("fx", k[0, 0]), ("fy", k[1, 1]), ("cx", k[0, 2]), ("cy", k[1, 2])):
            lines.append(_line(name, value, of_camera.get(name), "px", 3))
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=False):
            lines.append(_line(name, float(value), of_camera.get(name), "", 5))
    lines.append(_line("time offset", 1e3 * camera.time_offset_s, _times(sigmas.get("time_offset_s"), 1e3), "ms", 3))
    x, _, z = laser.camera_from_laser[:3, :3].T
    at = laser.camera_from_laser[:3, 3]
    lines.append("laser")
    lines.append(
        f"  axis passes  ({at[0]:.2f}, {at[1]:.2f}, {at[2]:.2f}) mm, along ({z[0]:.5f}, {z[1]:.5f}, {z[2]:.5f})"
    )
    lines.append(f"  X_L along    ({x[0]:.5f}, {x[1]:.5f}, {x[2]:.5f}) at alpha = 0")
    if of_laser:
        lines.append(
            f"  1 sigma      {of_laser['shift_x_mm']:.3f} mm along X_L, {of_laser['shift_y_mm']:.3f} mm along Y_L,"
            f" {_degrees(of_laser['axis_x_rad']):.4f} and {_degrees(of_laser['axis_y_rad']):.4f} degrees"
        )
    lines.append(_line("offset", laser.offset_mm, of_laser.get("offset_mm"), "mm", 3))
    lines.append(_line("tilt", _degrees(laser.tilt_rad), _times(of_laser.get("tilt_rad"), 180 / np.pi), "degrees", 4))
    lines.append(_line("zero", _degrees(laser.zero_rad), _times(of_laser.get("zero_rad"), 180 / np.pi), "degrees", 4))
    lines.append(f"  sense        {laser.sense:+d}, {laser.counts_per_turn} counts per turn")
    if len(laser.error_table):
        most = np.abs(laser.error_table).max()
        lines.append(f"  error table  {len(laser.error_table)} lines, up to {most:.2f} counts")
    if calibration.ports is not None:
        lines += _ports(calibration.ports, sigmas.get("ports", {}))
    residuals = calibration.extra.get("residuals", {})
    if residuals:
        text = f"noise     corners {residuals['corner_px']:.3f} px in {residuals['views']} views"
        if "line_px" in residuals:
            text += (
                f", rows {residuals['line_px']:.3f} px, angles {residuals['angle_counts']:.4f} counts"
                f" in {residuals['images']} images"
            )
        lines.append(text)
    if calibration.extra.get("expected"):
        lines.append("expected of a plane that faces the camera (95 %)")
        for item in calibration.extra["expected"]:
            lines.append(
                f"  at {item['distance_mm'] / 1000:3.1f} m     form {item['form_mm']:.2f} mm RMS, place"
                f" {item['place_mm']:.2f} mm, scale {100 * item['scale']:.3f} %"
            )
    if calibration.extra.get("date"):
        lines.append(f"made      {calibration.extra['date']}")
    return "\n".join(lines)


def _ports(ports: Ports, sigmas: dict[str, float]) -> list[str]:
    """Distances and what a rule cannot tell, with sigmas; the glass stays as it was given."""
    lines = ["ports"]
    for name, port in (("camera", ports.camera), ("laser", ports.laser)):
        x, y, z = port.normal
        lines.append(_line(f"{name}'s", port.distance_mm, sigmas.get(f"{name}.distance_mm"), "mm", 2))
        leans = [sigmas[f"{name}.lean_{axis}_rad"] for axis in (1, 2) if f"{name}.lean_{axis}_rad" in sigmas]
        text = f"    normal     ({x:.4f}, {y:.4f}, {z:.4f})"
        lines.append(text + (f" +- {_degrees(max(leans)):.3f} degrees" if leans else ""))
    lines.append(_line("fan along X_L", ports.apex_beam_mm, sigmas.get("laser.apex_beam_mm"), "mm", 2))
    lines.append(_line("fan along Z_L", ports.apex_axis_mm, sigmas.get("laser.apex_axis_mm"), "mm", 2))
    lines.append(_line("water index", ports.water_index, sigmas.get("water_index"), "", 5))
    return lines


def views_text(result: Result) -> str:
    """Coverage in cells of the picture, and the views that fit worst."""
    count = cells(result.seen)
    lines = ["corners in each part of the picture"]
    lines += ["  " + " ".join(f"{int(value):4d}" for value in row) for row in count]
    rms = view_rms(result)
    order = np.argsort(-rms)[:WORST]
    worst = ", ".join(f"{result.seen.views[int(number)].name} {rms[number]:.3f} px" for number in order)
    lines.append(f"views     {len(rms)}; RMS {np.median(rms):.3f} px (median); worst {worst}")
    return "\n".join(lines)


def view_rms(result: Result) -> Floats:
    """(V,) RMS of the corners of each view, px."""
    views = len(result.seen.views)
    owner = np.repeat(np.arange(views), [len(view.ids) for view in result.seen.views])
    square = np.bincount(owner, np.sum(result.solution.corners**2, axis=1) / 2, views)
    return np.asarray(np.sqrt(square / np.maximum(np.bincount(owner, minlength=views), 1)))


def draw(result: Result, path: Path) -> None:
    """Corners and lines where they were seen with their residuals, and the error of each view, as a PNG file.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    seen, found = result.seen, result.solution
    figure = Figure(figsize=(15, 7.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
    corners = np.concatenate([view.corners for view in seen.views])
    usual = max(found.noise.corner, 1e-6)
    arrows = left.quiver(
        *corners.T, *found.corners.T, np.hypot(*found.corners.T), angles="xy", cmap="viridis", clim=(0, 4 * usual),
        scale_units="xy", scale=usual / 8, width=0.0018,
    )  # fmt: skip
    figure.colorbar(arrows, ax=left, label="residual of a corner, px", shrink=0.8)
    rows = np.concatenate([view.lines.row for view in seen.views])
    if len(rows):
        columns = np.concatenate([view.lines.column for view in seen.views])
        left.scatter(columns, rows, s=2, color="tab:green", label="rows of laser lines")
        left.legend(loc="upper right")
    left.set(xlim=(0, seen.width - 1), ylim=(seen.height - 1, 0), aspect="equal", xlabel="column, px", ylabel="row, px")
    left.set_title(f"{len(corners)} corners in {len(seen.views)} views; an arrow of 8 px is {usual:.3f} px")
    rms = view_rms(result)
    names = [Path(view.name).name for view in seen.views]
    right.barh(np.arange(len(rms)), rms, color="tab:blue")
    right.set_yticks(np.arange(len(rms)), names, fontsize=7)
    right.invert_yaxis()
    right.set(xlabel="RMS of a view's corners, px", title="views")
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from None


def _line(name: str, value: float, sigma: float | None, unit: str, digits: int) -> str:
    text = f"  {name:12} {value:.{digits}f}"
    if sigma:
        text += f" +- {sigma:.{digits}f}" if sigma >= 10**-digits else f" +- {sigma:.1g}"
    elif sigma == 0:
        text += " (held)"
    return f"{text} {unit}".rstrip()


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _degrees(value: float) -> float:
    return float(np.degrees(value))
