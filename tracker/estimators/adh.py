"""Velocity from annealed dynamic histograms: a Bayes filter whose measurement is a search over shifts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from registration.methods.adh import AnnealedHistograms2D, Cloud, Posterior
from registration.types import MotionPrior
from registration.uncertainty import ORDINARY_TURN
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.smoothing import Smoothing, WindowMean
from tracker.types import Covariance2, EstimateStatus, Vector2, VelocityEstimate

SHORTEST_STEP = 0.01  # [s]


@dataclass(frozen=True, slots=True)
class Motion:
    """What one alignment leaves for the next: a velocity that changes at random.

    Source: Held et al., RSS 2014, section V, with what the authors' release adds: the uncertainty of the last
    shift is carried over into that of the next.

    Attributes:
        velocity: [m/s].
        velocity_covariance: [m^2/s^2].
        shift_covariance: of the shift that the velocity was read from [m^2].
    """

    velocity: Vector2
    velocity_covariance: Covariance2
    shift_covariance: Covariance2

    @classmethod
    def read_from(cls, posterior: Posterior, dt: float) -> "Motion":
        """Take the place of what was known before: it went into the posterior as its prior."""
        return cls(posterior.mean / dt, posterior.covariance / dt**2, posterior.covariance)

    def expect(self, dt: float, acceleration_variance: float) -> MotionPrior:
        """Expect the shift of the next step, from a velocity that may have changed."""
        velocity_covariance = self.velocity_covariance + acceleration_variance * dt**2 * np.eye(2)
        covariance = np.diag([0.0, 0.0, ORDINARY_TURN**2])
        covariance[:2, :2] = self.shift_covariance + velocity_covariance * dt**2
        return MotionPrior(np.array([*(self.velocity * dt), 0.0]), covariance)


@dataclass(frozen=True, slots=True)
class _Seen:
    """An object as it was last seen; `motion` is None until it has been aligned once."""

    cloud: Cloud
    timestamp: float
    motion: Motion | None


class AdhEstimator(FrameEstimator):
    """Align each segment with its predecessor, expecting the motion so far; all objects of a frame are one batch.

    The first alignment of a track expects nothing, and a frame without points leaves everything as it was, so
    that the next step is a longer one.  A shift is that of every point, so it is the velocity of the middle of
    the segment's bounding box too; the covariance is the method's for the motion of an object.

    Source: Held, Levinson, Thrun & Savarese, "Combining 3D shape, color, and motion for robust anytime tracking",
    RSS 2014.
    """

    def __init__(self, method: AnnealedHistograms2D, smoothing: Smoothing | None = None) -> None:
        """Use a method and the motion model among its settings; `smoothing` is WindowMean() unless said."""
        super().__init__(smoothing or WindowMean())
        self.method = method
        self.name = method.name
        self._tracks: dict[int, _Seen] = {}

    def measure(self, sightings: Mapping[int, Sighting]) -> dict[int, Measurement]:
        """Align the objects that were seen before; the others start a track."""
        seen = sightings.values()
        clouds = self.method.prepare([s.points for s in seen], [s.sensor for s in seen])
        current = dict(zip(sightings, clouds, strict=True))
        known = [track_id for track_id in current if track_id in self._tracks]
        steps = {key: max(sightings[key].timestamp - self._tracks[key].timestamp, SHORTEST_STEP) for key in known}
        pairs = [(self._tracks[track_id].cloud, current[track_id]) for track_id in known]
        posteriors = self.method.posteriors(pairs, [self._expected(key, steps[key]) for key in known])
        measured, motions = {}, {}
        for track_id, pair, posterior in zip(known, pairs, posteriors, strict=True):
            dt = steps[track_id]
            result = self.method.result(*pair, posterior)
            motions[track_id] = None if posterior is None else Motion.read_from(posterior, dt)
            measured[track_id] = Measurement(
                position=sightings[track_id].midpoint[:2],
                velocity=result.T_target_source[:2, 3] / dt,
                covariance=result.covariance[:2, :2] / dt**2,
                yaw_rate=float("nan"),
                status=EstimateStatus(result.status.value),
            )
        for track_id, cloud in current.items():
            self._tracks[track_id] = _Seen(cloud, sightings[track_id].timestamp, motions.get(track_id))
        return measured

    def forget(self, track_id: int) -> None:
        """Drop a track's last segment and motion."""
        self._tracks.pop(track_id, None)

    def fresh(self) -> "AdhEstimator":
        """Make one with the same settings and no tracks."""
        return AdhEstimator(self.method, self.smoothing)

    def smoothed(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth the filter's own output: each posterior holds its predecessors, so it is no series of measurements.

        The window's mean is the same either way; what differs is that its covariance does not shrink.
        """
        return self.smoothing.posteriors(estimates)

    def _expected(self, track_id: int, dt: float) -> MotionPrior | None:
        motion = self._tracks[track_id].motion
        return None if motion is None else motion.expect(dt, self.method.acceleration_variance)
