"""When beams that turn pass places, and where what they pass was seen from; compiled by numba, behind `sensor`."""

import math
import typing

import numpy as np
from numba import njit

TURN = 2.0 * np.pi


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def meet(points, begin, lags, middles, sensor, sweep):  # noqa: PLR0913
    """Put the points of K looks to where the beams met them, as the sensor moves on, in place.

    Args:
        points: of all looks (n, 3) [m].
        begin: those of look k are rows begin[k] to begin[k + 1], one at least.
        lags: how much later than the sensor's head each point is passed (n) [s].
        middles: of what was seen (K, 2) [m].
        sensor: its place (x, y) [m] and yaw [rad], velocity (x, y) [m/s] and rate of turn [rad/s].
        sweep: period [s], sense in which it turns (-1: clockwise), direction in which it ends [rad].

    Returns:
        when the beams passed each point (n) [s], and the middles (K); how far points were moved (K, 2) [m]; and time
        from the first to the last point of each look (K) [s].
    """
    passed, met, n = np.empty(len(points)), np.empty(len(middles)), len(middles)
    shifts, took = np.empty((n, 2)), np.empty(n)
    for k in range(n):
        x, y = middles[k, 0], middles[k, 1]
        met[k] = delay(x, y, 0.0, sensor, sweep)
        shifts[k, 0] = met[k] * (sensor[3] - sensor[5] * (y - sensor[1]))
        shifts[k, 1] = met[k] * (sensor[4] + sensor[5] * (x - sensor[0]))
        first, last = np.inf, -np.inf
        for i in range(begin[k], begin[k + 1]):
            passed[i] = delay(points[i, 0], points[i, 1], lags[i], sensor, sweep)
            first, last = min(first, passed[i]), max(last, passed[i])
            points[i, 0] += shifts[k, 0]
            points[i, 1] += shifts[k, 1]
        took[k] = last - first
    return passed, met, shifts, took


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def straighten(points, passed, at, vx, vy):
    """Give where points (n, 3) were at one time [s], which move by (vx, vy) [m/s] and were passed at others (n) [s]."""
    found = points.copy()
    for i in range(len(points)):
        found[i, 0] += (at - passed[i]) * vx
        found[i, 1] += (at - passed[i]) * vy
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def delay(x, y, lag, sensor, sweep):
    """Give when beams pass a place, after they pointed forward [s]; as `ego_motion.sweep.azimuth_times`, see `meet`."""
    period, sense, cut = sweep
    azimuth = math.atan2(y - sensor[1], x - sensor[0]) - sensor[2] - TURN / period * lag
    since_cut, forward = (sense * (azimuth - cut) / TURN) % 1.0, (-sense * cut / TURN) % 1.0
    return period * (since_cut - forward)
