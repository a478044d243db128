"""Student's t as a scale mixture of normals: how much a measurement counts that is far off; compiled by numba.

Source: Lange, Little & Taylor, "Robust statistical modeling using the t distribution", JASA 84(408), 1989.
"""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def weight(tail, dimension, distance):
    """Weigh a squared Mahalanobis distance by Student's t; what is nearer than expected counts no more for it.

    Args:
        tail: degrees of freedom; 0: normal.
        dimension: of what was measured.
        distance: squared.
    """
    return min((tail + dimension) / (tail + distance), 1.0) if tail > 0.0 else 1.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def cost(tail, dimension, distance):
    """Give the negative logarithm of the likelihood that `weight` leads down, but for a constant."""
    if tail <= 0.0 or distance <= dimension:
        return 0.5 * distance
    return 0.5 * (dimension + (tail + dimension) * np.log((tail + distance) / (tail + dimension)))


@njit(cache=True, nogil=True)
@typing.no_type_check
def log_density(tail, dimension, distance):
    """Give the logarithm of the density of Student's t against its own centre's."""
    return -0.5 * (tail + dimension) * np.log1p(distance / tail) if tail > 0.0 else -0.5 * distance
