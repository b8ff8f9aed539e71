"""Where the light of a scan came from, told by the cloud alone.

All points of one angle lie in one plane, and the planes turn about an axis: ``n(alpha) . P = d(alpha)`` with

    n = cos(alpha) A + sin(alpha) B + C,    d = cos(alpha) E + sin(alpha) F + D

is linear in its twelve numbers, which points at several depths determine but for a factor. A and B are as long as each
other and across each other; the axis is across both, and its points have A . o = E, B . o = F.
"""

import numpy as np

from ..arrays import Floats, Records

MANY = 5000
"""Points that are used, spread over the cloud."""

METRE = 1000.0
ALIKE = 0.02
"""Part by which A and B may differ in length, and cosine between them, for planes that turn about an axis."""

CLEAR = 30.0
"""So many times better than the next best has a solution to be; a single wall has four that are as good."""


def light_source(cloud: Records) -> Floats | None:
    """(3,) point of the laser's axis that is nearest to the camera, in its frame, mm.

    None where the cloud does not tell: it has no angles, it is a single wall, or its light was no turning plane (under
    water). A point of the cloud has been put into its plane by calculation, so noise does no harm.
    """
    names = cloud.dtype.names or ()
    if "scalar_angle" not in names or len(cloud) < MANY // 10:
        return None
    some = cloud[:: max(len(cloud) // MANY, 1)]
    points = np.stack([some[axis] for axis in "xyz"], axis=-1).astype(np.float64) / METRE
    cosine, sine = (wave(some["scalar_angle"].astype(np.float64))[:, None] for wave in (np.cos, np.sin))
    one = np.ones_like(cosine)
    rows = np.concatenate([cosine * points, sine * points, points, -cosine, -sine, -one], axis=1)
    _, values, vectors = np.linalg.svd(rows, full_matrices=False)
    if values[-2] < CLEAR * values[-1]:
        return None
    a, b, (e, f) = vectors[-1][:3], vectors[-1][3:6], vectors[-1][9:11]
    length, other = np.linalg.norm(a), np.linalg.norm(b)
    if not (abs(length - other) < ALIKE * length and abs(a @ b) < ALIKE * length * other):
        return None
    axis = np.cross(a, b)
    # The axis' point nearest to the camera: no part along the axis.
    return np.asarray(METRE * np.linalg.solve(np.stack([a, b, axis]), [e, f, 0.0]))
