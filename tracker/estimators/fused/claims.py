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
def believe(informations, doubts, c, scale, D, found):
    """Give the information of a comparison: its covariance is `scale` times what it claims, and its doubt beside that.

    Args:
        informations: inverse covariances that comparisons claim (M, D, D); singular where a direction was not measured.
        doubts: covariances that do not depend on how well comparisons agree (M, D, D).
        c: which comparison.
        scale: of the claims.
        D: 1 or 2.
        found: its information (D, D), filled in.

    Returns:
        the share of its own errors in all of them, a mean over directions: how much it tells of the scale; nothing
        where nothing was measured.
    """
    if D == 1:
        own = informations[c, 0, 0] / scale
        whole = 1.0 + doubts[c, 0, 0] * own
        found[0, 0] = own / whole
        return 1.0 / whole if own > 0.0 else 0.0
    a, b, d = informations[c, 0, 0] / scale, informations[c, 0, 1] / scale, informations[c, 1, 1] / scale
    p, q, r = doubts[c, 0, 0], doubts[c, 0, 1], doubts[c, 1, 1]
    determinant, both = a * d - b * b, a * p + 2.0 * b * q + d * r
    # (L^-1 + V)^-1 = (L + |L| adj V) / |1 + L V|, and |1 + L V| = 1 + tr L V + |L| |V|
    whole = 1.0 + both + determinant * (p * r - q * q)
    found[0, 0], found[1, 1] = (a + determinant * r) / whole, (d + determinant * p) / whole
    found[0, 1] = found[1, 0] = (b - determinant * q) / whole
    return (1.0 + 0.5 * both) / whole if a + d > 0.0 else 0.0


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
