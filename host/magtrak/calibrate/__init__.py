"""Calibration: from pictures of a board and laser lines on it to a calibration file with a sigma for every number.

Needs OpenCV and SciPy, the extra ``calib``; both are imported when used.
"""

from ..errors import CalibrationError


def require() -> None:
    """Say in one sentence what is missing.

    Raises
    ------
    CalibrationError
        OpenCV or SciPy is not installed.
    """
    try:
        import cv2  # noqa: F401
        import scipy  # noqa: F401
    except ModuleNotFoundError as error:
        raise CalibrationError(
            f"calibration needs the package {error.name}, which is not installed: pip install 'magtrak[calib]'"
        ) from None
