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
    """Put each object's last two places where they explain best, in the plane (D = 2).

    The last one is where it is, or where one of its comparisons would have it: where all comparisons tell of a sudden
    change, each would be taken for an error, since it is far off.  Of the look before there may be two explanations
    (see `hypotheses`): it goes on from that by which the latest comparisons are likelier to be seen.  What a look told
    that is off counts for nothing.

    Args:
        x: unknowns in steady axes, padded (K, 2 n D); changed.
        windows: see `problem.Problem`; what looks told that are off is changed to nothing.
        rotations: from the axes of each frame to steady ones (N, D, D).
        tails: degrees of freedom of the errors of comparisons and of the motion.
    """
    K, times, sizes, others = len(windows.sizes), windows.times, windows.sizes, windows.others
    chosen, uncertain = nothing(K, 2), np.empty((2, 2))
    frame = first = np.int64(0)  # not a literal; see window_kernels
    for k in range(K):
        last = sizes[k] - 1
        at, f = 4 * last, frame + last
        seconds, has_other = times[f] - times[f - 1], not np.isnan(others[k, 0])
        before, other = (x[k, at - 4], x[k, at - 3]), (0.0, 0.0)
        if has_other:
            other = _turned(rotations, f - 1, others[k, 0], others[k, 1])
        is_there = windows.is_sudden[k]  # the look before shows the object where the other explanation has it
        shown = (before[0] + other[0], before[1] + other[1]) if is_there else before
        places, informations = _shown(x, k, frame, first, windows, rotations, shown)
        step = _turned(rotations, f - 1, windows.expected[k, 0], windows.expected[k, 1])
        axes_kernels.turn(windows.expected_covariances[k], rotations, f - 1, 2, uncertain)
        expected = before[0] + step[0], before[1] + step[1]
        place, likely, contrary, share, cost = _best(places, informations, expected, uncertain, seconds, tails)
        if has_other and len(places) == 1:
            chosen.unsettled[k] = 1.0 / (1.0 + np.exp(windows.other_costs[k]))
        elif has_other:
            step = _turned(rotations, f - 1, windows.other_expected[k, 0], windows.other_expected[k, 1])
            axes_kernels.turn(windows.other_covariances[k], rotations, f - 1, 2, uncertain)
            expected = before[0] + other[0] + step[0], before[1] + other[1] + step[1]
            places[0, 0], places[0, 1] = expected
            own = _best(places, informations, expected, uncertain, seconds, tails)
            worse = own[4] + windows.other_costs[k] - cost
            chosen.unsettled[k], chosen.is_other[k] = 1.0 / (1.0 + np.exp(abs(worse))), worse < 0.0
            if worse < 0.0:
                place, likely, contrary, share = own[0], own[1], own[2], own[3]
                x[k, at - 4], x[k, at - 3] = before[0] + other[0], before[1] + other[1]
                rate = _turned(rotations, f - 1, windows.other_rates[k, 0], windows.other_rates[k, 1])
                x[k, at - 2], x[k, at - 1] = rate
            if chosen.is_other[k] != is_there:
                _silence(windows, k, first, last - 1)
        _tell(chosen, k, rotations, f, (x[k, at - 4], x[k, at - 3]), (place, likely, contrary, share))
        _put(x, k, at, place, seconds)
        frame, first = frame + sizes[k], first + windows.counts[k]
    return chosen


@njit(inline="always")
@typing.no_type_check
def _tell(chosen, k, rotations, f, before, found):
    """Say what else the comparisons of an object tell, in the axes of its last frame; `found` by `_best`."""
    place, likely, contrary, share = found
    if likely != place:
        x, y = likely[0] - before[0], likely[1] - before[1]
        chosen.rivals[k, 0], chosen.rivals[k, 1] = _turned_back(rotations, f, x, y)
    x, y = contrary[0] - place[0], contrary[1] - place[1]
    chosen.contrary[k, 0], chosen.contrary[k, 1] = _turned_back(rotations, f, x, y)
    chosen.contrary_shares[k] = share


@njit(inline="always")
@typing.no_type_check
def _put(x, k, at, place, seconds):
    """Put an object's last place somewhere, with the rate that leads there, if it is not there already."""
    if place[0] != x[k, at] or place[1] != x[k, at + 1]:
        for d in range(2):
            x[k, at + d] = place[d]
            x[k, at + 2 + d] = 1.5 * (place[d] - x[k, at - 4 + d]) / seconds - 0.5 * x[k, at - 2 + d]


@njit(inline="always")
@typing.no_type_check
def _turned(rotations, f, x, y):
    """Turn a vector from the axes of a frame to steady ones."""
    return rotations[f, 0, 0] * x + rotations[f, 0, 1] * y, rotations[f, 1, 0] * x + rotations[f, 1, 1] * y


@njit(inline="always")
@typing.no_type_check
def _turned_back(rotations, f, x, y):
    """Turn a vector from steady axes to those of a frame."""
    return rotations[f, 0, 0] * x + rotations[f, 1, 0] * y, rotations[f, 0, 1] * x + rotations[f, 1, 1] * y


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
        places (n, 2) and informations (n, 2, 2); the first of these is none.
    """
    last, ends, n = windows.sizes[k] - 1, windows.ends, 1
    for c in range(first, first + windows.counts[k]):
        n += 1 if ends[c, 1] == last else 0
    places, informations = np.zeros((n, 2)), np.zeros((n, 2, 2))
    places[0, 0], places[0, 1] = x[k, 4 * last], x[k, 4 * last + 1]
    olders, newers, claimed, doubts = windows.olders, windows.newers, windows.informations, windows.doubts
    n, own = 1, np.empty((2, 2))
    for c in range(first, first + windows.counts[k]):
        if ends[c, 1] != last:
            continue
        older = ends[c, 0]
        for d in range(2):
            places[n, d] = shown[d] if older == last - 1 else x[k, 4 * older + d]
            for e in range(2):
                places[n, d] += (
                    rotations[frame + last, d, e] * newers[c, e] - rotations[frame + older, d, e] * olders[c, e]
                )
        claims.believe(claimed, doubts, c, 1.0, 2, own)
        axes_kernels.turn(own, rotations, frame + last, 2, informations[n])
        n += 1
    return places, informations


@njit(cache=True, nogil=True)
@typing.no_type_check
def _best(places, informations, expected, uncertain, seconds, tails):
    """Choose the likeliest among the present place, which is the first, and those of comparisons.

    Within reach is what is no farther than HARDEST allows in that time, beside three standard deviations of the
    expected place in that direction.

    Returns:
        the likeliest place within reach, that of all, that of those apart from the first of these (NaN where there is
        none) and its probability beside that, and the negative logarithm of the first one's likelihood.
    """
    n, best, likely, contrary, costs = len(places), 0, 0, -1, np.empty(len(places))
    for i in range(n):
        costs[i], is_within = _cost(places, i, informations, expected, uncertain, seconds, tails)
        best = i if is_within and costs[i] < costs[best] else best
        likely = i if costs[i] < costs[likely] else likely
    least, a, b, c = costs[best] + UNLIKELY, 0.0, 0.0, 0.0
    for i in range(1, n):
        x, y = places[i, 0] - places[best, 0], places[i, 1] - places[best, 1]
        if costs[i] < least and x * x + y * y > APART**2:
            contrary, least = i, costs[i]
        a, b, c = a + informations[i, 0, 0], b + informations[i, 0, 1], c + informations[i, 1, 1]
    # how much wider than the comparisons' own the likelihood of what they tell is: nothing, where they tell nothing;
    # |1 + U I| = 1 + tr U I + |U| |I|
    p, q, r = uncertain[0, 0], uncertain[0, 1], uncertain[1, 1]
    wide = np.log(1.0 + p * a + 2.0 * q * b + r * c + (p * r - q * q) * (a * c - b * b))
    share = 0.0 if contrary < 0 else 1.0 / (1.0 + np.exp(least - costs[best]))
    there = (places[contrary, 0], places[contrary, 1]) if contrary >= 0 else (np.nan, np.nan)
    found = (places[best, 0], places[best, 1]), (places[likely, 0], places[likely, 1])
    return found[0], found[1], there, share, costs[best] + 0.5 * wide


@njit(cache=True, nogil=True)
@typing.no_type_check
def _cost(places, i, informations, expected, uncertain, seconds, tails):  # noqa: PLR0913
    """Give the negative logarithm of a place's likelihood, and whether it is within reach; see `_best`."""
    x, y = places[i, 0] - expected[0], places[i, 1] - expected[1]
    p, q, r = uncertain[0, 0], uncertain[0, 1], uncertain[1, 1]
    spread, length = p * x * x + 2.0 * q * x * y + r * y * y, np.sqrt(x * x + y * y)
    is_within = i == 0 or length**2 <= HARDEST * seconds**2 * length + 3.0 * np.sqrt(spread)
    cost = heavy_tails.cost(tails[1], 4, (r * x * x - 2.0 * q * x * y + p * y * y) / (p * r - q * q))
    for j in range(1, len(places)):
        x, y = places[i, 0] - places[j, 0], places[i, 1] - places[j, 1]
        apart = informations[j, 0, 0] * x * x + 2.0 * informations[j, 0, 1] * x * y + informations[j, 1, 1] * y * y
        cost += heavy_tails.cost(tails[0], 2, apart)
    return cost, is_within


@njit(cache=True, nogil=True)
@typing.no_type_check
def _silence(windows, k, first, frame):
    """Let what a look at object k told count for nothing; its comparisons begin with `first`."""
    informations = windows.informations
    for c in range(first, first + windows.counts[k]):
        if windows.ends[c, 0] == frame or windows.ends[c, 1] == frame:
            for d in range(2):
                informations[c, d, 0] = informations[c, d, 1] = 0.0
