"""Windows that have comparisons, taken out of their rows, solved for, and put back; compiled by numba.

numba's cache looks at this file only: after a change in a neighbour, delete `__pycache__/*.nb*` beside it.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import hypotheses, motion_kernels, row_kernels, window_kernels


@njit(cache=True, nogil=True)
@typing.no_type_check
def solve(rows, at, turned, axes, densities, tails, claimed):
    """Find the most likely places and rates of all frames of windows; those without comparisons stay as they are.

    Args:
        rows: see `rows.Rows`; changed.
        at: which windows (K).
        turned: how the axes stand, see `heading.Turned`.
        axes, densities, tails, claimed: see `window_kernels.solve`.

    Returns:
        whether there was anything to solve for; angles and rates of the axes, and the variance of the latest rate.
    """
    told = at[rows.comparisons.counts[at] > 0]
    if len(told) == 0:
        return False, axes.angles, axes.rates, 0.0
    problem = _taken(rows, told, turned)
    state, covariances, angles, rates, variance, chosen = window_kernels.solve(problem, axes, densities, tails, claimed)
    _put_back(rows, told, state, covariances, chosen)
    return True, angles, rates, variance


@njit(cache=True, nogil=True)
@typing.no_type_check
def _taken(rows, told, turned):
    """Lay windows one after the other."""
    frames, D = rows.frames, rows.frames.state.shape[3]
    sizes, counts = frames.sizes[told], rows.comparisons.counts[told]
    N, K = sizes.sum(), len(told)
    times, numbers, angles = np.empty(N), np.empty(N, np.int64), np.empty(N)
    state, shakes = np.empty((N, 2, D)), np.empty((N, D, D))
    rates, informations = np.empty((K, D)), np.empty((K, D, D))
    f = np.int64(0)  # not a literal; see window_kernels
    for k in range(K):
        r = told[k]
        rates[k], informations[k] = frames.rates[r, 0], motion_kernels.inverse(frames.rate_covariances[r, 0], D)
        for j in range(sizes[k]):
            number = frames.axes[r, j]
            times[f], numbers[f] = frames.times[r, j], max(number - turned.first_open, -1)
            angles[f] = turned.angles[max(number - turned.first_kept, 0)]
            state[f], shakes[f] = frames.state[r, j], frames.shakes[r, j]
            f += 1
    ends, olders, newers, claimed, doubts = _heard(rows.comparisons, told, D)
    expected, uncertain, other_expected, other_uncertain = _expected(rows.explained, told)
    explained = rows.explained
    return window_kernels.Problem(
        sizes, counts, times, numbers, angles, state, shakes, expected, uncertain, rates, informations,
        explained.others[told], explained.rates[told], other_expected, other_uncertain, explained.costs[told],
        explained.is_sudden[told], ends, olders, newers, claimed, doubts,
    )  # fmt: skip


@njit(cache=True, nogil=True)
@typing.no_type_check
def _heard(comparisons, told, D):
    """Lay comparisons one after the other, and what was measured in arrays of its own."""
    M = comparisons.counts[told].sum()
    ends, points = np.empty((M, 2), np.int64), np.empty((2, M, D))
    squares = np.empty((2, M, D, D))
    counts, c = comparisons.counts, np.int64(0)  # not a literal; see window_kernels
    for r in told:
        for m in range(counts[r]):
            for s in range(2):
                ends[c, s] = comparisons.ends[r, m, s]
                for d in range(D):
                    points[s, c, d] = comparisons.measured[r, m, s * D + d]
                    for e in range(D):
                        squares[s, c, d, e] = comparisons.measured[r, m, 2 * D + (s * D + d) * D + e]
            c += 1
    return ends, points[0], points[1], squares[0], squares[1]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _expected(explained, told):
    """Give the last steps that are expected, by either explanation, and their covariances."""
    K, D = len(told), explained.expected.shape[2]
    steps, covariances = np.empty((2, K, D)), np.empty((2, K, D, D))
    for k in range(K):
        for s in range(2):
            steps[s, k], covariances[s, k] = explained.expected[told[k], s], explained.expected_covariances[told[k], s]
    return steps[0], covariances[0], steps[1], covariances[1]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _put_back(rows, told, state, covariances, chosen):
    """Take what was found for known."""
    frames, explained, D, f = rows.frames, rows.explained, state.shape[2], np.int64(0)
    for k in range(len(told)):
        r = told[k]
        m = frames.sizes[r]
        frames.state[r, :m] = state[f : f + m]
        frames.covariance[r, : 2 * D * m, : 2 * D * m] = covariances[k, : 2 * D * m, : 2 * D * m]
        explained.rivals[r], explained.contrary[r] = chosen.rivals[k], chosen.contrary[k]
        explained.contrary_shares[r], explained.unsettled[r] = chosen.contrary_shares[k], chosen.unsettled[k]
        if chosen.is_other[k]:
            hypotheses.take_other(frames, explained, r)
        row_kernels.learn_rate(frames, r)
        f += m
