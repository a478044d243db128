"""The latest looks at objects beside earlier ones: what is expected, and heard, of each pair; compiled by numba."""

import math
import typing
from typing import NamedTuple

import numpy as np
from numba import njit

from tracker.estimators.fused import motion_kernels, row_kernels
from tracker.estimators.fused.look_numbers import IS_TIMED, IS_TORN, N_FROM_1M, N_POINTS, SENSOR

RIGHT_THERE = 1e-9  # of points seen from 1 m: those right at the sensor are none
FIRST_TURN_SD = 0.05  # of a turn between the first two looks [rad]
SEARCHED_TURN_SD = 0.01  # of a turn that is always searched [rad]


class Pairs(NamedTuple):
    """The latest looks at K objects, each beside some of the earlier ones, M pairs in all, object by object.

    Attributes:
        owners: which object each is of (M).
        rows: of these objects (M).
        lags: how many looks ago the earlier one was (M).
        olders, newers: where the object's reference point was taken to be at both, before they are compared (M, 2) [m].
        turns: by how much its heading is taken to have changed (M) [rad].
        n_told: how many comparisons of earlier frames there are with the earlier look, as the older (M).
        n_lags: comparisons of the object's latest look, of all sources (M).
    """

    owners: np.ndarray
    rows: np.ndarray
    lags: np.ndarray
    olders: np.ndarray
    newers: np.ndarray
    turns: np.ndarray
    n_told: np.ndarray
    n_lags: np.ndarray


class Doubts(NamedTuple):
    """What makes comparisons less sure than they claim to be.

    Attributes:
        by_change: standard deviation where looks share nothing [m]; it goes with the square of the share of points
            that came or went, beside those that the range explains.
        by_turn: along the way, for each radian that the object turned against the line of sight [m/rad].
        by_way: along the way, as a share of it.
        by_untimed_way: the same where nobody knows when each laser fires.
        by_tear: where a look is torn [m].
        by_point: of where an object is by a single point of it; by n points, an n-th of that [m].
    """

    by_change: float
    by_turn: float
    by_way: float
    by_untimed_way: float
    by_tear: float
    by_point: float


class Found(NamedTuple):
    """What was found of M pairs; see `sources.Evidence`.

    Attributes:
        steps, informations, turns, turn_variances: (M, 2), (M, 2, 2), (M), (M).
        may_change: where looks that share nothing are less sure (M).
        is_told: which are heard at all (M).
    """

    steps: np.ndarray
    informations: np.ndarray
    turns: np.ndarray
    turn_variances: np.ndarray
    may_change: np.ndarray
    is_told: np.ndarray


@njit(cache=True, nogil=True)
@typing.no_type_check
def paired(sizes, state, headings, comparisons, at, lags, others):
    """Pair the latest looks at objects with earlier ones; where there are too few yet, with the first.

    Args:
        sizes, state, comparisons: of the windows of their places, see `rows.Rows`.
        headings: state of those of their headings.
        at: rows of the objects (K).
        lags: how many looks ago, ascending.
        others: those of other sources.
    """
    M = 0
    for r in at:
        M += _n_lags(lags, sizes[r] - 1)
    owners, rows, own = np.empty(M, np.int64), np.empty(M, np.int64), np.empty(M, np.int64)
    n_told, n_lags = np.zeros(M, np.int64), np.empty(M, np.int64)
    olders, newers, turned = np.empty((M, 2)), np.empty((M, 2)), np.empty(M)
    counts, ends, m = comparisons.counts, comparisons.ends, 0
    for k in range(len(at)):
        r = at[k]
        last = sizes[r] - 1
        n = _n_lags(lags, last)
        for i in range(n):
            lag = min(lags[i], last)
            owners[m], rows[m], own[m], n_lags[m] = k, r, lag, n + _n_lags(others, last)
            for d in range(2):
                olders[m, d], newers[m, d] = state[r, last - lag, 0, d], state[r, last, 0, d]
            turned[m] = headings[r, last, 0, 0] - headings[r, last - lag, 0, 0]
            for c in range(counts[r]):
                n_told[m] += 1 if ends[r, c, 0] == last - lag and ends[r, c, 1] != last else 0
            m += 1
    return Pairs(owners, rows, own, olders, newers, turned, n_told, n_lags)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _n_lags(lags, n_looks):
    """Say with how many of so many looks the latest is compared; the first one stands for those before it."""
    n = 0
    while n < len(lags) and lags[n] < n_looks:
        n += 1
    return min(n + 1, len(lags))


@njit(cache=True, nogil=True)
@typing.no_type_check
def expected(sizes, covariance, headings, counts, contrary, pairs, floor, doubt, swing):
    """Say how surely it is known where the earlier looks of pairs are in the latest.

    Args:
        sizes, covariance, counts, contrary: of the windows of objects' places, see `rows.Rows`.
        headings: covariance of those of their headings.
        pairs: see `Pairs`.
        floor: standard deviation of an expected place that is always searched [m].
        doubt: factor of an expectation's covariance.
        swing: variance of the axes' own latest turn, with which objects swing [rad^2].

    Returns:
        whether anything is known of the motion (M); covariances of the step (M, 2, 2), nothing where not; variances of
        the turn (M); and covariances that another place adds that is told of (M, 2, 2).
    """
    M, lever = len(pairs.lags), np.empty(2)
    is_known, covariances = np.empty(M, np.bool_), np.zeros((M, 2, 2))
    variances, contraries = np.full(M, FIRST_TURN_SD**2), np.zeros((M, 2, 2))
    for m in range(M):
        r, last = pairs.rows[m], sizes[pairs.rows[m]] - 1
        ago = last - pairs.lags[m]
        is_known[m] = counts[r] > 0
        has_contrary = not np.isnan(contrary[r, 0])
        lever[0], lever[1] = -pairs.newers[m, 1], pairs.newers[m, 0]
        if is_known[m]:
            a, b = 2 * ago, 2 * last
            variances[m] = headings[r, a, a] + headings[r, b, b] - 2.0 * headings[r, a, b] + SEARCHED_TURN_SD**2
        for d in range(2):
            for e in range(2):
                if is_known[m]:
                    own = motion_kernels.difference(covariance, r, ago, last, d, e) + swing * lever[d] * lever[e]
                    covariances[m, d, e] = doubt * own + (floor**2 if d == e else 0.0)
                if has_contrary:
                    contraries[m, d, e] = doubt * contrary[r, d] * contrary[r, e]
    return is_known, covariances, variances, contraries


@njit(cache=True, nogil=True)
@typing.no_type_check
def hear(places, heard, is_off, turned, looks, pairs, found, doubts, begin):
    """Let objects hear what comparisons of pairs tell, from number `begin` on; they count from the next solving on.

    All comparisons with a look share the error that it has since it shows few points, or fewer than the other: it
    counts for so many times its variance as there are comparisons, so that many are worth no more than one.

    Args:
        places: frames of the windows of their places, see `rows.Frames`.
        heard: their comparisons, see `rows.Comparisons`; changed.
        is_off, turned: looks that are off, and comparisons, of the windows of their headings; the latter are changed.
        looks: numbers of the looks at them, see `look_numbers` (C, n, columns).
        pairs: see `Pairs`.
        found: see `Found`.
        doubts: see `Doubts`.
        begin: number of a pair.

    Returns:
        the number of the first pair that there was no room for; that of pairs, if there was for all.
    """
    step, turn, most = np.empty(12), np.zeros(4), min(heard.ends.shape[1], turned.ends.shape[1])
    for m in range(begin, len(pairs.lags)):
        r = pairs.rows[m]
        last = places.sizes[r] - 1
        if not found.is_told[m]:
            continue
        if max(heard.counts[r], turned.counts[r]) == most:
            return m
        for d in range(2):
            step[d], step[2 + d] = pairs.olders[m, d], pairs.olders[m, d] + found.steps[m, d]
            for e in range(2):
                step[4 + 2 * d + e] = found.informations[m, d, e]
        _doubt(looks, pairs, m, last, doubts, found.may_change[m], step)
        turn[1], turn[2] = found.turns[m], 1.0 / found.turn_variances[m]
        if pairs.lags[m] == last and heard.counts[r] == 0:  # nothing else is known yet
            row_kernels.place_last(places.state, places.times, r, last, step[2:4])
        row_kernels.hear(places.is_off, heard, r, last - pairs.lags[m], last, step)
        row_kernels.hear(is_off, turned, r, last - pairs.lags[m], last, turn)
    return len(pairs.lags)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _doubt(looks, pairs, m, last, doubts, may_change, step):
    """Fill in the covariance that looks which differ, few points and a long way add to the comparison of pair m."""
    r, older, newer = pairs.rows[m], np.sqrt(1.0 + pairs.n_told[m]), np.sqrt(pairs.n_lags[m])
    i = last - pairs.lags[m]
    before, now = looks[r, i, N_FROM_1M], looks[r, last, N_FROM_1M]
    changed = (1.0 - min(before, now) / max(before, now, RIGHT_THERE)) ** 2 if may_change else 0.0
    everywhere = (doubts.by_change * changed * (older if before < now else newer)) ** 2
    everywhere += (older * doubts.by_point / looks[r, i, N_POINTS]) ** 2
    everywhere += (newer * doubts.by_point / looks[r, last, N_POINTS]) ** 2
    if max(looks[r, i, IS_TORN], looks[r, last, IS_TORN]) > 0.0:
        everywhere += doubts.by_tear**2
    ax, ay = pairs.olders[m, 0] - looks[r, i, SENSOR], pairs.olders[m, 1] - looks[r, i, SENSOR + 1]
    bx, by = pairs.newers[m, 0] - looks[r, last, SENSOR], pairs.newers[m, 1] - looks[r, last, SENSOR + 1]
    x, y = bx - ax, by - ay
    length = math.hypot(x, y)
    turned = math.atan2(by, bx) - math.atan2(ay, ax) - pairs.turns[m]  # against the line of sight
    turned = abs(math.pi - (math.pi - turned) % (2.0 * math.pi))
    by_turn = doubts.by_turn * turned / length if length > 0.0 else 0.0
    along = math.hypot(doubts.by_way if looks[r, last, IS_TIMED] > 0.0 else doubts.by_untimed_way, by_turn)
    step[8], step[11] = everywhere + (along * x) ** 2, everywhere + (along * y) ** 2
    step[9] = step[10] = along**2 * x * y
