"""How large the errors of an object's comparisons are, against what they claim; compiled by numba.

A window has far more comparisons than unknowns, so that how well they agree tells how large their errors are.

Source: the variance of unit weight of least squares, here of Student's t (Lange, Little & Taylor, 1989; see
`heavy_tails`), with the claims themselves as so many comparisons more.
"""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def believed(own, doubt, scale, D):
    """Give the information of a comparison: its covariance is `scale` times what it claims, and `doubt` beside that.

    Args:
        own: inverse covariance that it claims (D, D); singular where a direction was not measured.
        doubt: covariance that does not depend on how well comparisons agree (D, D).
        scale: of the claims.
        D: 1 or 2.

    Returns:
        information (D, D), and the share of its own errors in all of them, a mean over directions: how much it tells
        of the scale; nothing where nothing was measured.
    """
    found = np.zeros((D, D))
    if D == 1:
        whole = 1.0 + doubt[0, 0] * own[0, 0] / scale
        found[0, 0] = own[0, 0] / scale / whole
        return found, 1.0 / whole if own[0, 0] > 0.0 else 0.0
    a, b, c = own[0, 0] / scale, own[0, 1] / scale, own[1, 1] / scale
    p, q, r = doubt[0, 0], doubt[0, 1], doubt[1, 1]
    determinant, both = a * c - b * b, a * p + 2.0 * b * q + c * r
    # (L^-1 + V)^-1 = (L + |L| adj V) / |1 + L V|, and |1 + L V| = 1 + tr L V + |L| |V|
    whole = 1.0 + both + determinant * (p * r - q * q)
    found[0, 0], found[1, 1] = (a + determinant * r) / whole, (c + determinant * p) / whole
    found[0, 1] = found[1, 0] = (b - determinant * q) / whole
    return found, (1.0 + 0.5 * both) / whole if a + c > 0.0 else 0.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def scale(claimed, misfit, n_told):
    """Give by how much variances are larger than claimed.

    Comparisons of a look share errors, so each counts for one of its two numbers.

    Args:
        claimed: how many comparisons the claims count for; infinite: claims hold.
        misfit: weighed squared distances of comparisons and motion from what is found.
        n_told: comparisons that tell of it.
    """
    return (claimed + misfit) / (claimed + n_told) if np.isfinite(claimed) else 1.0
