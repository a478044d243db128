"""What is known of the velocities of a frame's objects, over the steps of their windows."""

from collections.abc import Sequence, Set
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from tracker.ego_motion.sweep import LEAST_SHARE
from tracker.estimators.contract import Measurement
from tracker.estimators.fused import step_kernels
from tracker.estimators.fused.row_kernels import SHORTEST_STEP
from tracker.estimators.fused.sensor import SWEEP
from tracker.estimators.fused.track import Tracks
from tracker.types import EstimateStatus, Hindsight

Vectors = Float64[np.ndarray, "n 2"]
Squares = Float64[np.ndarray, "n 2 2"]
Numbers = Float64[np.ndarray, " n"]
Indices = Int64[np.ndarray, " n"]


class Steps(NamedTuple):
    """The velocities of the centres of K objects over the steps of their windows, N in all, one object after the other.

    Attributes:
        owners: which object each step is of (N), ascending; each has one at least, the latest last.
        ends: where each object's steps end (K): the number of the first one of the next.
        frames: number of the frame that each step leads to, in its sequence.
        numbers: the same among the frames that the estimator was shown.
        lengths: how many of these each step takes; more than one where nothing was seen of the object in between.
        places: of the centre half-way [m].
        velocities: [m/s].
        covariances: of these, but for the doubts.
        doubts: covariances that they have beside that, since a look may be off as a whole.
        slips: probability that each velocity is off since clouds of few points were laid on the wrong parts, and the
            variance that it then has beside its own [m^2/s^2].
        by_clock: what velocities are to be multiplied by, to be displacements over the time that the clock tells.
        centers: where each object's centre is at last (K, 2) [m].
        yaw_rates: of each over its last step (K) [rad/s].
    """

    owners: Indices
    ends: Int64[np.ndarray, " k"]
    frames: Indices
    numbers: Indices
    lengths: Indices
    places: Vectors
    velocities: Vectors
    covariances: Squares
    doubts: Squares
    slips: Vectors
    by_clock: Numbers
    centers: Float64[np.ndarray, "k 2"]
    yaw_rates: Float64[np.ndarray, " k"]

    def told(self) -> "Steps":
        """Give velocities by the clock, and add the doubts to their covariances."""
        factors = self.by_clock[:, None]
        covariances = factors[:, None] ** 2 * (self.covariances + self.doubts)
        return self._replace(velocities=factors * self.velocities, covariances=covariances)


def read(known: Tracks, at: Int64[np.ndarray, " k"], share: float) -> Steps:
    """Read what is known now of each step of objects.

    Over the time between frames, what crosses the direction in which sweeps end has no velocity: its label moves
    for anything between no time and twice as long.

    Args:
        known: of objects.
        at: rows of K of these, one at least, with two frames or more.
        share: that errors have of the windows' covariances.
    """
    places, turns = known.places, known.turns
    motions = float(places.model.density), float(places.tails[1]), float(turns.model.density), float(turns.tails[1])
    sweeps = LEAST_SHARE, SWEEP.period, SHORTEST_STEP
    frames = places.rows.frames, turns.rows.frames
    return Steps(*step_kernels.read(*frames, known.looks, known.centers, at, motions, share, sweeps))


def measurements(keys: Sequence[int], found: Steps, measured: Set[int]) -> dict[int, Measurement]:
    """Give each object's step to its latest look, and what is now known of those before.

    Args:
        keys: of the objects.
        found: their steps.
        measured: numbers of those of which anything was measured.
    """
    ends, measurements = found.ends.tolist(), {}
    told = list(map(Hindsight, found.frames.tolist(), found.velocities, found.covariances))
    for k, (key, begin, end) in enumerate(zip(keys, [0, *ends[:-1]], ends, strict=True)):
        words = told[begin:end][::-1]
        measurements[key] = Measurement(
            position=found.centers[k],
            velocity=words[0].velocity,
            covariance=words[0].covariance,
            yaw_rate=float(found.yaw_rates[k]),
            status=EstimateStatus.CONVERGED if k in measured else EstimateStatus.NOT_CONVERGED,
            hindsight=tuple(words[1:]),
        )
    return measurements
