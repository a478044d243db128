"""The latest looks at a frame's objects beside earlier ones of theirs, and what objects hear of such pairs."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from tracker.estimators.fused import pair_kernels
from tracker.estimators.fused.look import Look
from tracker.estimators.fused.pair_kernels import Doubts, Found, Pairs
from tracker.estimators.fused.track import Track, Tracks
from tracker.estimators.fused.window import Rows

Numbers = Float64[np.ndarray, " m"]
Squares = Float64[np.ndarray, "m 2 2"]
Expected = tuple[Bool[np.ndarray, " m"], Squares, Numbers, Squares]


def ascending(lags: tuple[int, ...]) -> Int64[np.ndarray, " l"]:
    """Give lags, each once, the shortest first."""
    return np.array(sorted(set(lags)), dtype=np.int64)


def paired(known: Tracks, at: Rows, lags: Int64[np.ndarray, " l"], others: Int64[np.ndarray, " o"]) -> Pairs:
    """Pair the latest looks at objects with earlier ones; where there are too few yet, with the first.

    Args:
        known: of the objects.
        at: their rows.
        lags: how many looks ago; `ascending`.
        others: those of other sources, with which they share the errors of the latest looks.
    """
    places, turns = known.places.rows, known.turns.rows
    state = places.frames.sizes, places.frames.state, turns.frames.state
    pairs: Pairs = pair_kernels.paired(*state, places.comparisons, at, lags, others)
    return pairs


def looks_of(tracks: Sequence[Track], looks: Sequence[Look], pairs: Pairs) -> list[tuple[Look, Look]]:
    """Give the looks of pairs, the earlier one first; `looks` are the latest ones at the tracks."""
    jobs = zip(pairs.owners.tolist(), pairs.lags.tolist(), strict=True)
    return [(tracks[k].looks[-lag], looks[k]) for k, lag in jobs]


def hear(known: Tracks, pairs: Pairs, found: Found, doubts: Doubts) -> None:
    """Let objects hear what comparisons of pairs tell, with the errors that they have beside those they claim."""
    begin = 0
    while True:
        places, turns = known.places.rows, known.turns.rows
        windows = places.frames, places.comparisons, turns.frames.is_off, turns.comparisons
        begin = pair_kernels.hear(*windows, known.looks, pairs, found, doubts, begin)
        if begin == len(pairs.lags):
            return
        known.places.make_room_for_comparisons()
        known.turns.make_room_for_comparisons()


def expected(known: Tracks, pairs: Pairs, search: tuple[float, float], swing: float) -> Expected:
    """Say how surely it is known where the earlier looks of pairs are in the latest.

    Args:
        known: of the objects.
        pairs: of looks at these.
        search: standard deviation of an expected place that is always searched [m]; factor of covariances.
        swing: variance of the axes' own latest turn, with which objects swing [rad^2].

    Returns:
        see `pair_kernels.expected`.
    """
    places, turns = known.places.rows, known.turns.rows
    windows = places.frames.sizes, places.frames.covariance, turns.frames.covariance
    told = places.comparisons.counts, places.explained.contrary
    found: Expected = pair_kernels.expected(*windows, *told, pairs, *search, swing)
    return found
