"""Student's t as a scale mixture of normals: how much a measurement counts that is far off; compiled by numba.

Source: Lange, Little & Taylor, "Robust statistical modeling using the t distribution", JASA 84(408), 1989.
"""

import typing

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
