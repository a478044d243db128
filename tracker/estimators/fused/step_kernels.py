"""What is known of the velocities of a frame's objects, read from their windows; compiled by numba, for `steps`."""

import math
import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import motion_kernels
from tracker.estimators.fused.look_numbers import CLOCK, DELAY, FRAME, LATE, N_POINTS, PAST_END, TIME

LEAST_SD = 0.005  # of a velocity [m/s]
# Few points may be laid on the wrong part of an object: n of them, the most of any step of those that follow on each
# other, in one case of (n + 1)^2, by so much along each axis, about as far as two points of a car are apart.  Of 1117
# first steps in scenes of our own (seeds 31, 32, 41 to 44) shapes were more than 1 m off in 20 % of those of one point,
# 4 % of those of two to five, 2 % up to eight, 1 % up to 40.
SLIP_SD = 1.7  # [m]
CENTER_SD = 0.25  # of where an object's centre is, as labels have it [m]
FEW_SD = 2.0  # of a velocity from a single point [m/s]; of n points, an n-th of it


@njit(cache=True, nogil=True)
@typing.no_type_check
def read(places, turns, looks, centers, at, motions, share, sweeps):
    """Give all that `steps.Steps` has, in that order.

    Args:
        places, turns: frames of the objects' windows, see `rows.Frames`.
        looks: numbers of the looks at them, see `look_numbers` (C, n, columns).
        centers: of the objects relative to their places, in the axes of their first looks [m] (C, 2).
        at: rows of the objects (K).
        motions: spectral density of the noise of places' motion, and degrees of freedom of its errors; the same of
            headings.
        share: that errors have of the windows' covariances.
        sweeps: share of the time between two frames that lies between two looks at least, for these to tell of a
            velocity; period of a sweep, and the shortest time between two frames [s].
    """
    N = 0
    for r in at:
        N += places.sizes[r] - 1
    owners, frames, numbers, lengths = _four(N)
    ends = np.empty(len(at), np.int64)
    seconds, fewest, tells, by_clock = np.empty(N), np.empty(N), np.empty(N, np.bool_), np.empty(N)
    i = 0
    for k in range(len(at)):
        r = at[k]
        for j in range(1, places.sizes[r]):
            owners[i], frames[i], numbers[i] = k, int(looks[r, j, FRAME]), places.axes[r, j]
            lengths[i], seconds[i] = numbers[i] - places.axes[r, j - 1], places.times[r, j] - places.times[r, j - 1]
            fewest[i] = min(looks[r, j, N_POINTS], looks[r, j - 1, N_POINTS])
            between = looks[r, j, TIME] - looks[r, j, DELAY] - (looks[r, j - 1, TIME] - looks[r, j - 1, DELAY])
            tells[i], by_clock[i] = seconds[i] > sweeps[0] * between, _by_clock(looks, r, j, sweeps)
            i += 1
        ends[k] = i
    turned, turns_known, _ = motion_kernels.steps(turns, at, tells, motions[2], motions[3])
    moved, known, shaken = motion_kernels.steps(places, at, tells, motions[0], motions[1])
    latest = _refer(places, turns, centers, at, seconds, moved, known, turned, turns_known)
    covariances, doubts = _errors(places, looks, at, seconds, fewest, moved, known, shaken, share)
    slips_ = slips(owners, lengths, fewest, seconds)
    return (
        owners,
        ends,
        frames,
        numbers,
        lengths,
        latest[0],
        moved,
        covariances,
        doubts,
        slips_,
        by_clock,
        *latest[1:],
    )


@njit(cache=True, nogil=True)
@typing.no_type_check
def _four(n):
    return np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _by_clock(looks, r, j, sweeps):
    """Give what the velocity to a look is to be multiplied by, to be a displacement over the time of the clock."""
    late = looks[r, j, LATE] - looks[r, j - 1, LATE]
    if abs(late) > 0.5 * sweeps[1]:
        return 1.0
    return 1.0 + late / max(looks[r, j, CLOCK] - looks[r, j - 1, CLOCK], sweeps[2])


@njit(inline="always")
@typing.no_type_check
def _refer(places, turns, centers, at, seconds, moved, known, turned, turns_known):
    """Let displacements of places be velocities of centres, and covariances of those count for these, in place.

    Returns:
        where the centres are half-way (N, 2) and at last (K, 2) [m], and how fast objects turn at last (K) [rad/s].
    """
    half_way, latest, rates = np.empty((len(seconds), 2)), np.empty((len(at), 2)), np.empty(len(at))
    arm, before, center = np.zeros(2), np.zeros(2), np.zeros(2)
    i = np.int64(0)  # not a literal; see window_kernels
    for k in range(len(at)):
        r = at[k]
        for j in range(places.sizes[r]):
            angle = turns.state[r, j, 0, 0]
            c, s = np.cos(angle), np.sin(angle)
            before[0], before[1] = arm[0], arm[1]
            arm[0], arm[1] = c * centers[r, 0] - s * centers[r, 1], s * centers[r, 0] + c * centers[r, 1]
            for d in range(2):
                last, center[d] = center[d], places.state[r, j, 0, d] + arm[d]
                if j > 0:
                    half_way[i, d] = 0.5 * (center[d] + last)
                    moved[i, d] = (moved[i, d] + (arm[d] - before[d])) / seconds[i]
                    for e in range(2):
                        sign = 1.0 if d == e else -1.0
                        known[i, d, e] += sign * turns_known[i, 0, 0] * arm[1 - d] * arm[1 - e]
            i += 1 if j > 0 else 0
        latest[k, 0], latest[k, 1], rates[k] = center[0], center[1], turned[i - 1, 0] / seconds[i - 1]
    return half_way, latest, rates


@njit(inline="always")
@typing.no_type_check
def _errors(places, looks, at, seconds, fewest, velocities, known, shaken, share):
    """Give the covariances of velocities (N, 2, 2), and those of doubts about them."""
    covariances, doubts = np.empty((len(seconds), 2, 2)), np.empty((len(seconds), 2, 2))
    i = np.int64(0)  # not a literal; see window_kernels
    for r in at:
        for j in range(1, places.sizes[r]):
            least, per_second2 = LEAST_SD**2 + (FEW_SD / fewest[i]) ** 2, seconds[i] ** -2.0
            crosses = _crossed(looks[r, j - 1, PAST_END], looks[r, j, PAST_END])
            unknown = crosses * (velocities[i, 0] ** 2 + velocities[i, 1] ** 2)
            for d in range(2):
                for e in range(2):
                    covariances[i, d, e] = share * per_second2 * (known[i, d, e] + shaken[i, d, e])
                    doubts[i, d, e] = per_second2 * places.doubts[r, j, d, e]
                covariances[i, d, d] += least
                doubts[i, d, d] += unknown
            i += 1
    return covariances, doubts


@njit(cache=True, nogil=True)
@typing.no_type_check
def _crossed(before, after):
    """Give the probability that an object's centre crossed the direction in which sweeps end, from look to look.

    Where that is, is known to CENTER_SD, and errs in neighbouring looks alike.  How far each is past it: [m], or NaN.
    """
    if np.isnan(before) or np.isnan(after):
        return 0.0
    wide = math.sqrt(2.0) * CENTER_SD
    return 0.5 * abs(math.erfc(-after / wide) - math.erfc(-before / wide))


@njit(cache=True, nogil=True)
@typing.no_type_check
def slips(owners, lengths, n_points, seconds):
    """Say how likely clouds were laid on wrong parts in each step, and the variance of its velocity then [m^2/s^2].

    An object's steps from one frame to the next, without a gap, stand for each other; what is seen may slide along in
    all of them.

    Args:
        owners, lengths: see `steps.Steps`.
        n_points: of both looks, the fewer (N).
        seconds: that steps take (N).
    """
    found = np.empty((len(owners), 2))
    first = np.int64(0)  # not a literal; see window_kernels
    while first < len(owners):
        end, laid, took = first, 0.0, 0.0
        while end < len(owners) and (end == first or not _is_apart(owners, lengths, end)):
            laid, took = max(laid, n_points[end]), took + seconds[end]
            end += 1
        for i in range(first, end):
            found[i, 0], found[i, 1] = (1.0 + laid) ** -2.0, (SLIP_SD / took) ** 2
        first = end
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def _is_apart(owners, lengths, i):
    """Say whether step i is no neighbour of the one before, without a gap in either."""
    return owners[i] != owners[i - 1] or lengths[i] > 1 or lengths[i - 1] > 1
