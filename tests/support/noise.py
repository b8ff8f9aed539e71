"""How noisy the columns of a scan are, told by the cloud alone."""

import numpy as np


def column_noise_px(cloud: np.ndarray) -> float:
    """From second differences down the line, which is smooth: they have six times the variance of a column."""
    parts = []
    for frame in np.unique(cloud["scalar_frame"]):
        mine = cloud[cloud["scalar_frame"] == frame]
        column = np.full(mine["scalar_row"].max() + 3, np.nan)
        column[mine["scalar_row"]] = mine["scalar_column"]
        parts.append(np.diff(column, 2))
    bend = np.concatenate(parts)
    bend = bend[np.isfinite(bend)]
    return float(1.4826 * np.median(np.abs(bend)) / np.sqrt(6))
