"""A segment's points in the frame of its velocities, their mean and their middle, in one compiled loop."""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def place(points, T, height):
    """Move points into a frame, with heights above some other one.

    Args:
        points: (n, 3), one at least [m].
        T: transform (4, 4) into the frame.
        height: that is subtracted [m].

    Returns:
        the points there (n, 3), their mean, and the middle of their bounding box.
    """
    found, mean, middle = np.empty(points.shape), np.empty(3), np.empty(3)
    for axis in range(3):
        a, b, c, d = T[axis, 0], T[axis, 1], T[axis, 2], T[axis, 3] - (height if axis == 2 else 0.0)  # noqa: PLR2004
        total, low, high = 0.0, np.inf, -np.inf
        for i in range(len(points)):
            value = a * points[i, 0] + b * points[i, 1] + c * points[i, 2] + d
            found[i, axis] = value
            low, high = min(low, value), max(high, value)
        for i in range(len(points)):
            total += found[i, axis] - low  # sums of small numbers keep their digits
        mean[axis], middle[axis] = low + total / len(points), 0.5 * (low + high)
    return found, mean, middle
