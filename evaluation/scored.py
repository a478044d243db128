"""Estimates paired with their truth, step by step: what a comparison hands to its tables and pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from evaluation.delay import Delay, delays, runs
from evaluation.dependability import lost_tracks
from evaluation.truth import TrueVelocity
from tracker.types import VelocityEstimate

Key = tuple[int, int]  # (track id, frame)


@dataclass(frozen=True)
class Scored:
    """The scored steps of one sequence by one estimator in one smoothing: one row a step.

    Attributes:
        velocity, true, covariance: in the comparison's frame.
        range_m: of the label's centre; bins go by it.
        class_name: the data set's own word.
        is_parked: the object stands still for its whole life.
        tracklet: number of the gap-free life that the step belongs to, unique in its sequence.
        age: frames of that life before the step's last one; 1 for the first step that there is.
        ms_per_transform: mean time of a step's motion, the smoothing's share included.
    """

    sequence: str
    estimator: str
    smoothing: str
    estimates: tuple[VelocityEstimate, ...]
    velocity: Float64[np.ndarray, "n 2"]
    true: Float64[np.ndarray, "n 2"]
    covariance: Float64[np.ndarray, "n 2 2"]
    range_m: Float64[np.ndarray, " n"]
    track_id: Int64[np.ndarray, " n"]
    class_name: tuple[str, ...]
    is_parked: Bool[np.ndarray, " n"]
    tracklet: Int64[np.ndarray, " n"]
    age: Int64[np.ndarray, " n"]
    ms_per_transform: float

    @cached_property
    def lost(self) -> Int64[np.ndarray, " lost"]:
        """The tracklets that are lost, judged over all their steps; see `dependability.lost_tracks`."""
        error = self.velocity - self.true
        return lost_tracks(np.hypot(error[:, 0], error[:, 1]), self.tracklet, self.age)

    @cached_property
    def delays(self) -> tuple[Delay, ...]:
        """How late each step of an object's acceleration was followed; means nothing unless the truth is exact."""
        times = np.array([e.timestamp for e in self.estimates])
        frames = np.array([e.frame for e in self.estimates], dtype=np.int64)
        return tuple(
            Delay(int(run[delay.row]), delay.seconds)
            for run in runs(self.tracklet, frames)
            for delay in delays(times[run], self.velocity[run], self.true[run])
        )


def pair_with_truth(
    name: tuple[str, str, str],
    tracklets: Sequence[Sequence[VelocityEstimate]],
    keys: Sequence[Key],
    truths: Mapping[Key, TrueVelocity],
    ms_per_transform: float,
) -> Scored:
    """Pick the estimates of the steps to score out of the tracklets, and put the truth beside them.

    Args:
        name: sequence, estimator and smoothing.
        tracklets: everything that was estimated: each a gap-free life, from its first frame on.
        keys: the steps to score; each has an estimate and a truth.
        truths: by step.
        ms_per_transform: see `Scored`.
    """
    sequence, estimator, smoothing = name
    places = {
        (e.track_id, e.frame): (e, number, age) for number, life in enumerate(tracklets) for age, e in enumerate(life)
    }
    found, true = [places[key] for key in keys], [truths[key] for key in keys]
    return Scored(
        sequence=sequence,
        estimator=estimator,
        smoothing=smoothing,
        estimates=tuple(e for e, _, _ in found),
        velocity=np.array([e.velocity for e, _, _ in found]).reshape(-1, 2),
        true=np.array([t.velocity for t in true]).reshape(-1, 2),
        covariance=np.array([e.covariance for e, _, _ in found]).reshape(-1, 2, 2),
        range_m=np.array([t.range_m for t in true], dtype=np.float64),
        track_id=np.array([e.track_id for e, _, _ in found], dtype=np.int64),
        class_name=tuple(t.class_name for t in true),
        is_parked=np.array([t.is_parked for t in true], dtype=bool),
        tracklet=np.array([number for _, number, _ in found], dtype=np.int64),
        age=np.array([age for _, _, age in found], dtype=np.int64),
        ms_per_transform=ms_per_transform,
    )
