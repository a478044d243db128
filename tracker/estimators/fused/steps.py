"""What is known of the velocities of a frame's objects, over the steps of their windows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import ndtr

from registration import planar
from tracker.ego_motion.sweep import LEAST_SHARE
from tracker.estimators.fused import window
from tracker.estimators.fused.sensor import SWEEP
from tracker.estimators.fused.track import Track
from tracker.estimators.fused.window import SHORTEST_STEP

LEAST_SD = 0.005  # of a velocity [m/s]
# Few points may be laid on the wrong part of an object: n of them, the most of any step of those that follow on each
# other, in one case of (n + 1)^2, by so much along each axis, about as far as two points of a car are apart.  Of 1117
# first steps in scenes of our own (seeds 31, 32, 41 to 44) shapes were more than 1 m off in 20 % of those of one point,
# 4 % of those of two to five, 2 % up to eight, 1 % up to 40.
SLIP_SD = 1.7  # [m]
CENTER_SD = 0.25  # of where an object's centre is, as labels have it [m]
FEW_SD = 2.0  # of a velocity from a single point [m/s]; of n points, an n-th of it

Vectors = Float64[np.ndarray, "n 2"]
Squares = Float64[np.ndarray, "n 2 2"]
Numbers = Float64[np.ndarray, " n"]
Indices = Int64[np.ndarray, " n"]


@dataclass(frozen=True)
class Steps:
    """The velocities of the centres of K objects over the steps of their windows, N in all, one object after the other.

    Attributes:
        owners: which object each step is of (N), ascending; each has one at least, the latest last.
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

    @property
    def ends(self) -> Int64[np.ndarray, " k"]:
        """Give where each object's steps end: the number of the first one of the next."""
        return np.searchsorted(self.owners, np.arange(1, len(self.centers) + 1))

    def told(self) -> "Steps":
        """Give velocities by the clock, and add the doubts to their covariances."""
        factors = self.by_clock[:, None]
        covariances = factors[:, None] ** 2 * (self.covariances + self.doubts)
        return replace(self, velocities=factors * self.velocities, covariances=covariances)


def read(tracks: Sequence[Track], share: float) -> Steps:
    """Read what is known now of each step of objects.

    Over the time between frames, what crosses the direction in which sweeps end has no velocity: its label moves
    for anything between no time and twice as long.

    Args:
        tracks: of K objects, one at least, with two frames or more.
        share: that errors have of the windows' covariances.
    """
    sizes = np.array([len(track.looks) for track in tracks])
    after = np.delete(np.arange(sizes.sum()), np.cumsum(sizes) - sizes)  # frames that steps lead to
    before, owners = after - 1, np.repeat(np.arange(len(tracks)), sizes - 1)
    places, turns = [track.place for track in tracks], [track.turn for track in tracks]
    table = np.array(
        [
            (time, look.late, look.clock, look.time - look.delay, look.past_end, look.n_points, look.frame, number)
            for track in tracks
            for time, look, number in zip(track.place.times, track.looks, track.place.axes, strict=True)
        ]
    ).T
    seconds, late, clocks, frames = table[:4, after] - table[:4, before]
    n_points, numbers = table[5], table[7].astype(np.int64)
    tells, crosses = seconds > LEAST_SHARE * frames, _crossed(table[4], before, after)
    turned, turns_known, _ = window.steps(turns, tells)
    moved, known, shaken = window.steps(places, tells)
    arms = _arms(tracks, sizes)
    centers = np.concatenate([place.state[:, 0] for place in places]) + arms
    moved, arms = moved + (arms[after] - arms[before]), arms[after, ::-1] * [-1.0, 1.0]
    known = known + turns_known * arms[:, :, None] * arms[:, None, :]
    fewest, lengths = np.minimum(n_points[after], n_points[before]), numbers[after] - numbers[before]
    least = LEAST_SD**2 + (FEW_SD / fewest) ** 2
    velocities, per_second2 = moved / seconds[:, None], seconds[:, None, None] ** -2.0
    unknown = (crosses * (velocities**2).sum(axis=1))[:, None, None] * np.eye(2)
    lasts = np.cumsum(sizes - 1) - 1
    return Steps(
        owners=owners,
        frames=table[6, after].astype(np.int64),
        numbers=numbers[after],
        lengths=lengths,
        places=0.5 * (centers[after] + centers[before]),
        velocities=velocities,
        covariances=share * per_second2 * (known + shaken) + least[:, None, None] * np.eye(2),
        doubts=per_second2 * np.concatenate([place.doubts for place in places])[after] + unknown,
        slips=_slips(owners, lengths, fewest, seconds),
        by_clock=np.where(np.abs(late) > 0.5 * SWEEP.period, 1.0, 1.0 + late / np.maximum(clocks, SHORTEST_STEP)),
        centers=centers[np.cumsum(sizes) - 1],
        yaw_rates=turned[lasts, 0] / seconds[lasts],
    )


def _arms(tracks: Sequence[Track], sizes: Int64[np.ndarray, " k"]) -> Vectors:
    """Give where each object's centre is against its reference point, in the axes of each frame [m]."""
    turns = np.concatenate([track.turn.state[:, 0, 0] for track in tracks])
    return planar.rotate_all(np.repeat([track.center for track in tracks], sizes, axis=0), turns)


def _crossed(past_end: Float64[np.ndarray, " m"], before: Indices, after: Indices) -> Numbers:
    """Give the probability that an object's centre crossed the direction in which sweeps end, from look to look.

    Where that is, is known to CENTER_SD, and errs in neighbouring looks alike.

    Args:
        past_end: see `Look`.
        before, after: looks that steps come from, and lead to.
    """
    if np.isnan(past_end).all():
        return np.zeros(len(after))
    shares = ndtr(past_end / CENTER_SD)
    return np.nan_to_num(np.abs(shares[after] - shares[before]))


def _slips(owners: Indices, lengths: Indices, n_points: Numbers, seconds: Numbers) -> Vectors:
    """Say how likely clouds were laid on wrong parts in each step, and the variance of its velocity then [m^2/s^2].

    An object's steps from one frame to the next, without a gap, stand for each other; what is seen may slide along in
    all of them.
    """
    begins = (lengths > 1) | (np.diff(owners, prepend=-1) > 0)
    begins[1:] |= lengths[:-1] > 1
    run, first = np.cumsum(begins) - 1, np.flatnonzero(begins)
    laid, took = np.maximum.reduceat(n_points, first)[run], np.add.reduceat(seconds, first)[run]
    return np.column_stack([(1.0 + laid) ** -2.0, (SLIP_SD / took) ** 2])
