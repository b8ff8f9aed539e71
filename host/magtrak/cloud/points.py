"""What a point of a cloud is."""

import numpy as np

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("quality", "<f4"),
        ("scalar_frame", "<i4"),
        ("scalar_row", "<i4"),
        ("scalar_column", "<f4"),
        ("scalar_angle", "<f4"),
        ("scalar_width", "<f4"),
        ("scalar_time", "<f8"),
    ]
)
"""A point as it stands in a PLY file.

Members
-------
x, y, z : camera frame, mm
intensity : the weight's peak, 0 to 1
quality : see :func:`magtrak.triangulate.quality`
scalar_frame : the first received is 0, lost ones leave a gap
scalar_row, scalar_column : px, distorted picture
scalar_angle : rad, the alpha used for the point
scalar_width : columns of the run, px
scalar_time : arrival of the row, s since that of the first frame's first row
"""
