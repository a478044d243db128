"""How late a velocity follows when an object starts to brake, to speed up or to turn."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

Times = Float64[np.ndarray, " n"]
Velocities = Float64[np.ndarray, "n 2"]

# A step of the acceleration: its means over two half-seconds, half a second apart, differ by this much at least.
# Drivers build up and release an acceleration within about half a second, so that a gap of that length leaves two
# means that each belong to one side of the change.
CHANGE = 1.5  # [m/s^2]
SUSTAINED = 0.5  # length of either mean [s]
GAP = 0.5  # between them [s]
APART = 1.5  # of two steps of one object; of those closer together the largest counts [s]

WINDOW = (-0.5, 1.5)  # the part of an estimate that is laid over the truth, seen from the middle of the step [s]
ROUNDING = 1e-6  # of times [s]
SHIFTS = np.arange(-30, 101) / 100.0  # by which it may be late; a smoothed one may be early [s]


class Delay(NamedTuple):
    """How late an estimate followed one step of the acceleration.

    Attributes:
        row: of the step's middle.
        seconds: delay [s].
    """

    row: int
    seconds: float


def delays(times: Times, estimated: Velocities, true: Velocities) -> list[Delay]:
    """Find the steps of an object's true acceleration, and how late the estimate followed each.

    The delay is the shift of the true velocity in time that brings it closest to the estimate: it minimises the
    sum of |estimated(t) - true(t - shift)|^2 over the second and a half after the step and the half-second before.
    Shifts are searched in steps of 0.01 s from -0.3 to 1 s; one that never follows gets the last.  An estimate
    that is the truth has delay 0; a filter of the first order has its time constant.  Velocities are means over the
    step between two frames, both the estimate and the truth, so the half period for which any such mean is late
    against the moment itself is not counted.

    Args:
        times: of the frames [s]; ascending, without gaps.
        estimated, true: velocities of the steps that end there [m/s]; the truth must be exact, since differences
            of label centres have accelerations of several m/s^2 by themselves.

    Source: Jacovitti & Scarano, "Discrete time techniques for time delay estimation", IEEE Trans. Signal Process.
    41(2), 1993 (the average square difference function), here with an interpolated truth, which has no noise.
    """
    return [Delay(int(row), _delay(times, estimated, true, int(row))) for row in acceleration_steps(times, true)]


def acceleration_steps(times: Times, true: Velocities) -> Int64[np.ndarray, " k"]:
    """List the rows in the middle of a sustained change of the acceleration, in order.

    Only those are listed around which the truth is known for as long as `delays` needs it: 1.5 s before and 1.8 s
    after; a step within the first second and a half of a track tells of its start, not of its delay.
    """
    if len(times) == 0:
        return np.empty(0, dtype=np.int64)
    change = _changes(times, true)
    found: list[int] = []
    for peak in np.argsort(-change, kind="stable"):
        if change[peak] < CHANGE:
            break
        if all(abs(times[peak] - times[row]) >= APART for row in found):
            found.append(_middle(times, change, int(peak)))
    rows = np.array(sorted(found), dtype=np.int64)
    first, last = times[0] - WINDOW[0] + SHIFTS[-1], times[-1] - WINDOW[1] + SHIFTS[0]
    return rows[(times[rows] >= first - ROUNDING) & (times[rows] <= last + ROUNDING)]


def _changes(times: Times, true: Velocities) -> Float64[np.ndarray, " n"]:
    """Give the change of the mean acceleration around each row [m/s^2]; 0 near the ends, where it is not known."""
    near, far = 0.5 * GAP, 0.5 * GAP + SUSTAINED
    before, after = (
        (_at(times, true, times + side * far) - _at(times, true, times + side * near)) / (side * SUSTAINED)
        for side in (-1.0, 1.0)
    )
    is_known = (times - far >= times[0] - ROUNDING) & (times + far <= times[-1] + ROUNDING)
    return np.where(is_known, np.linalg.norm(after - before, axis=1), 0.0)


def _middle(times: Times, change: Float64[np.ndarray, " n"], peak: int) -> int:
    """Find the middle of a change's plateau: a sudden step shows the same change for as long as the gap."""
    is_near = np.abs(times - times[peak]) <= GAP + ROUNDING
    plateau = np.flatnonzero(is_near & (change >= 0.9 * change[peak]))
    return int(plateau[len(plateau) // 2])


def runs(tracklet: Int64[np.ndarray, " n"], frames: Int64[np.ndarray, " n"]) -> Iterator[Int64[np.ndarray, " _"]]:
    """Give the rows of each stretch of consecutive steps of one object, in order of time."""
    order = np.lexsort((frames, tracklet))
    breaks = (np.diff(tracklet[order]) != 0) | (np.diff(frames[order]) != 1)
    yield from (run for run in np.split(order, np.flatnonzero(breaks) + 1) if len(run))


def _at(times: Times, velocities: Velocities, when: Float64[np.ndarray, "*k"]) -> Float64[np.ndarray, "*k 2"]:
    return np.stack([np.interp(when, times, velocities[:, axis]) for axis in (0, 1)], axis=-1)


def _delay(times: Times, estimated: Velocities, true: Velocities, row: int) -> float:
    """Find the shift that brings the truth closest to the estimate around a step; of equal ones the smallest."""
    here = (times >= times[row] + WINDOW[0] - ROUNDING) & (times <= times[row] + WINDOW[1] + ROUNDING)
    shifted = _at(times, true, times[here] - SHIFTS[:, None])
    cost = np.mean(np.sum((estimated[here] - shifted) ** 2, axis=-1), axis=1)
    best = np.flatnonzero(cost <= cost.min() + 1e-12)
    return float(SHIFTS[best[np.argmin(np.abs(SHIFTS[best]))]])
