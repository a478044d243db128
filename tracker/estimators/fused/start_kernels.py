"""Where the search for a window's most likely places starts: least squares find the nearest maximum only.

Behind `window_kernels`, compiled by numba.
"""

import typing
from typing import NamedTuple

import numpy as np
from numba import njit

from tracker.estimators.fused import axes_kernels, claims, heavy_tails

APART = 0.3  # of places that shapes would not find from each other [m]
UNLIKELY = 9.0  # difference of negative logarithms from which a place is no more thought of
HARDEST = 50.0  # acceleration that is thought of, as in a crash, beside what is not known of the motion [m/s^2]


class Chosen(NamedTuple):
    """What was chosen for K objects.

    Attributes:
        rivals: the last steps that would be likelier if any acceleration were possible, in the last frames' axes
            (K, D); NaN where there is none.
        contrary: the likeliest places apart from the last ones, relative to these, in the same axes (K, D); NaN where
            no comparison tells of one that is not too unlikely.
        contrary_shares: probability of these, beside the last ones (K).
        is_other: the other explanation of the look before is taken (K).
        unsettled: probability of the explanation that is not (K).
    """

    rivals: np.ndarray
    contrary: np.ndarray
    contrary_shares: np.ndarray
    is_other: np.ndarray
    unsettled: np.ndarray


@njit(cache=True, nogil=True)
@typing.no_type_check
def nothing(K, D):
    """Give what is chosen where there is no choice."""
    return Chosen(np.full((K, D), np.nan), np.full((K, D), np.nan), np.zeros(K), np.zeros(K, np.bool_), np.zeros(K))


@njit(cache=True, nogil=True)
@typing.no_type_check
def choose(x, windows, rotations, tails):
    """Put each object's last two places where they explain best.

    The last one is where it is, or where one of its comparisons would have it: where all comparisons tell of a sudden
    change, each would be taken for an error, since it is far off.  Of the look before there may be two explanations
    (see `hypotheses`): it goes on from that by which the latest comparisons are likelier to be seen.  What a look told
    that is off counts for nothing.

    Args:
        x: unknowns in steady axes, padded (K, 2 n D); changed.
        windows: see `window_kernels.Problem`; what looks told that are off is changed to nothing.
        rotations: from the axes of each frame to steady ones (N, D, D).
        tails: degrees of freedom of the errors of comparisons and of the motion.
    """
    K, D = len(windows.sizes), rotations.shape[1]
    chosen = nothing(K, D)
    frame = first = np.int64(0)  # not a literal; see window_kernels
    for k in range(K):
        last = windows.sizes[k] - 1
        at, f = 2 * D * last, frame + last
        R, R_before, seconds = rotations[f], rotations[f - 1], windows.times[f] - windows.times[f - 1]
        other = np.zeros(D) if np.isnan(windows.others[k, 0]) else R_before @ windows.others[k]
        shown = x[k, at - 2 * D : at - D] + (other if windows.is_sudden[k] else np.zeros(D))
        places, informations = _shown(x, k, frame, first, windows, rotations, shown)
        expected = x[k, at - 2 * D : at - D] + R_before @ windows.expected[k]
        uncertain = R_before @ windows.expected_covariances[k] @ R_before.T
        place, likely, contrary, share, cost = _best(
            places, informations, expected, uncertain, HARDEST * seconds**2, tails
        )
        if not np.isnan(windows.others[k, 0]) and len(places) == 1:
            chosen.unsettled[k] = 1.0 / (1.0 + np.exp(windows.other_costs[k]))
        elif not np.isnan(windows.others[k, 0]):
            places[0] = x[k, at - 2 * D : at - D] + other + R_before @ windows.other_expected[k]
            uncertain = R_before @ windows.other_covariances[k] @ R_before.T
            own = _best(places, informations, places[0], uncertain, HARDEST * seconds**2, tails)
            worse = own[4] + windows.other_costs[k] - cost
            chosen.unsettled[k], chosen.is_other[k] = 1.0 / (1.0 + np.exp(np.abs(worse))), worse < 0.0
            if worse < 0.0:
                place, likely, contrary, share = own[0], own[1], own[2], own[3]
                x[k, at - 2 * D : at - D] += other
                x[k, at - D : at] = R_before @ windows.other_rates[k]
            if chosen.is_other[k] != windows.is_sudden[k]:
                _silence(windows, k, first, last - 1)
        before = x[k, at - 2 * D : at]
        if np.any(likely != place):
            chosen.rivals[k] = R.T @ (likely - before[:D])
        chosen.contrary[k], chosen.contrary_shares[k] = R.T @ (contrary - place), share
        if np.any(place != x[k, at : at + D]):
            x[k, at : at + D] = place
            x[k, at + D : at + 2 * D] = 1.5 * (place - before[:D]) / seconds - 0.5 * before[D:]
        frame, first = frame + windows.sizes[k], first + windows.counts[k]
    return chosen


@njit(cache=True, nogil=True)
@typing.no_type_check
def _shown(x, k, frame, first, windows, rotations, shown):  # noqa: PLR0913
    """Give the present last place, and those where comparisons of the last frame would have it, with informations.

    Args:
        x: unknowns of all objects.
        k: number of the object.
        frame, first: numbers of its first frame and comparison.
        windows, rotations: see `choose`.
        shown: where the look before the last shows the object; it need not be there.

    Returns:
        places (n, D) and informations (n, D, D); the first of these is none.
    """
    D, last = rotations.shape[1], windows.sizes[k] - 1
    ends, n = windows.ends, 1
    for c in range(first, first + windows.counts[k]):
        n += 1 if ends[c, 1] == last else 0
    places, informations = np.zeros((n, D)), np.zeros((n, D, D))
    for d in range(D):
        places[0, d] = x[k, 2 * D * last + d]
    olders, newers, claimed, doubts = windows.olders, windows.newers, windows.informations, windows.doubts
    n, own = 1, np.empty((D, D))
    for c in range(first, first + windows.counts[k]):
        if ends[c, 1] != last:
            continue
        older, f = ends[c, 0], frame + ends[c, 0]
        for d in range(D):
            places[n, d] = shown[d] if older == last - 1 else x[k, 2 * D * older + d]
            for e in range(D):
                places[n, d] += rotations[frame + last, d, e] * newers[c, e] - rotations[f, d, e] * olders[c, e]
        claims.believe(claimed, doubts, c, 1.0, D, own)
        axes_kernels.turn(own, rotations, frame + last, D, informations[n])
        n += 1
    return places, informations


@njit(cache=True, nogil=True)
@typing.no_type_check
def _best(places, informations, expected, uncertain, farthest, tails):
    """Choose the likeliest among the present place, which is the first, and those of comparisons.

    Within reach is what is no farther than `farthest` beside three standard deviations of the expected place in that
    direction.

    Returns:
        the likeliest place within reach, that of all, that of those apart from the first of these (NaN where there is
        none) and its probability beside that, and the negative logarithm of the first one's likelihood.
    """
    n, D = places.shape
    costs, is_within = _costs(places, informations, expected, uncertain, farthest, tails)
    best = np.argmin(np.where(is_within, costs, np.inf))
    contrary, least = -1, costs[best] + UNLIKELY
    for i in range(1, n):
        length2 = 0.0
        for d in range(D):
            length2 += (places[i, d] - places[best, d]) ** 2
        if costs[i] < least and length2 > APART**2:
            contrary, least = i, costs[i]
    # how much wider than the comparisons' own the likelihood of what they tell is: nothing, where they tell nothing
    wide = np.log(np.linalg.det(np.eye(D) + uncertain @ informations.sum(axis=0)))
    share = 0.0 if contrary < 0 else 1.0 / (1.0 + np.exp(least - costs[best]))
    there = places[contrary].copy() if contrary >= 0 else np.full(D, np.nan)
    return places[best].copy(), places[np.argmin(costs)].copy(), there, share, costs[best] + 0.5 * wide


@njit(cache=True, nogil=True)
@typing.no_type_check
def _costs(places, informations, expected, uncertain, farthest, tails):
    """Give the negative logarithm of each place's likelihood, and whether it is within reach; see `_best`."""
    (n, D), own = places.shape, np.linalg.inv(uncertain)
    costs, is_within = np.zeros(n), np.ones(n, np.bool_)
    for i in range(n):
        length2 = spread = distance = 0.0
        for d in range(D):
            for e in range(D):
                p, q = places[i, d] - expected[d], places[i, e] - expected[e]
                spread, distance = spread + p * uncertain[d, e] * q, distance + p * own[d, e] * q
            length2 += (places[i, d] - expected[d]) ** 2
        is_within[i] = i == 0 or length2 <= farthest * np.sqrt(length2) + 3.0 * np.sqrt(spread)
        costs[i] = heavy_tails.cost(tails[1], 2 * D, distance)
        for j in range(1, n):
            costs[i] += heavy_tails.cost(tails[0], D, _apart(places, i, j, informations, D))
    return costs, is_within


@njit(cache=True, nogil=True)
@typing.no_type_check
def _apart(places, i, j, informations, D):
    """Give how far place i is from place j, by the information of that: a squared distance."""
    distance = 0.0
    for d in range(D):
        for e in range(D):
            distance += (places[i, d] - places[j, d]) * informations[j, d, e] * (places[i, e] - places[j, e])
    return distance


@njit(cache=True, nogil=True)
@typing.no_type_check
def _silence(windows, k, first, frame):
    """Let what a look at object k told count for nothing; its comparisons begin with `first`."""
    for c in range(first, first + windows.counts[k]):
        if windows.ends[c, 0] == frame or windows.ends[c, 1] == frame:
            windows.informations[c] = 0.0
