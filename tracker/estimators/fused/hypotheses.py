"""Two explanations of a look: the object moved suddenly, or the look is off as a whole; the next look settles it.

Compiled by numba; rows are those of `rows`.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import axes_kernels, heavy_tails, motion_kernels, row_kernels

# A look may be off as a whole, as by a box that jumps: share of such looks, and standard deviation along each axis [m].
OFF_SHARE, OFF_SD = 0.01, 0.3
# What moves may change its velocity at once, as in a crash: share of looks, standard deviation along each axis [m/s].
SUDDEN_SHARE, SUDDEN_SD = 0.002, 5.0
MOST_COST = 9.0  # an explanation that is less likely than that is not kept: difference of negative logarithms
UNSETTLED = 0.05  # what is left of the probability that a look is right when it is dropped


@njit(cache=True, nogil=True)
@typing.no_type_check
def weigh(rows, at, turned, tails):
    """Settle the looks before, and say how much the latest ones may be off, once all comparisons are solved for.

    The comparisons of a look share its error, so nothing but the next look tells it from a sudden change.  What a look
    told that is off is dropped.  As far as the look before is not settled, both its step and the next may err.

    Args:
        rows: see `rows.Rows`; changed.
        at: of which windows (K).
        turned: how the axes stand, see `heading.Turned`.
        tails: degrees of freedom of Student's t for errors of looks, and of the motion; 0: normal.
    """
    frames, explained, D = rows.frames, rows.explained, rows.frames.state.shape[3]
    rotations, left, doubt, only = np.ones((1, D, D)), np.empty((D, D)), np.empty((D, D)), np.int64(0)
    for k in range(len(at)):
        r = at[k]
        last = frames.sizes[r] - 1
        if D > 1:
            motion_kernels.rotate(-row_kernels.turn_since(turned, frames.axes[r, last - 1]), rotations, only)
        _settle(frames, rows.comparisons, explained, r, left)
        _explain(frames, explained, r, rotations, tails, doubt)
        is_told_of = np.isnan(explained.rivals[r, 0]) and not np.isnan(explained.contrary[r, 0])
        share = explained.contrary_shares[r] if is_told_of else 0.0
        for d in range(D):
            for e in range(D):
                if is_told_of:
                    doubt[d, e] += share * explained.contrary[r, d] * explained.contrary[r, e]
                frames.doubts[r, last - 1, d, e] = explained.left[r, d, e] + left[d, e]
        axes_kernels.turn(left, rotations, only, D, explained.left[r])
        for d in range(D):
            for e in range(D):
                frames.doubts[r, last, d, e] = doubt[d, e] + explained.left[r, d, e]


@njit(inline="always")
@typing.no_type_check
def _settle(frames, comparisons, explained, r, left):
    """Fill in the doubt that the look before leaves (D, D); drop what it told if it is off."""
    has_other, unsettled = not np.isnan(explained.others[r, 0]), explained.unsettled[r]
    D, before = len(left), frames.sizes[r] - 2
    for d in range(D):
        for e in range(D):
            left[d, e] = unsettled * explained.others[r, d] * explained.others[r, e] if has_other else 0.0
    if not has_other:
        return
    latest = comparisons.counts[r] - 1
    has_told = latest >= 0 and comparisons.ends[r, latest, 1] == before + 1
    if explained.is_sudden[r] and has_told and unsettled < UNSETTLED:
        frames.is_off[r, before] = True
        row_kernels.forget(comparisons, r, before)


@njit(inline="always")
@typing.no_type_check
def _explain(frames, explained, r, rotations, tails, doubt):
    """Weigh both explanations of the latest look, keep the one that is not taken, and fill in what a step may err.

    Args:
        frames, explained: see `rows.Rows`; the other explanation is changed, which was that of the look before.
        r: which window.
        rotations: the only one turns the axes of the frame before to the latest (1, D, D).
        tails: see `weigh`.
        doubt: covariance that the step has beside its own, since either may hold (D, D).
    """
    D, last = len(doubt), frames.sizes[r] - 1
    seconds = frames.times[r, last] - frames.times[r, last - 1]
    step, shown, expected, covariance = np.empty(D), np.empty(D), np.empty(D), np.empty((D, D))
    has_rival, is_sudden, only = not np.isnan(explained.rivals[r, 0]), False, np.int64(0)
    for d in range(D):
        step[d], expected[d] = frames.state[r, last, 0, d], 0.0
        for e in range(D):
            step[d] -= rotations[0, d, e] * frames.state[r, last - 1, 0, e]
            expected[d] += rotations[0, d, e] * explained.expected[r, 0, e]
        shown[d] = explained.rivals[r, d] if has_rival else step[d]
        is_sudden |= step[d] != shown[d]
    axes_kernels.turn(explained.expected_covariances[r, 0], rotations, only, D, covariance)
    odds, away = _weigh(step, shown, expected, covariance, SUDDEN_SD * seconds, tails, doubt)
    cost = odds if is_sudden else -odds
    for d in range(D):
        explained.others[r, d] = np.nan
    if cost > MOST_COST:
        return
    explained.costs[r], explained.is_sudden[r], explained.seconds[r] = cost, is_sudden, seconds
    for d in range(D):
        off = shown[d] - expected[d]
        explained.others[r, d] = shown[d] - step[d] if is_sudden else -away[d]
        # a sudden change was somewhere in the step
        explained.rates[r, d] = ((1.5 * shown[d] - 0.5 * expected[d]) if is_sudden else expected[d]) / seconds
        for e in range(D):
            open_ = 0.25 * off * (shown[e] - expected[e]) if is_sudden else covariance[d, e]
            explained.rate_covariances[r, d, e] = open_ / seconds**2


@njit(inline="always")
@typing.no_type_check
def _weigh(step, shown, expected, covariance, sudden, tails, doubt):  # noqa: PLR0913
    """Weigh both explanations: each is as likely as the motion, or an error of the look, makes what is seen.

    The motion is as it is expected, or, rarely, changes at once by `sudden` (standard deviation of the step [m]).

    Source: Bayes' theorem over two hypotheses.  Each adds, by its share, how far it is from the step that was taken.

    The motion's t is that of a place alone, where the windows' is of place and rate.

    Args:
        step: to the latest look, as it was taken, in its axes (D).
        shown: as the comparisons tell (D).
        expected, covariance: as the motion so far would have it (D), (D, D).
        sudden: see above.
        tails: see `weigh`.
        doubt: covariance that the step has beside its own (D, D), filled in.

    Returns:
        logarithm of the odds that the look is off, and where the step was taken to relative to that (D).
    """
    D, off, away = len(step), np.empty(len(step)), np.empty(len(step))
    wider = _wider(covariance, OFF_SD**2)
    back = motion_kernels.inverse(wider, D)
    for d in range(D):
        off[d] = shown[d] - expected[d]
    steady = _log_density(tails[1], off, covariance)
    changed = np.log(SUDDEN_SHARE) + _log_density(tails[1], off, _wider(covariance, sudden**2))
    odds = np.log(OFF_SHARE) + _log_density(tails[0], off, wider) - np.logaddexp(steady, changed)
    share = 1.0 / (1.0 + np.exp(-odds))
    for d in range(D):
        away[d] = step[d] - shown[d]
        for e in range(D):
            away[d] += OFF_SD**2 * back[d, e] * off[e]
    for d in range(D):
        for e in range(D):
            left = (step[d] - shown[d]) * (step[e] - shown[e])
            doubt[d, e] = (1.0 - share) * left + share * away[d] * away[e]
    return odds, away


@njit(cache=True, nogil=True)
@typing.no_type_check
def _wider(covariance, variance):
    found = np.empty(covariance.shape)
    for d in range(len(found)):
        for e in range(len(found)):
            found[d, e] = covariance[d, e] + (variance if d == e else 0.0)
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def _log_density(tail, off, covariance):
    D, distance = len(off), 0.0
    own = motion_kernels.inverse(covariance, D)
    for d in range(D):
        for e in range(D):
            distance += off[d] * own[d, e] * off[e]
    determinant = covariance[0, 0] if D == 1 else covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
    return heavy_tails.log_density(tail, D, distance) - 0.5 * np.log(determinant)


@njit(inline="always")
@typing.no_type_check
def take_other(frames, explained, r):
    """Take the other explanation of the look before; the state is that of it already."""
    last, D = frames.sizes[r] - 1, frames.state.shape[3]
    seconds = frames.times[r, last] - frames.times[r, last - 1]
    expected, covariances = explained.expected, explained.expected_covariances
    for d in range(D):
        known = frames.rates[r, last - 1, d]
        frames.rates[r, last - 1, d], explained.known_rates[r, d] = explained.known_rates[r, d], known
        explained.rates[r, d] = expected[r, 0, d] / seconds
        expected[r, 0, d], expected[r, 1, d] = expected[r, 1, d], expected[r, 0, d]
        for e in range(D):
            known = frames.rate_covariances[r, last - 1, d, e]
            frames.rate_covariances[r, last - 1, d, e] = explained.known_covariances[r, d, e]
            explained.known_covariances[r, d, e] = known
            own = covariances[r, 0, d, e]
            covariances[r, 0, d, e], covariances[r, 1, d, e] = covariances[r, 1, d, e], own
        explained.others[r, d] = -explained.others[r, d]
    explained.costs[r] = -explained.costs[r]
    explained.is_sudden[r] = not explained.is_sudden[r]
