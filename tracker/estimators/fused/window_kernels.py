"""Least squares over a window of frames with heavy-tailed errors, compiled by numba; the work behind `window`.

A frame's unknowns are, D numbers each: place, rate, and the offset by which what was seen of the object is off.
Comparisons of two frames measure the difference of place plus offset.  Source: Student's t as a scale mixture of
normals, Lange, Little & Taylor, "Robust statistical modeling using the t distribution", JASA 84(408), 1989.
"""

import typing

import numpy as np
from numba import njit

MOST_ITERATIONS = 6
SETTLED = 1e-4  # largest change of a number that ends the iterations [m, m/s, rad, rad/s]
ANCHOR = 1e6  # information of the first place, which only fixes where zero is [1/m^2, 1/rad^2]


@njit(cache=True, nogil=True)
@typing.no_type_check
def solve(times, start, density, shakes, offset_sds, tails, rate_mean, rate_information, ends, steps, informations):
    """Find the most likely unknowns of all frames, and their joint covariance.

    Args:
        times: of the n frames [s].
        start: unknowns to start from (n, 3, D).
        density: spectral density of the acceleration's white noise [m^2/s^3, rad^2/s^3].
        shakes: covariance that each frame's place has beside that (n, D, D); the first is not used.
        offset_sds: standard deviation of each frame's offset (n).
        tails: degrees of freedom of the errors of comparisons, of offsets, and of the motion; 0: normal.
        rate_mean, rate_information: what is known of the first frame's rate (D), (D, D).
        ends: older and newer frame of each comparison (m, 2).
        steps: its measured difference (m, D).
        informations: inverse covariance of that (m, D, D).

    Returns:
        the unknowns (n, 3, D), and their covariance (3 n D, 3 n D), frame by frame.
    """
    n, D = len(times), start.shape[2]
    fixed, known = _beginning(start, rate_mean, rate_information, n, D)
    motions = np.zeros((n, 4 * D, 4 * D))
    for i in range(n - 1):
        motions[i] = _motion(times[i + 1] - times[i], density, shakes[i + 1], D)
    x = start.copy().reshape(3 * n * D)
    H = fixed
    for _ in range(MOST_ITERATIONS):
        H, b = fixed.copy(), known.copy()
        for i in range(n - 1):
            _add_motion(H, x, i, motions[i], tails[2], D)
        for i in range(n):
            _add_offset(H, x, i, offset_sds[i], tails[1], D)
        for k in range(len(ends)):
            _add_comparison(H, b, x, ends[k], steps[k], informations[k], tails[0], D)
        found = np.linalg.solve(H, b)
        change = np.abs(found - x).max()
        x = found
        if change < SETTLED:
            break
    return x.reshape(n, 3, D), np.linalg.inv(H)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _beginning(start, rate_mean, rate_information, n, D):
    """Give information matrix and vector of what is known of the first frame."""
    H, b = np.zeros((3 * n * D, 3 * n * D)), np.zeros(3 * n * D)
    for d in range(D):
        H[d, d] = ANCHOR
        b[d] = ANCHOR * start[0, 0, d]
        for e in range(D):
            H[D + d, D + e] = rate_information[d, e]
            b[D + d] += rate_information[d, e] * rate_mean[e]
    return H, b


@njit(cache=True, nogil=True)
@typing.no_type_check
def _motion(dt, density, shake, D):
    """Give the information of one step of a motion of nearly constant rate over (place, rate) at both its ends."""
    Q = np.zeros((2 * D, 2 * D))
    Q[:D, :D] = shake
    J = np.zeros((2 * D, 4 * D))
    for d in range(D):
        Q[d, d] += density * dt**3 / 3.0
        Q[d, D + d] = Q[D + d, d] = density * dt**2 / 2.0
        Q[D + d, D + d] = density * dt
        J[d, D + d] = -dt
    for d in range(2 * D):
        J[d, d], J[d, 2 * D + d] = -1.0, 1.0
    return J.T @ np.linalg.inv(Q) @ J


@njit(cache=True, nogil=True)
@typing.no_type_check
def _weight(tail, dimension, distance):
    """Weigh a squared Mahalanobis distance by Student's t; what is nearer than expected counts no more for it."""
    return min((tail + dimension) / (tail + distance), 1.0) if tail > 0.0 else 1.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def _place(a, i, D):
    """Say where the a-th of (place, rate) of frame i and (place, rate) of frame i + 1 stands."""
    return 3 * D * i + a if a < 2 * D else 3 * D * (i + 1) + a - 2 * D


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_motion(H, x, i, motion, tail, D):
    u = np.empty(4 * D)
    for a in range(4 * D):
        u[a] = x[_place(a, i, D)]
    weight = _weight(tail, 2 * D, u @ motion @ u)
    for a in range(4 * D):
        for c in range(4 * D):
            H[_place(a, i, D), _place(c, i, D)] += weight * motion[a, c]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_offset(H, x, i, sd, tail, D):
    first, distance = 3 * D * i + 2 * D, 0.0
    for d in range(D):
        distance += (x[first + d] / sd) ** 2
    weight = _weight(tail, D, distance)
    for d in range(D):
        H[first + d, first + d] += weight / sd**2


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_comparison(H, b, x, ends, step, information, tail, D):
    older, newer, off = 3 * D * ends[0], 3 * D * ends[1], np.empty(D)
    for d in range(D):
        off[d] = x[newer + d] + x[newer + 2 * D + d] - x[older + d] - x[older + 2 * D + d] - step[d]
    weight = _weight(tail, D, off @ information @ off)
    for d in range(D):
        pull = 0.0
        for e in range(D):
            share = weight * information[d, e]
            pull += share * step[e]
            for p in range(0, 3 * D, 2 * D):  # place and offset
                for q in range(0, 3 * D, 2 * D):
                    H[newer + p + d, newer + q + e] += share
                    H[older + p + d, older + q + e] += share
                    H[newer + p + d, older + q + e] -= share
                    H[older + p + d, newer + q + e] -= share
        for p in range(0, 3 * D, 2 * D):
            b[newer + p + d] += pull
            b[older + p + d] -= pull
