"""Objects go on by a frame, and their centres with them, all of a frame at once; compiled by numba, for `track`."""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import row_kernels
from tracker.estimators.fused.look_numbers import SENSOR, TIME


@njit(cache=True, nogil=True)
@typing.no_type_check
def advance(places, turns, looks, at, new, turned, densities, pose_turn_sd):
    """Expect objects where their motion leads.

    Args:
        places, turns: their windows, see `rows.Rows`; changed.
        looks: numbers of the looks at them, see `look_numbers`; changed (C, n, columns).
        at: their rows (K).
        new: numbers of the new looks (K, columns).
        turned: how the axes stand, see `heading.Turned`.
        densities: of the noise of accelerations of both.
        pose_turn_sd: of the axes' own turn [rad].
    """
    K, sizes, n = len(at), places.frames.sizes, looks.shape[1]
    state, shakes, across = places.frames.state, np.empty((K, 2, 2)), np.empty(2)
    for k in range(K):
        r = at[k]
        last = sizes[r] - 1
        across[0] = -pose_turn_sd * (state[r, last, 0, 1] - new[k, SENSOR + 1])
        across[1] = pose_turn_sd * (state[r, last, 0, 0] - new[k, SENSOR])
        for d in range(2):
            for e in range(2):
                shakes[k, d, e] = across[d] * across[e]
        if last == n - 1:
            for j in range(last):
                looks[r, j] = looks[r, j + 1]
        looks[r, min(last + 1, n - 1)] = new[k]
    times = new[:, TIME].copy()
    row_kernels.advance(places, at, times, turned, densities[0], shakes)
    row_kernels.advance(turns, at, times, turned, densities[1], np.zeros((K, 1, 1)))


@njit(cache=True, nogil=True)
@typing.no_type_check
def centers_at(places, turns, centers, at, ago):
    """Give the centres of objects (K, 2) so many frames ago [m]; see `refer`."""
    found = np.empty((len(at), 2))
    for k in range(len(at)):
        r = at[k]
        j = places.sizes[r] - 1 - ago
        angle = turns.state[r, j, 0, 0]
        c, s, x, y = np.cos(angle), np.sin(angle), centers[r, 0], centers[r, 1]
        found[k, 0] = places.state[r, j, 0, 0] + c * x - s * y
        found[k, 1] = places.state[r, j, 0, 1] + s * x + c * y
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def refer(places, turns, centers, n_centers, at, seen, most):
    """Let opinions of where objects' centres are in their latest looks count for where these are.

    Args:
        places, turns: frames of their windows, see `rows.Frames`.
        centers: relative to their places, in the axes of their first looks [m] (C, 2); changed.
        n_centers: looks that these are means over (C); changed.
        at: rows of the objects (K).
        seen: where their centres seem to be [m] (K, 2); NaN where nobody can tell.
        most: looks that count.
    """
    for k in range(len(at)):
        if np.isnan(seen[k, 0]):
            continue
        r = at[k]
        last = places.sizes[r] - 1
        angle = turns.state[r, last, 0, 0]
        x, y = seen[k, 0] - places.state[r, last, 0, 0], seen[k, 1] - places.state[r, last, 0, 1]
        c, s = np.cos(angle), np.sin(angle)
        n_centers[r] = min(n_centers[r] + 1, most)
        centers[r, 0] += (c * x + s * y - centers[r, 0]) / n_centers[r]
        centers[r, 1] += (c * y - s * x - centers[r, 1]) / n_centers[r]


@njit(cache=True, nogil=True)
@typing.no_type_check
def latest_rates(places, at):
    """Give how fast objects moved over their latest steps, as their places tell (K, 2) [m/s]."""
    found = np.empty((len(at), 2))
    for k in range(len(at)):
        r = at[k]
        last = places.sizes[r] - 1
        for d in range(2):
            way = places.state[r, last, 0, d] - places.state[r, last - 1, 0, d]
            found[k, d] = way / (places.times[r, last] - places.times[r, last - 1])
    return found
