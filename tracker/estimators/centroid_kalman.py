"""The classical baseline: a Kalman filter on how fast the centroid of the points moves."""

from collections.abc import Mapping, Sequence

import numpy as np
from filterpy.kalman import KalmanFilter
from jaxtyping import Float64

from registration.types import Point
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.smoothing import ACCELERATION_VARIANCE, Smoothing, WindowMean
from tracker.types import EstimateStatus, VelocityEstimate

# Constants of the released program (protocol of Held et al.); variances.
MEASUREMENT_VARIANCE = 0.4  # of a centroid's velocity [m^2/s^2], whatever the step
INITIAL_VARIANCE = 5.0  # [m^2/s^2]
SHORTEST_STEP = 0.01  # [s]


class CentroidFilter:
    """The filter of one object: state is the velocity (vx, vy, vz), a random walk.

    The first step's velocity corrects the initial state (0, variance 5); from the second on the state is
    predicted before it is corrected.  At dt = 0.1 s the gains are 0.926 and then close to 0.390.

    Source: Held, Levinson, Thrun & Savarese, "Combining 3D shape, color, and motion for robust anytime
    tracking", RSS 2014: the baseline of its tables, with the constants of the released program.
    """

    def __init__(self, centroid: Point, timestamp: float) -> None:
        """Start a track; there is no velocity yet."""
        self._kalman = KalmanFilter(dim_x=3, dim_z=3)
        self._kalman.x = np.zeros(3)
        self._kalman.P = INITIAL_VARIANCE * np.eye(3)
        self._kalman.R = MEASUREMENT_VARIANCE * np.eye(3)
        self._kalman.H = np.eye(3)
        self._centroid, self._timestamp, self._has_measured = centroid, timestamp, False

    def update(self, centroid: Point, timestamp: float) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"]]:
        """Take the next centroid [m]; give the velocity [m/s] and its covariance."""
        dt = max(timestamp - self._timestamp, SHORTEST_STEP)
        if self._has_measured:
            self._kalman.predict(F=np.eye(3), Q=ACCELERATION_VARIANCE * dt**2 * np.eye(3))
        self._kalman.update((centroid - self._centroid) / dt)
        self._centroid, self._timestamp, self._has_measured = centroid, timestamp, True
        return self._kalman.x.copy(), self._kalman.P.copy()


class CentroidKalman(FrameEstimator):
    """Track each object's centroid with a `CentroidFilter`; its velocity refers to the centroid."""

    name = "centroid-kf"

    def __init__(self, smoothing: Smoothing | None = None) -> None:
        """Start with no tracks; `smoothing` is WindowMean() unless said."""
        super().__init__(smoothing or WindowMean())
        self._filters: dict[int, CentroidFilter] = {}

    def measure(self, sightings: Mapping[int, Sighting]) -> dict[int, Measurement]:
        """Correct each known track's filter; start the others'."""
        measured = {}
        for track_id, sighting in sightings.items():
            if track_id not in self._filters:
                self._filters[track_id] = CentroidFilter(sighting.centroid, sighting.timestamp)
                continue
            v, P = self._filters[track_id].update(sighting.centroid, sighting.timestamp)
            measured[track_id] = Measurement(
                position=sighting.centroid[:2],
                velocity=v[:2],
                covariance=P[:2, :2],
                yaw_rate=float("nan"),
                status=EstimateStatus.CONVERGED,
            )
        return measured

    def forget(self, track_id: int) -> None:
        """Drop a track's filter."""
        self._filters.pop(track_id, None)

    def fresh(self) -> "CentroidKalman":
        """Make one with the same settings and no tracks."""
        return CentroidKalman(self.smoothing)

    def smoothed(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth the filter's own output."""
        return self.smoothing.posteriors(estimates)
