"""How well standing and moving explain where objects were throughout their windows; compiled by numba, for `parked`."""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def log_likelihoods(sizes, state, covariances, times, slips, sds, place_variance, slip_variance, changing):  # noqa: PLR0913
    """Give the log likelihood of each class for each object (C, K), up to a constant; see `parked.log_likelihoods`.

    Args:
        sizes: frames of each of K objects, two at least.
        state: place and rate at each frame (N, 2, 2).
        covariances: of all of an object's, object by object, flat.
        times: of the frames (N) [s].
        slips: probability that what is seen of each object is off by `slip_variance` (K) [m^2].
        sds: how fast classes of objects are, along each axis (C) [m/s]; the first one stands.
        place_variance: of the ego's own place between two frames [m^2].
        changing: share of what moves that changes its velocity, and standard deviation of the acceleration [m/s^2].
    """
    share, acceleration = changing
    found, whole, half = np.empty((len(sds), len(sizes))), np.empty(3), np.empty(3)
    first = begin = np.int64(0)  # not literals; see window_kernels
    for k in range(len(sizes)):
        n, last = sizes[k], first + sizes[k] - 1
        ago = first + (n - 1) // 2
        _difference(covariances, begin, n, 0, place_variance, whole)
        _difference(covariances, begin, n, ago - first, place_variance, half)
        seconds, short = times[last] - times[first], times[last] - times[ago]
        x, y = state[last, 0, 0] - state[first, 0, 0], state[last, 0, 1] - state[first, 0, 1]
        x_bend = state[last, 0, 0] - state[ago, 0, 0] - short / seconds * x
        y_bend = state[last, 0, 1] - state[ago, 0, 1] - short / seconds * y
        steady = _log_density(x_bend, y_bend, half, 0.0)
        bent = _log_density(x_bend, y_bend, half, (0.5 * acceleration * short * (seconds - short)) ** 2)
        bending = np.logaddexp(np.log(1.0 - share) + steady, np.log(share) + bent)
        for c in range(len(sds)):
            beside = (sds[c] * seconds) ** 2
            surely = np.log(1.0 - slips[k]) + _log_density(x, y, whole, beside)
            off = np.log(slips[k]) + _log_density(x, y, whole, beside + slip_variance)
            found[c, k] = np.logaddexp(surely, off) + (steady if c == 0 else bending)
        first, begin = last + 1, begin + (4 * n) ** 2
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def _difference(covariances, begin, n, i, beside, found):
    """Give the covariance of the last place less that at frame i (xx, xy, yy), of an object of n frames."""
    width, a, b = 4 * n, 4 * i, 4 * (n - 1)
    for m in range(3):
        d, e = m // 2, (m + 1) // 2
        own = covariances[begin + (a + d) * width + a + e] + covariances[begin + (b + d) * width + b + e]
        across = covariances[begin + (a + d) * width + b + e] + covariances[begin + (a + e) * width + b + d]
        found[m] = own - across + (beside if d == e else 0.0)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _log_density(x, y, covariance, beside):
    """Give the logarithm of a normal's density, but for a constant, with a variance beside its covariance."""
    a, b, c = covariance[0] + beside, covariance[1], covariance[2] + beside
    determinant = a * c - b * b
    return -0.5 * (np.log(determinant) + (c * x * x - 2.0 * b * x * y + a * y * y) / determinant)
