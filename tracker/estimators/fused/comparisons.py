"""The latest looks at a frame's objects beside earlier ones of theirs: what differs, and what that leaves unsure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64, Int64

from registration import planar
from tracker.estimators.fused.look import Look
from tracker.estimators.fused.track import Track

RIGHT_THERE = 1e-9  # of points seen from 1 m: those right at the sensor are none

Numbers = Float64[np.ndarray, " m"]
Indices = Int64[np.ndarray, " m"]
Vectors = Float64[np.ndarray, "m 2"]
Squares = Float64[np.ndarray, "m 2 2"]


@dataclass(frozen=True, slots=True)
class Pairs:
    """The latest looks at K objects, each beside some of the earlier ones, M pairs in all, object by object.

    Attributes:
        owners: which object each is of.
        lags: how many looks ago the earlier one was.
        before, now: both looks.
        olders, newers: where the object's reference point was taken to be at both, before they are compared (M, 2) [m].
        turns: by how much its heading is taken to have changed [rad].
        n_told: how many comparisons of earlier frames there are with the earlier look, as the older.
    """

    owners: Indices
    lags: Indices
    before: Sequence[Look]
    now: Sequence[Look]
    olders: Vectors
    newers: Vectors
    turns: Numbers
    n_told: Indices

    def __len__(self) -> int:
        return len(self.lags)


@dataclass(frozen=True, slots=True)
class Doubts:
    """What makes comparisons less sure than they claim to be.

    Attributes:
        by_change: standard deviation where looks share nothing (M) [m]; it goes with the square of the share of points
            that came or went, beside those that the range explains.
        by_turn: along the way, for each radian that the object turned against the line of sight [m/rad].
        by_way: along the way, as a share of it (M).
        by_point: of where an object is by a single point of it; by n points, an n-th of that [m].
        n_lags: comparisons of each object's latest look, of all sources (K).
    """

    by_change: Numbers
    by_turn: float
    by_way: Numbers
    by_point: float
    n_lags: Int64[np.ndarray, " k"]


def paired(tracks: Sequence[Track], looks: Sequence[Look], lags: tuple[int, ...]) -> Pairs:
    """Pair the latest looks of tracks, one at least, with earlier ones; where there are too few yet, with the first."""
    jobs = [(k, lag) for k, track in enumerate(tracks) for lag in lags_of(len(track.looks), lags)]
    owners, back = np.array(jobs, dtype=np.int64).reshape(-1, 2).T
    last = np.cumsum([len(track.place) for track in tracks]) - 1
    places = np.concatenate([track.place.state[:, 0] for track in tracks])
    turns = np.concatenate([track.turn.state[:, 0, 0] for track in tracks])
    newest = last[owners]
    return Pairs(
        owners=owners,
        lags=back,
        before=[tracks[k].looks[-lag] for k, lag in jobs],
        now=[looks[k] for k, _ in jobs],
        olders=places[newest - back],
        newers=places[newest],
        turns=turns[newest] - turns[newest - back],
        n_told=np.array([tracks[k].place.n_told(lag) for k, lag in jobs], dtype=np.int64),
    )


@cache
def lags_of(n_looks: int, lags: tuple[int, ...]) -> tuple[int, ...]:
    """Say how many looks ago a track of so many looks is compared; the first one stands for those before it."""
    return tuple(sorted({min(lag, n_looks) for lag in lags}))


def doubted(pairs: Pairs, doubts: Doubts) -> Squares:
    """Give the covariances that looks which differ, few points and a long way add to comparisons [m^2].

    All comparisons with a look share the error that it has since it shows few points, or fewer than the other: it
    counts for so many times its variance as there are comparisons, so that many are worth no more than one.
    """
    table = np.array(
        [
            (a.n_points, b.n_points, a.n_from_1m, b.n_from_1m, *a.sensor.place, *b.sensor.place)
            for a, b in zip(pairs.before, pairs.now, strict=True)
        ]
    )
    (n_before, n_now, before, now), sensors = table[:, :4].T, table[:, 4:].reshape(-1, 2, 2)
    older, newer = np.sqrt(1.0 + pairs.n_told), np.sqrt(doubts.n_lags[pairs.owners])
    share = (1.0 - np.minimum(before, now) / np.maximum(np.maximum(before, now), RIGHT_THERE)) ** 2
    changed = doubts.by_change * share * np.where(before < now, older, newer)
    way = pairs.newers - pairs.olders - (sensors[:, 1] - sensors[:, 0])
    length = np.hypot(way[:, 0], way[:, 1])
    by_turn = doubts.by_turn * _turned(pairs, sensors) / np.where(length > 0.0, length, math.inf)
    along = np.hypot(doubts.by_way, by_turn)[:, None] * way
    everywhere = changed**2 + (older * doubts.by_point / n_before) ** 2 + (newer * doubts.by_point / n_now) ** 2
    return everywhere[:, None, None] * np.eye(2) + along[:, :, None] * along[:, None, :]


def _turned(pairs: Pairs, sensors: Float64[np.ndarray, "m 2 2"]) -> Numbers:
    """Say by how much objects have turned against the line of sight [rad]; the sensor's places are those at both."""
    (x, y), (p, q) = (pairs.newers - sensors[:, 1]).T, (pairs.olders - sensors[:, 0]).T
    return np.abs(planar.wrap_all(np.arctan2(y, x) - np.arctan2(q, p) - pairs.turns))
