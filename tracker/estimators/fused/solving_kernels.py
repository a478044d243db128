"""Windows that have comparisons, taken out of their rows, solved for, and put back; compiled by numba.

For how these are compiled, and what that asks for after a change, see `window_kernels`.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import hypotheses, motion_kernels, row_kernels, window_kernels
from tracker.estimators.fused.problem import Problem


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
    told, n = np.empty(len(at), np.int64), 0
    for k in range(len(at)):
        if rows.comparisons.counts[at[k]] > 0:
            told[n] = at[k]
            n += 1
    if n == 0:
        return False, axes.angles, axes.rates, 0.0
    problem = _taken(rows, told[:n], turned)
    state, covariances, angles, rates, variance, chosen = window_kernels.solve(problem, axes, densities, tails, claimed)
    _put_back(rows, told[:n], state, covariances, chosen)
    return True, angles, rates, variance


@njit(inline="always")
@typing.no_type_check
def _taken(rows, told, turned):
    """Lay windows one after the other, as `problem.Problem`; by single numbers, which compiles fastest."""
    frames, D, K = rows.frames, rows.frames.state.shape[3], len(told)
    sizes, counts, N, M = np.empty(K, np.int64), np.empty(K, np.int64), np.int64(0), np.int64(0)
    for k in range(K):
        sizes[k], counts[k] = frames.sizes[told[k]], rows.comparisons.counts[told[k]]
        N, M = N + sizes[k], M + counts[k]
    times, numbers, angles = np.empty(N), np.empty(N, np.int64), np.empty(N)
    state, shakes, f = np.empty((N, 2, D)), np.empty((N, D, D)), 0
    for k in range(K):
        r = told[k]
        for j in range(sizes[k]):
            number = frames.axes[r, j]
            times[f], numbers[f] = frames.times[r, j], max(number - turned.first_open, -1)
            angles[f] = turned.angles[max(number - turned.first_kept, 0)]
            for d in range(D):
                state[f, 0, d], state[f, 1, d] = frames.state[r, j, 0, d], frames.state[r, j, 1, d]
                for e in range(D):
                    shakes[f, d, e] = frames.shakes[r, j, d, e]
            f += 1
    ends, olders, newers, claimed, doubts = _heard(rows.comparisons, told, M, D)
    vectors, squares = np.empty((5, K, D)), np.empty((3, K, D, D))
    costs, is_sudden = np.empty(K), np.empty(K, np.bool_)
    for k in range(K):
        _explain(frames, rows.explained, told[k], vectors, squares, k)
        costs[k], is_sudden[k] = rows.explained.costs[told[k]], rows.explained.is_sudden[told[k]]
    return Problem(
        sizes, counts, times, numbers, angles, state, shakes, vectors[0], squares[0], vectors[2], squares[2],
        vectors[3], vectors[4], vectors[1], squares[1], costs, is_sudden, ends, olders, newers, claimed, doubts,
    )  # fmt: skip


@njit(inline="always")
@typing.no_type_check
def _explain(frames, explained, r, vectors, squares, k):
    """Fill in the steps that are expected by either explanation, and covariances; rates at the first frame, and their
    information; place and rate by the other explanation."""
    D = vectors.shape[2]
    information = motion_kernels.inverse(frames.rate_covariances[r, 0], D)
    for d in range(D):
        vectors[0, k, d], vectors[1, k, d] = explained.expected[r, 0, d], explained.expected[r, 1, d]
        vectors[2, k, d] = frames.rates[r, 0, d]
        vectors[3, k, d], vectors[4, k, d] = explained.others[r, d], explained.rates[r, d]
        for e in range(D):
            squares[0, k, d, e] = explained.expected_covariances[r, 0, d, e]
            squares[1, k, d, e] = explained.expected_covariances[r, 1, d, e]
            squares[2, k, d, e] = information[d, e]


@njit(inline="always")
@typing.no_type_check
def _heard(comparisons, told, M, D):
    """Lay comparisons one after the other, M in all, and what was measured in arrays of its own."""
    ends, points, squares = np.empty((M, 2), np.int64), np.empty((2, M, D)), np.empty((2, M, D, D))
    counts, c = comparisons.counts, 0
    for k in range(len(told)):
        r = told[k]
        for m in range(counts[r]):
            for s in range(2):
                ends[c, s] = comparisons.ends[r, m, s]
                for d in range(D):
                    points[s, c, d] = comparisons.measured[r, m, s * D + d]
                    for e in range(D):
                        squares[s, c, d, e] = comparisons.measured[r, m, 2 * D + (s * D + d) * D + e]
            c += 1
    return ends, points[0], points[1], squares[0], squares[1]


@njit(inline="always")
@typing.no_type_check
def _put_back(rows, told, state, covariances, chosen):
    """Take what was found for known."""
    frames, explained, D, f = rows.frames, rows.explained, state.shape[2], 0
    for k in range(len(told)):
        r, size = told[k], frames.sizes[told[k]]
        for j in range(size):
            for d in range(D):
                frames.state[r, j, 0, d], frames.state[r, j, 1, d] = state[f, 0, d], state[f, 1, d]
            f += 1
        for p in range(2 * D * size):
            for q in range(2 * D * size):
                frames.covariance[r, p, q] = covariances[k, p, q]
        for d in range(D):
            explained.rivals[r, d], explained.contrary[r, d] = chosen.rivals[k, d], chosen.contrary[k, d]
        explained.contrary_shares[r], explained.unsettled[r] = chosen.contrary_shares[k], chosen.unsettled[k]
        if chosen.is_other[k]:
            hypotheses.take_other(frames, explained, r)
        row_kernels.learn_rate(frames, r)
