"""Where the search for a window's most likely places starts: least squares find the nearest maximum only.

Behind `window_kernels`, compiled by numba.
"""

import typing
from typing import NamedTuple

import numpy as np
from numba import njit

from tracker.estimators.fused import heavy_tails

HARDEST = 50.0  # acceleration that is thought of, as in a crash, beside what is not known of the motion [m/s^2]


class Chosen(NamedTuple):
    """What was chosen for K objects.

    Attributes:
        rivals: the last steps that would be likelier if any acceleration were possible, in the last frames' axes
            (K, D); NaN where there is none.
        is_other: the other explanation of the look before is taken (K).
        unsettled: probability of the explanation that is not (K).
    """

    rivals: np.ndarray
    is_other: np.ndarray
    unsettled: np.ndarray


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
        windows: see `window_kernels.Windows`; what looks told that are off is changed to nothing.
        rotations: from the axes of each frame to steady ones (N, D, D).
        tails: degrees of freedom of the errors of comparisons and of the motion.
    """
    K, D = len(windows.sizes), rotations.shape[1]
    chosen = Chosen(np.full((K, D), np.nan), np.zeros(K, np.bool_), np.zeros(K))
    frame = first = 0
    for k in range(K):
        last = windows.sizes[k] - 1
        at, f = 2 * D * last, frame + last
        R, R_before, seconds = rotations[f], rotations[f - 1], windows.times[f] - windows.times[f - 1]
        other = np.zeros(D) if np.isnan(windows.others[k, 0]) else R_before @ windows.others[k]
        shown = x[k, at - 2 * D : at - D] + (other if windows.is_sudden[k] else np.zeros(D))
        places, informations = _shown(x[k], k, (frame, first), windows, rotations, shown)
        expected = x[k, at - 2 * D : at - D] + R_before @ windows.expected[k]
        uncertain = R_before @ windows.expected_covariances[k] @ R_before.T
        place, likely, cost = _best(places, informations, expected, uncertain, HARDEST * seconds**2, tails)
        if not np.isnan(windows.others[k, 0]):
            places[0] = x[k, at - 2 * D : at - D] + other + R_before @ windows.other_expected[k]
            uncertain = R_before @ windows.other_covariances[k] @ R_before.T
            own = _best(places, informations, places[0], uncertain, HARDEST * seconds**2, tails)
            worse = own[2] + windows.other_costs[k] - cost
            chosen.unsettled[k], chosen.is_other[k] = 1.0 / (1.0 + np.exp(np.abs(worse))), worse < 0.0
            if worse < 0.0:
                place, likely = own[0], own[1]
                x[k, at - 2 * D : at - D] += other
                x[k, at - D : at] = R_before @ windows.other_rates[k]
            if chosen.is_other[k] != windows.is_sudden[k]:
                _silence(windows, k, first, last - 1)
        before = x[k, at - 2 * D : at]
        if np.any(likely != place):
            chosen.rivals[k] = R.T @ (likely - before[:D])
        if np.any(place != x[k, at : at + D]):
            x[k, at : at + D] = place
            x[k, at + D : at + 2 * D] = 1.5 * (place - before[:D]) / seconds - 0.5 * before[D:]
        frame, first = frame + windows.sizes[k], first + windows.counts[k]
    return chosen


@njit(cache=True, nogil=True)
@typing.no_type_check
def _shown(x, k, numbers, windows, rotations, shown):
    """Give the present last place, and those where comparisons of the last frame would have it, with informations.

    Args:
        x: unknowns of object k.
        k: number of the object.
        numbers: of its first frame and comparison.
        windows, rotations: see `choose`.
        shown: where the look before the last shows the object; it need not be there.
    """
    D, last, (frame, first) = rotations.shape[1], windows.sizes[k] - 1, numbers
    R = rotations[frame + last]
    places, informations = [x[2 * D * last : 2 * D * last + D].copy()], [np.eye(D)]
    for c in range(first, first + windows.counts[k]):
        if windows.ends[c, 1] == last:
            older = windows.ends[c, 0]
            start = shown if older == last - 1 else x[2 * D * older : 2 * D * older + D]
            places.append(start - rotations[frame + older] @ windows.olders[c] + R @ windows.newers[c])
            informations.append(R @ windows.informations[c] @ R.T)
    return places, informations


@njit(cache=True, nogil=True)
@typing.no_type_check
def _best(places, informations, expected, uncertain, farthest, tails):
    """Choose the likeliest among the present place, which is the first, and those of comparisons.

    Within reach is what is no farther than `farthest` beside three standard deviations of the expected place in that
    direction.

    Returns:
        the likeliest place within reach, that of all, and the negative logarithm of the former's likelihood.
    """
    lowest, least, best, freest, D = np.inf, np.inf, 0, 0, len(expected)
    own = np.linalg.inv(uncertain)
    for i in range(len(places)):
        off = places[i] - expected
        is_within = i == 0 or off @ off <= farthest * np.sqrt(off @ off) + 3.0 * np.sqrt(off @ uncertain @ off)
        total = heavy_tails.cost(tails[1], 2 * D, off @ own @ off)
        for j in range(1, len(places)):
            off = places[i] - places[j]
            total += heavy_tails.cost(tails[0], D, off @ informations[j] @ off)
        if total < least:
            least, freest = total, i
        if total < lowest and is_within:
            lowest, best = total, i
    return places[best], places[freest], lowest + 0.5 * np.log(np.linalg.det(uncertain))


@njit(cache=True, nogil=True)
@typing.no_type_check
def _silence(windows, k, first, frame):
    """Let what a look at object k told count for nothing; its comparisons begin with `first`."""
    for c in range(first, first + windows.counts[k]):
        if windows.ends[c, 0] == frame or windows.ends[c, 1] == frame:
            windows.informations[c] = 0.0
