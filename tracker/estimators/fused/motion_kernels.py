"""A motion of nearly constant rate: what it says of neighbouring frames, and how it goes on; compiled by numba.

A frame's unknowns are, D numbers each: place, rate, offset; see `window_kernels`.
"""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def information(dt, density, shake, D):
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
def advance(state, covariance, dt, turned, model, is_full):
    """Add a frame where the motion would lead; a full window loses its first one.

    Args:
        state: (n, 3, D), in the axes of the frames.
        covariance: of all of it (3 n D, 3 n D).
        dt: [s].
        turned: rotation from the last frame's axes to the new one's (D, D).
        model: density of the acceleration's noise, covariance that the place has beside that (D, D), standard
            deviation of the new offset.
        is_full: whether the first frame goes.

    Returns:
        both, with the new frame.
    """
    density, shake, offset_sd = model
    n, D = state.shape[0], state.shape[2]
    first = 1 if is_full else 0
    size, gone, last = 3 * D * (n - first), 3 * D * first, 3 * D * (n - 1)
    moved, found = np.zeros((n - first + 1, 3, D)), np.zeros((size + 3 * D, size + 3 * D))
    moved[:-1], found[:size, :size] = state[first:], covariance[gone:, gone:]
    moved[-1, 0], moved[-1, 1] = turned @ (state[-1, 0] + dt * state[-1, 1]), turned @ state[-1, 1]
    A = np.zeros((3 * D, 3 * D))
    A[:D, :D], A[:D, D : 2 * D], A[D : 2 * D, D : 2 * D] = turned, dt * turned, turned
    across = A @ covariance[last:, gone:].copy()
    found[size:, :size], found[:size, size:] = across, across.T
    noise = A @ covariance[last:, last:].copy() @ A.T
    noise[:D, :D] += shake
    for d in range(D):
        noise[d, d] += density * dt**3 / 3.0
        noise[D + d, D + d] += density * dt
        noise[d, D + d] += density * dt**2 / 2.0
        noise[D + d, d] += density * dt**2 / 2.0
        noise[2 * D + d, 2 * D + d] += offset_sd**2
    found[size:, size:] = noise
    return moved, found


@njit(cache=True, nogil=True)
@typing.no_type_check
def step_covariances(covariance, D):
    """Give the covariance of each step of place, from frame to frame (n - 1, D, D)."""
    n = len(covariance) // (3 * D)
    found = np.empty((n - 1, D, D))
    for j in range(n - 1):
        a, b = 3 * D * j, 3 * D * (j + 1)
        for d in range(D):
            for e in range(D):
                across = covariance[a + d, b + e] + covariance[b + d, a + e]
                found[j, d, e] = covariance[a + d, a + e] + covariance[b + d, b + e] - across
    return found
