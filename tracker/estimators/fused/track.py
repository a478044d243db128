"""One object: its window of places, that of its heading, and the looks that belong to their frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import ndtr

from registration import planar
from tracker.ego_motion.sweep import LEAST_SHARE
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look
from tracker.estimators.fused.sensor import SWEEP
from tracker.estimators.fused.sources import Evidence
from tracker.estimators.fused.window import SHORTEST_STEP, MotionModel, Square, Vector, Window

MOST_CENTERS = 20  # looks that count for where an object's centre is
LEAST_SD = 0.005  # of a velocity [m/s]
# Few points may be laid on the wrong part of an object: n of them, the most of any step of those that follow on each
# other, in one case of (n + 1)^2, by so much along each axis, about as far as two points of a car are apart.  Of 1117
# first steps in scenes of our own (seeds 31, 32, 41 to 44) shapes were more than 1 m off in 20 % of those of one point,
# 4 % of those of two to five, 2 % up to eight, 1 % up to 40.
SLIP_SD = 1.7  # [m]
CENTER_SD = 0.25  # of where an object's centre is, as labels have it [m]
FEW_SD = 2.0  # of a velocity from a single point [m/s]; of n points, an n-th of it


@dataclass(frozen=True)
class Steps:
    """The velocities of an object's centre over the steps of its window, the latest last.

    Attributes:
        frames: number of the frame that each step leads to, in its sequence.
        numbers: the same among the frames that the estimator was shown.
        lengths: how many of these each step takes; more than one where nothing was seen of the object in between.
        places: of the centre half-way [m].
        velocities: [m/s].
        covariances: of these, but for the doubts.
        doubts: covariances that they have beside that, since a look may be off as a whole.
        slips: probability that each velocity is off since clouds of few points were laid on the wrong parts, and the
            variance that it then has beside its own [m^2/s^2].
        center: where it is at last [m].
        yaw_rate: over the last step [rad/s].
        by_clock: what velocities are to be multiplied by, to be displacements over the time that the clock tells.
    """

    frames: Int64[np.ndarray, " n"]
    numbers: Int64[np.ndarray, " n"]
    lengths: Int64[np.ndarray, " n"]
    places: Float64[np.ndarray, "n 2"]
    velocities: Float64[np.ndarray, "n 2"]
    covariances: Float64[np.ndarray, "n 2 2"]
    doubts: Float64[np.ndarray, "n 2 2"]
    slips: Float64[np.ndarray, "n 2"]
    center: Vector
    yaw_rate: float
    by_clock: Float64[np.ndarray, " n"]

    def told(self) -> "Steps":
        """Give velocities by the clock, and add the doubts to their covariances."""
        factors = self.by_clock[:, None]
        covariances = factors[:, None] ** 2 * (self.covariances + self.doubts)
        return replace(self, velocities=factors * self.velocities, covariances=covariances)


@dataclass
class Track:
    """One object.

    Attributes:
        place: its reference point.
        turn: its heading, as it looks in axes that may turn themselves.
        looks: one for each frame of these windows, but for the frame that is being looked at.
        center: of the object relative to its place, in the axes of its first look [m]: a mean over `n_centers` looks,
            of which no more than MOST_CENTERS count.
    """

    place: Window
    turn: Window
    looks: list[Look]
    center: Vector = field(default_factory=lambda: np.zeros(2))
    n_centers: int = 0

    @classmethod
    def start(cls, models: tuple[MotionModel, MotionModel], look: Look, axes: Heading) -> "Track":
        """Begin at the middle of a look.

        Args:
            models: of the motion of its place, and of its heading.
            look: at the object.
            axes: whose latest frame it is.
        """
        middle = 0.5 * (look.points.min(axis=0) + look.points.max(axis=0))[:2]
        place = Window.start(models[0], look.time, axes, middle)
        return cls(place, Window.start(models[1], look.time, axes, np.zeros(1)), [look])

    def advance(self, new: Look, axes: Heading, pose_turn_sd: float) -> None:
        """Expect the object where its motion leads, in axes whose turn may be off by so much [rad]."""
        arm = self.place.state[-1, 0] - new.sensor.place
        across = pose_turn_sd * np.array([-arm[1], arm[0]])
        has_left = self.place.advance(new.time, axes, across[:, None] * across)
        self.turn.advance(new.time, axes)
        if has_left:
            self.looks.pop(0)

    def hear(self, lag: int, evidence: Evidence, doubt: Square, axes: Heading) -> None:
        """Take a comparison of the latest frame with the one `lag` before into account, from the next `solve` on.

        Its displacement has the covariance `doubt` beside what it claims [m^2].
        """
        start = self.place.at(-1 - lag)
        if len(self.place) - lag == 1 and not self.place.comparisons:
            self.place.place_last(start + evidence.step)
        self.place.compare(lag, start, evidence.step, evidence.information, doubt)
        if math.isfinite(evidence.turn_variance):
            information = np.array([[1.0 / evidence.turn_variance]])
            self.turn.compare(lag, np.zeros(1), np.array([evidence.turn]), information)
            axes.hear(self.place.axes[-1 - lag], evidence.turn, evidence.turn_variance)

    def straighten(self, new: Look) -> Look:
        """Undo the motion during the sweep in the new look, and in the first one, whose motion was not known.

        Where nothing is known of the motion, nothing is undone.
        """
        before = self.looks[-1]
        if not self.place.comparisons or (new.lags is None and before.lags is None):
            return new
        centers = self.centers()
        velocity = (self.place.at(-1) - self.place.at(-2)) / (self.place.times[-1] - self.place.times[-2])
        velocity = velocity - new.sensor.carried(centers[-1])
        self.looks[-1] = before.straightened(velocity)
        return new.straightened(velocity)

    def changed(self, lag: int, new: Look) -> float:
        """Say how much of what is seen of an object came or went beside what its range explains: 0 to 1, squared."""
        before, now = self.looks[-lag].n_from_1m, new.n_from_1m
        return (1.0 - min(before, now) / max(before, now)) ** 2

    def way(self, lag: int, new: Look) -> Vector:
        """Give how far it has moved since an earlier look, relative to the sensor (2) [m]."""
        place = self.place.state
        way: Vector = place[-1, 0] - place[-1 - lag, 0] - (new.sensor.place - self.looks[-lag].sensor.place)
        return way

    def turned(self, lag: int, new: Look) -> float:
        """Say by how much it has turned against the line of sight since an earlier look [rad]."""
        place, turn, before = self.place.state, self.turn.state, self.looks[-lag]
        x, y = (place[-1, 0] - new.sensor.place).tolist()
        p, q = (place[-1 - lag, 0] - before.sensor.place).tolist()
        own = float(turn[-1, 0, 0] - turn[-1 - lag, 0, 0])
        return abs(planar.wrap(math.atan2(y, x) - math.atan2(q, p) - own))

    def refer_to_center(self) -> None:
        """Let the network's opinion of the latest look count for where the centre is."""
        center = self.looks[-1].learned.center()
        if center is not None:
            away = center + self.looks[-1].shift - self.place.state[-1, 0]
            own = planar.rotation(-float(self.turn.state[-1, 0, 0])) @ away
            self.n_centers = min(self.n_centers + 1, MOST_CENTERS)
            self.center = self.center + (own - self.center) / self.n_centers

    def note_met(self) -> None:
        """Note when the beams met the object's centre in the latest look, where velocities count by another time.

        Labels lie where the beams met the objects, so from frame to frame they move by what the object does between
        those moments, which for what passes by at 30 m/s and 4 m are a tenth less (or, on the right, more) than a frame
        apart.
        """
        look = self.looks[-1]
        if look.clock != look.time:
            center = self.centers()[-1] - look.shift
            late = float(look.sensor.delays(center[None])[0])
            self.looks[-1] = replace(look, late=late, past_end=look.sensor.past_end(center))

    def centers(self) -> Float64[np.ndarray, "n 2"]:
        """Give the object's centre at each frame [m]."""
        c, s = np.cos(self.turn.state[:, 0, 0]), np.sin(self.turn.state[:, 0, 0])
        x, y = self.center
        found: Float64[np.ndarray, "n 2"] = self.place.state[:, 0] + np.column_stack([c * x - s * y, s * x + c * y])
        return found

    def steps(self, share: float) -> Steps:
        """Read what is known now of each step; errors have so large a share of the windows' covariances.

        Over the time between frames, what crosses the direction in which sweeps end has no velocity: its label moves
        for anything between no time and twice as long.
        """
        centers, numbers = self.centers(), np.array(self.place.axes)
        seconds, late, clocks, frames = np.diff(
            [
                (time, look.late, look.clock, look.time - look.delay)
                for time, look in zip(self.place.times, self.looks, strict=True)
            ],
            axis=0,
        ).T
        tells, crosses = seconds > LEAST_SHARE * frames, _crossed([look.past_end for look in self.looks])
        turned, turns, _ = self.turn.steps(tells)
        moved, known, shaken = self.place.steps(tells)
        arms = centers - self.place.state[:, 0]
        moved, arms = moved + np.diff(arms, axis=0), arms[1:, ::-1] * [-1.0, 1.0]
        known = known + turns * arms[:, :, None] * arms[:, None, :]
        n_points = np.array([look.n_points for look in self.looks])
        fewest = np.minimum(n_points[1:], n_points[:-1])
        least = LEAST_SD**2 + (FEW_SD / fewest) ** 2
        velocities, per_second2 = moved / seconds[:, None], seconds[:, None, None] ** -2.0
        unknown = (crosses * (velocities**2).sum(axis=1))[:, None, None] * np.eye(2)
        return Steps(
            frames=np.array([look.frame for look in self.looks[1:]]),
            numbers=numbers[1:],
            lengths=np.diff(numbers),
            places=0.5 * (centers[1:] + centers[:-1]),
            velocities=velocities,
            covariances=share * per_second2 * (known + shaken) + least[:, None, None] * np.eye(2),
            doubts=per_second2 * np.array(self.place.doubts[1:]) + unknown,
            slips=_slips(np.diff(numbers), fewest, seconds),
            center=centers[-1],
            yaw_rate=float(turned[-1, 0] / seconds[-1]),
            by_clock=np.where(np.abs(late) > 0.5 * SWEEP.period, 1.0, 1.0 + late / np.maximum(clocks, SHORTEST_STEP)),
        )

    def step_covariance(self, lag: int) -> Square:
        """Give the covariance of where the object is now against where it was `lag` frames ago [m^2]."""
        return self.place.difference(-1 - lag)


def _crossed(past_end: Sequence[float]) -> Float64[np.ndarray, " n"]:
    """Give the probability that an object's centre crossed the direction in which sweeps end, from look to look.

    Where that is, is known to CENTER_SD, and errs in neighbouring looks alike.

    Args:
        past_end: see `Look`.
    """
    if all(map(math.isnan, past_end)):
        return np.zeros(len(past_end) - 1)
    return np.nan_to_num(np.abs(np.diff(ndtr(np.array(past_end) / CENTER_SD))))


def _slips(
    lengths: Int64[np.ndarray, " n"], n_points: Int64[np.ndarray, " n"], seconds: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 2"]:
    """Say how likely clouds were laid on wrong parts in each step, and the variance of its velocity then [m^2/s^2].

    Steps from one frame to the next, without a gap, stand for each other; what is seen may slide along in all of them.
    """
    begins = np.concatenate([[True], (lengths[1:] > 1) | (lengths[:-1] > 1)])
    run, first = np.cumsum(begins) - 1, np.flatnonzero(begins)
    laid, took = np.maximum.reduceat(n_points, first)[run], np.add.reduceat(seconds, first)[run]
    return np.column_stack([(1.0 + laid) ** -2.0, (SLIP_SD / took) ** 2])
