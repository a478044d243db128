"""Objects go on by a frame, and their centres with them, all of a frame at once; compiled by numba, for `track`."""

import math
import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import row_kernels, sensor_kernels
from tracker.estimators.fused.look_numbers import CLOCK, LATE, PAST_END, SENSOR, TIME


@njit(cache=True, nogil=True)
@typing.no_type_check
def advance(places, turns, heard, looks, at, new, turned, densities, pose_turn_sd):
    """Expect objects where their motion leads.

    Args:
        places: windows of their places, see `rows.Rows`; changed.
        turns, heard: frames and comparisons of those of their headings; changed.
        looks: numbers of the looks at them, see `look_numbers`; changed (C, n, columns).
        at: their rows (K).
        new: numbers of the new looks (K, columns).
        turned: how the axes stand, see `heading.Turned`.
        densities: of the noise of accelerations of both.
        pose_turn_sd: of the axes' own turn [rad].
    """
    K, sizes, n = len(at), places.frames.sizes, looks.shape[1]
    state, shakes, across, times = places.frames.state, np.empty((K, 2, 2)), np.empty(2), np.empty(K)
    for k in range(K):
        r = at[k]
        last = sizes[r] - 1
        across[0] = -pose_turn_sd * (state[r, last, 0, 1] - new[k, SENSOR + 1])
        across[1] = pose_turn_sd * (state[r, last, 0, 0] - new[k, SENSOR])
        for d in range(2):
            for e in range(2):
                shakes[k, d, e] = across[d] * across[e]
        times[k] = new[k, TIME]
        for c in range(looks.shape[2]):
            for j in range(last if last == n - 1 else 0):
                looks[r, j, c] = looks[r, j + 1, c]
            looks[r, min(last + 1, n - 1), c] = new[k, c]
    row_kernels.expect(places.frames, places.explained, at, times, densities[0], shakes)
    row_kernels.advance(places.frames, places.comparisons, at, times, turned, densities[0], shakes)
    row_kernels.advance(turns, heard, at, times, turned, densities[1], np.zeros((K, 1, 1)))


@njit(cache=True, nogil=True)
@typing.no_type_check
def center_at(places, turns, centers, r, j):
    """Give an object's centre at frame j [m].

    Args:
        places, turns: state of the windows of places and headings, see `rows.Frames`.
        centers: relative to places, in the axes of the first looks [m] (C, 2).
        r, j: row of the object, and the frame.
    """
    angle, x, y = turns[r, j, 0, 0], centers[r, 0], centers[r, 1]
    c, s = np.cos(angle), np.sin(angle)
    return places[r, j, 0, 0] + c * x - s * y, places[r, j, 0, 1] + s * x + c * y


@njit(cache=True, nogil=True)
@typing.no_type_check
def refer(sizes, places, turns, centers, n_centers, at, seen, most):
    """Let opinions of where objects' centres are in their latest looks count for where these are.

    Args:
        sizes, places, turns: frames of the windows of places, and state of these and of those of headings.
        centers: see `center_at`; changed.
        n_centers: looks that these are means over (C); changed.
        at: rows of the objects (K).
        seen: where their centres seem to be [m] (K, 2); NaN where nobody can tell.
        most: looks that count.
    """
    for k in range(len(at)):
        if np.isnan(seen[k, 0]):
            continue
        r, last = at[k], sizes[at[k]] - 1
        angle = turns[r, last, 0, 0]
        x, y = seen[k, 0] - places[r, last, 0, 0], seen[k, 1] - places[r, last, 0, 1]
        c, s = np.cos(angle), np.sin(angle)
        n_centers[r] = min(n_centers[r] + 1, most)
        centers[r, 0] += (c * x + s * y - centers[r, 0]) / n_centers[r]
        centers[r, 1] += (c * y - s * x - centers[r, 1]) / n_centers[r]


@njit(cache=True, nogil=True)
@typing.no_type_check
def note_met(sizes, places, turns, centers, looks, at, shifts, sensor, sweep):
    """Note when the beams met objects' centres, where velocities count by another time; see `track.Tracks.look_back`.

    Args:
        sizes, places, turns, centers, at: see `refer`.
        looks: see `look_numbers`; those of the latest looks are changed.
        shifts: that these have (K, 2) [m].
        sensor, sweep: see `sensor_kernels.meet`.
    """
    for k in range(len(at)):
        r, last = at[k], sizes[at[k]] - 1
        if looks[r, last, CLOCK] == looks[r, last, TIME]:
            continue
        x, y = center_at(places, turns, centers, r, last)
        x, y = x - shifts[k, 0], y - shifts[k, 1]
        looks[r, last, LATE] = sensor_kernels.delay(x, y, 0.0, sensor, sweep)
        x, y = x - sensor[0], y - sensor[1]
        past = math.pi - (math.atan2(y, x) - sensor[2]) % (2.0 * math.pi)  # in (-pi, pi]
        looks[r, last, PAST_END] = past * math.hypot(x, y) if abs(past) < 0.5 * math.pi else math.nan


@njit(cache=True, nogil=True)
@typing.no_type_check
def against(sizes, times, places, turns, centers, at, sensor):
    """Give how fast objects moved over their latest steps against a sensor (K, 2) [m/s], as their places tell.

    Args:
        sizes, times, places, turns, centers, at: see `refer`.
        sensor: see `sensor_kernels.meet`.
    """
    found = np.empty((len(at), 2))
    for k in range(len(at)):
        r, last = at[k], sizes[at[k]] - 1
        x, y = center_at(places, turns, centers, r, last)
        carried = sensor[3] - sensor[5] * (y - sensor[1]), sensor[4] + sensor[5] * (x - sensor[0])
        for d in range(2):
            way = places[r, last, 0, d] - places[r, last - 1, 0, d]
            found[k, d] = way / (times[r, last] - times[r, last - 1]) - carried[d]
    return found
