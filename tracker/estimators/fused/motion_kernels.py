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
def advance(state, covariance, dt, turned, density, shake, is_full):
    """Add a frame where the motion would lead; a full window loses its first one.

    Args:
        state: (n, 2, D), in the axes of the frames.
        covariance: of all of it (2 n D, 2 n D).
        dt: [s].
        turned: rotation from the last frame's axes to the new one's (D, D).
        density: of the acceleration's noise.
        shake: covariance that the new place has beside that (D, D).
        is_full: whether the first frame goes.

    Returns:
        both, with the new frame.
    """
    n, D = state.shape[0], state.shape[2]
    first = 1 if is_full else 0
    size, gone, last = 2 * D * (n - first), 2 * D * first, 2 * D * (n - 1)
    moved, found = np.zeros((n - first + 1, 2, D)), np.zeros((size + 2 * D, size + 2 * D))
    moved[:-1], found[:size, :size] = state[first:], covariance[gone:, gone:]
    moved[-1, 0], moved[-1, 1] = turned @ (state[-1, 0] + dt * state[-1, 1]), turned @ state[-1, 1]
    A = np.zeros((2 * D, 2 * D))
    A[:D, :D], A[:D, D:], A[D:, D:] = turned, dt * turned, turned
    across = A @ covariance[last:, gone:].copy()
    found[size:, :size], found[:size, size:] = across, across.T
    noise = A @ covariance[last:, last:].copy() @ A.T
    noise[:D, :D] += shake
    for d in range(D):
        noise[d, d] += density * dt**3 / 3.0
        noise[D + d, D + d] += density * dt
        noise[d, D + d] += density * dt**2 / 2.0
        noise[D + d, d] += density * dt**2 / 2.0
    found[size:, size:] = noise
    return moved, found


@njit(cache=True, nogil=True)
@typing.no_type_check
def steps(sizes, state, covariances, times, tells, shakes, density, tail, D):
    """Give how far K objects moved from frame to frame, N in all, without what only their frames' axes shook (N - K).

    Between two rates, a motion of nearly constant rate leaves a displacement as open as `density` dt^3 / 12 about their
    mean, and more where it changes suddenly (a crash is no error of a pose); what the places differ from that is the
    motion's share, and the shake's.  Axes shake or turn, not both: then the shake is 0, and a step a difference.

    Args:
        sizes: frames of each object (K).
        state: in the axes of the frames (N, 2, D).
        covariances: of all of it, object by object, (2 n D, 2 n D) each, flat.
        times: of the frames [s] (N).
        tells: whether the places at both ends tell of each step's velocity (N - K).
        shakes: covariance that each frame's place has beside that of the motion (N, D, D).
        density: of the acceleration's noise.
        tail: degrees of freedom of the motion's errors.
        D: 1 or 2.

    Returns:
        displacements; what is open of them since places and rates are (N - K, D, D), and since axes shake (the same).
    """
    n = len(times) - len(sizes)
    found, known, shaken = np.empty((n, D)), np.empty((n, D, D)), np.empty((n, D, D))
    J, one = np.zeros((D, 4 * D)), np.eye(D)
    i = frame = begin = np.int64(0)  # not literals; see window_kernels
    for k in range(len(sizes)):
        width = 2 * D * sizes[k]
        covariance = covariances[begin : begin + width * width].reshape((width, width))
        for j in range(sizes[k] - 1):
            f, first = frame + j, 2 * D * j
            dt = times[f + 1] - times[f]
            both = np.ascontiguousarray(state[f : f + 2]).reshape(4 * D)
            surprise = both @ information(dt, density, shakes[f + 1], D) @ both
            own = density * dt**3 / 12.0 / heavy_tails.weight(tail, 2 * D, surprise) * one
            # the share of the shake: all, where places do not tell of a velocity
            shake = shakes[f + 1] @ inverse(shakes[f + 1] + own, D) if tells[i] else one
            J[:, :D], J[:, 2 * D : 3 * D] = shake - one, one - shake
            J[:, D : 2 * D] = J[:, 3 * D :] = 0.5 * dt * shake
            joint = np.ascontiguousarray(covariance[first : first + 4 * D, first : first + 4 * D])
            known[i], shaken[i] = J @ joint @ J.T, shake @ own
            found[i] = J @ both
            i += 1
        frame, begin = frame + sizes[k], begin + width * width
    return found, known, shaken
