"""Which objects of a frame stand, by trying what any two of them would have in common; compiled by numba.

As in `window_kernels`, loops hand arrays on whole, with the row that is meant.
"""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def standing(places, measured, told, order, before, unknown, variances, wrong, n_refinements):
    """Find the motion u + w x p that most objects agree with, and say with which probability each stands.

    Source: RANSAC (Fischler & Bolles, Comm. ACM 24(6), 1981) over all pairs, then expectation maximisation.

    Args:
        places: of K objects (K, 2) [m].
        measured: their velocities (K, 2) [m/s], and covariances of these (K, 2, 2).
        told: what each tells of (u, w) if it stands: information (K, 3, 3), and that times (u, w) (K, 3).
        order: objects whose pairs are tried.
        before, unknown: (u, w) as it was before, and as nothing is known of it: mean (3), information (3, 3), logarithm
            of its determinant.
        variances: of speeds along each axis (C) [m^2/s^2]; the first: of what stands.
        wrong: probability that (u, w) is not as before.
        n_refinements: of the best.

    Returns:
        probabilities (K), and whether (u, w) is as before.
    """
    (velocities, covariances), (A, a) = measured, told
    forms, logs = _forms(covariances, variances), np.empty(len(variances))
    rest, unlike = (before[1], before[1] @ before[0]), (unknown[1], unknown[1] @ unknown[0])
    motion, best = before[0].copy(), before[0].copy()
    highest, is_before = _score(places, velocities, forms, motion, before, unknown, wrong, logs)
    for p in range(len(order)):
        for q in range(p + 1, len(order)):
            for known in (rest, unlike):
                _solve(known[0], known[1], A, a, order[p], order[q], motion)
                score, is_like = _score(places, velocities, forms, motion, before, unknown, wrong, logs)
                if score > highest:
                    highest, is_before, best[:] = score, is_like, motion
    shares, start = np.zeros(len(places)), rest if is_before else unlike
    for _ in range(n_refinements):
        information, pulled = start[0].copy(), start[1].copy()
        for k in range(len(places)):
            whole = _weigh(places, velocities, forms, k, best, logs)
            shares[k] = np.exp(logs[0] - whole)
            information += shares[k] * A[k]
            pulled += shares[k] * a[k]
        best[:] = np.linalg.solve(information, pulled)
    return shares, is_before


@njit(cache=True, nogil=True)
@typing.no_type_check
def _forms(covariances, variances):
    """Give the inverse of each covariance with each variance beside it (xx, xy, yy), and minus half the logarithm of
    its determinant (K, C, 4).
    """
    forms = np.empty((len(covariances), len(variances), 4))
    for k in range(len(covariances)):
        for c in range(len(variances)):
            p, q, r = covariances[k, 0, 0] + variances[c], covariances[k, 0, 1], covariances[k, 1, 1] + variances[c]
            determinant = p * r - q * q
            forms[k, c, 0], forms[k, c, 1], forms[k, c, 2] = r / determinant, -q / determinant, p / determinant
            forms[k, c, 3] = -0.5 * np.log(determinant)
    return forms


@njit(cache=True, nogil=True)
@typing.no_type_check
def _solve(information, pulled, A, a, i, j, motion):
    """Put in place what objects i and j would have in common, beside what is known; by Cramer's rule."""
    b, c = information[0, 0] + A[i, 0, 0] + A[j, 0, 0], information[0, 1] + A[i, 0, 1] + A[j, 0, 1]
    d, e = information[0, 2] + A[i, 0, 2] + A[j, 0, 2], information[1, 1] + A[i, 1, 1] + A[j, 1, 1]
    f, g = information[1, 2] + A[i, 1, 2] + A[j, 1, 2], information[2, 2] + A[i, 2, 2] + A[j, 2, 2]
    x, y, z = pulled[0] + a[i, 0] + a[j, 0], pulled[1] + a[i, 1] + a[j, 1], pulled[2] + a[i, 2] + a[j, 2]
    p, q, r = e * g - f * f, d * f - c * g, c * f - d * e
    determinant = b * p + c * q + d * r
    motion[0] = (p * x + q * y + r * z) / determinant
    motion[1] = (q * x + (b * g - d * d) * y + (c * d - b * f) * z) / determinant
    motion[2] = (r * x + (c * d - b * f) * y + (b * e - c * c) * z) / determinant


@njit(cache=True, nogil=True)
@typing.no_type_check
def _score(places, velocities, forms, motion, before, unknown, wrong, logs):
    """Give how well a motion explains all velocities, and whether it is as before."""
    as_before = np.log(1.0 - wrong) + _log_density(before[0], before[1], before[2], motion)
    another = np.log(wrong) + _log_density(unknown[0], unknown[1], unknown[2], motion)
    score = max(as_before, another)
    for k in range(len(places)):
        score += _weigh(places, velocities, forms, k, motion, logs)
    return score, as_before > another


@njit(cache=True, nogil=True)
@typing.no_type_check
def _log_density(mean, information, volume, motion):
    distance = 0.0
    for p in range(3):
        for q in range(3):
            distance += (motion[p] - mean[p]) * information[p, q] * (motion[q] - mean[q])
    return 0.5 * (volume - distance)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _weigh(places, velocities, forms, k, motion, logs):
    """Fill in the log density of velocity k for each speed, and give the logarithm of their sum."""
    x = velocities[k, 0] - motion[0] + motion[2] * places[k, 1]
    y = velocities[k, 1] - motion[1] - motion[2] * places[k, 0]
    highest, total = -np.inf, 0.0
    for c in range(len(logs)):
        form = forms[k, c, 0] * x * x + 2.0 * forms[k, c, 1] * x * y + forms[k, c, 2] * y * y
        logs[c] = forms[k, c, 3] - 0.5 * form
        highest = max(highest, logs[c])
    for c in range(len(logs)):
        total += np.exp(logs[c] - highest)
    return highest + np.log(total)
