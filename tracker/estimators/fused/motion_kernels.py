"""A motion of nearly constant rate: what it says of neighbouring frames, and how it goes on; compiled by numba.

A frame's unknowns are, D numbers each: place, rate; see `window_kernels`.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import heavy_tails


@njit(cache=True, nogil=True)
@typing.no_type_check
def information(dt, density, shake, D):
    """Give the information of one step of a motion of nearly constant rate over (place, rate) at both its ends.

    The rate changes by a white noise, and, independent of that, the place by `density` dt^3 / 12, and the shake, beside
    the mean of both rates.
    """
    open_ = shake.copy()
    for d in range(D):
        open_[d, d] += density * dt**3 / 12.0
    told = inverse(open_, D)
    place, rate = (-1.0, -0.5 * dt, 1.0, -0.5 * dt), (0.0, -1.0, 0.0, 1.0)
    found = np.zeros((4 * D, 4 * D))
    for p in range(4):
        for q in range(4):
            for d in range(D):
                found[p * D + d, q * D + d] = rate[p] * rate[q] / (density * dt)
                for e in range(D):
                    found[p * D + d, q * D + e] += place[p] * place[q] * told[d, e]
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def inverse(A, D):
    """Invert a symmetric matrix (D, D), of one row or two."""
    found = np.empty((D, D))
    if D == 1:
        found[0, 0] = 1.0 / A[0, 0]
    else:
        determinant = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        found[0, 0], found[1, 1] = A[1, 1] / determinant, A[0, 0] / determinant
        found[0, 1] = found[1, 0] = -A[0, 1] / determinant
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def rotate(angle, rotations, k):
    """Fill in rotation k, counter-clockwise by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    rotations[k, 0, 0], rotations[k, 0, 1], rotations[k, 1, 0], rotations[k, 1, 1] = c, -s, s, c


@njit(inline="always")
@typing.no_type_check
def advance(state, covariance, r, m, dt, rotations, k, density, shakes):
    """Add frame m to a window of m frames, where the motion would lead, in place.

    Args:
        state: see `rows.Frames` (C, n, 2, D).
        covariance: of all of it (C, 2 n D, 2 n D).
        r: which window.
        m: how many frames it has.
        dt: [s].
        rotations, k: the one that is meant turns the last frame's axes to the new one's (K, D, D).
        density: of the acceleration's noise.
        shakes: covariance that the new place has beside that (K, D, D).
    """
    D = state.shape[3]
    last, new = 2 * D * (m - 1), 2 * D * m
    for d in range(D):
        state[r, m, 0, d] = state[r, m, 1, d] = 0.0
        for e in range(D):
            turned, rate = rotations[k, d, e], state[r, m - 1, 1, e]
            state[r, m, 0, d] += turned * (state[r, m - 1, 0, e] + dt * rate)
            state[r, m, 1, d] += turned * rate
    for q in range(new):
        for d in range(D):
            place = rate = 0.0
            for e in range(D):
                turned, own = rotations[k, d, e], covariance[r, last + D + e, q]
                place += turned * (covariance[r, last + e, q] + dt * own)
                rate += turned * own
            covariance[r, new + d, q] = covariance[r, q, new + d] = place
            covariance[r, new + D + d, q] = covariance[r, q, new + D + d] = rate
    _add_own(covariance, r, last, new, dt, rotations, k, density, shakes)


@njit(inline="always")
@typing.no_type_check
def _add_own(covariance, r, last, new, dt, rotations, k, density, shakes):
    """Fill in the covariance of a new frame's own place and rate, from how both depend on the last frame's."""
    D = (new - last) // 2
    for p in range(new, new + 2 * D):
        for d in range(D):
            place = rate = 0.0
            for e in range(D):
                turned, own = rotations[k, d, e], covariance[r, p, last + D + e]
                place += turned * (covariance[r, p, last + e] + dt * own)
                rate += turned * own
            covariance[r, p, new + d], covariance[r, p, new + D + d] = place, rate
    for d in range(D):
        covariance[r, new + d, new + d] += density * dt**3 / 3.0
        covariance[r, new + D + d, new + D + d] += density * dt
        covariance[r, new + d, new + D + d] += density * dt**2 / 2.0
        covariance[r, new + D + d, new + d] += density * dt**2 / 2.0
        for e in range(D):
            covariance[r, new + d, new + e] += shakes[k, d, e]


@njit(cache=True, nogil=True)
@typing.no_type_check
def steps(frames, at, tells, density, tail):
    """Give how far K objects moved from frame to frame, N steps in all, without what only their frames' axes shook.

    Between two rates, a motion of nearly constant rate leaves a displacement as open as `density` dt^3 / 12 about their
    mean, and more where it changes suddenly (a crash is no error of a pose); what the places differ from that is the
    motion's share, and the shake's.  Axes shake or turn, not both: then the shake is 0, and a step a difference.

    Args:
        frames: see `rows.Frames`.
        at: which windows (K).
        tells: whether the places at both ends tell of each step's velocity (N), as where some time lies between the
            looks; else the rates alone do.
        density: of the acceleration's noise.
        tail: degrees of freedom of the motion's errors.

    Returns:
        displacements (N, D), and two parts of their covariances (N, D, D): what is open since places and rates are, and
        since axes shake.
    """
    D = frames.state.shape[3]
    found, known, shaken = np.empty((len(tells), D)), np.empty((len(tells), D, D)), np.empty((len(tells), D, D))
    J, across = np.zeros((D, 4 * D)), np.empty((D, 4 * D))
    i = np.int64(0)  # not a literal; see window_kernels
    for k in range(len(at)):
        r = at[k]
        for j in range(frames.sizes[r] - 1):
            dt = frames.times[r, j + 1] - frames.times[r, j]
            told = inverse_beside(frames.shakes, r, j + 1, density * dt**3 / 12.0, D)
            surprise = _surprise(frames.state, r, j, dt, told, density)
            own = density * dt**3 / 12.0 / heavy_tails.weight(tail, 2 * D, surprise)
            told = inverse_beside(frames.shakes, r, j + 1, own, D)
            for d in range(D):
                for e in range(D):
                    one, shake = (1.0 if d == e else 0.0), 0.0
                    for p in range(D):  # the share of the shake: all, where places do not tell of a velocity
                        shake += frames.shakes[r, j + 1, d, p] * told[p, e]
                    shake = shake if tells[i] else one
                    J[d, e], J[d, 2 * D + e] = shake - one, one - shake
                    J[d, D + e] = J[d, 3 * D + e] = 0.5 * dt * shake
                    shaken[i, d, e] = shake * own
            _across(J, frames.state, frames.covariance, r, j, across, found, known, i)
            i += 1
    return found, known, shaken


@njit(cache=True, nogil=True)
@typing.no_type_check
def inverse_beside(shakes, r, j, variance, D):
    """Invert what shakes frame j of a window, and a variance along each axis beside that."""
    open_ = np.empty((D, D))
    for d in range(D):
        for e in range(D):
            open_[d, e] = shakes[r, j, d, e] + (variance if d == e else 0.0)
    return inverse(open_, D)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _surprise(state, r, j, dt, told, density):
    """Give how far a step is off a motion of nearly constant rate: a squared distance; see `information`."""
    D, found = len(told), 0.0
    for d in range(D):
        change = state[r, j + 1, 1, d] - state[r, j, 1, d]
        found += change**2 / (density * dt)
        for e in range(D):
            p = state[r, j + 1, 0, d] - state[r, j, 0, d] - 0.5 * dt * (state[r, j + 1, 1, d] + state[r, j, 1, d])
            q = state[r, j + 1, 0, e] - state[r, j, 0, e] - 0.5 * dt * (state[r, j + 1, 1, e] + state[r, j, 1, e])
            found += p * told[d, e] * q
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def _across(J, state, covariance, r, j, across, found, known, i):
    """Fill in a linear function of the unknowns of two neighbouring frames, and its covariance: J x and J P J^T."""
    (D, width), first = J.shape, J.shape[1] // 2 * j
    for d in range(D):
        found[i, d] = 0.0
        for p in range(width):
            found[i, d] += J[d, p] * state[r, j + p // (2 * D), p // D % 2, p % D]
            across[d, p] = 0.0
            for q in range(width):
                across[d, p] += J[d, q] * covariance[r, first + q, first + p]
    for d in range(D):
        for e in range(D):
            known[i, d, e] = 0.0
            for p in range(width):
                known[i, d, e] += across[d, p] * J[e, p]


@njit(cache=True, nogil=True)
@typing.no_type_check
def difference(covariance, r, ago, last, d, e):
    """Give an element of the covariance of the difference of place (x, y) between two frames of a window."""
    a, b = 4 * ago, 4 * last
    own = covariance[r, a + d, a + e] + covariance[r, b + d, b + e]
    return own - covariance[r, a + d, b + e] - covariance[r, a + e, b + d]
