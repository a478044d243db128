"""Velocities from their past and their future: the paper's window mean, and a Rauch-Tung-Striebel smoother."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from filterpy.kalman import KalmanFilter

from tracker.types import EstimateStatus, Hindsight, VelocityEstimate

# How fast velocities change: variance of an acceleration that is constant over a step and new in the next.
# The released centroid filter's value: 3.2 m/s^2 is firm braking.
ACCELERATION_VARIANCE = 10.0  # [m^2/s^4]

_WITHOUT_MEASUREMENT = (EstimateStatus.NEW_TRACK, EstimateStatus.NO_POINTS)


@runtime_checkable
class Smoothing(Protocol):
    """A way to use neighbouring frames; offline."""

    def measurements(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth independent velocities, one a step, of one object over consecutive frames."""

    def posteriors(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth the output of a causal filter over consecutive frames."""


@dataclass(frozen=True)
class WindowMean:
    """Replace each velocity by the mean over its neighbours, k - w to k + w, as far as they exist.

    Velocities are displacements over real time steps, and the first scan of a track, which has none, is no
    member: the released code's dummy zero there would bias track starts.  The covariance of the mean is that
    of independent members.

    Source: AlignNet-3D (3DV 2019), section 4.4: each translation is averaged with its two neighbours, w = 1.
    """

    half_width: int = 1  # w; 0 changes nothing, the released code has 5

    def __post_init__(self) -> None:
        """Refuse a negative width."""
        if self.half_width < 0:
            raise ValueError(f"half_width must be 0 or more, got {self.half_width}")

    def measurements(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Average independent velocities."""
        smoothed = []
        for k, estimate in enumerate(estimates):
            window = estimates[max(0, k - self.half_width) : k + self.half_width + 1]
            members = [e for e in window if e.status not in _WITHOUT_MEASUREMENT]
            if not members or estimate.status is EstimateStatus.NEW_TRACK:
                smoothed.append(estimate)
                continue
            velocity = np.mean([e.velocity for e in members], axis=0)
            covariance = np.sum([e.covariance for e in members], axis=0) / len(members) ** 2
            smoothed.append(replace(estimate, velocity=velocity, covariance=covariance))
        return smoothed

    def posteriors(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Average a filter's output; its neighbours share their errors, so the covariance does not shrink."""
        averaged = self.measurements(estimates)
        return [replace(a, covariance=e.covariance) for a, e in zip(averaged, estimates, strict=True)]


@dataclass(frozen=True)
class RauchTungStriebel:
    """Smooth a random walk in velocity over all frames of a tracklet, with each step's own dt.

    Source: Rauch, Tung & Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA Journal 3(8),
    1965; filterpy's `KalmanFilter.rts_smoother`.
    """

    acceleration_variance: float = ACCELERATION_VARIANCE  # [m^2/s^4]

    def measurements(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Filter the velocities forward, weighed by their covariances, then smooth backward."""
        return self.posteriors(self.filtered(estimates))

    def posteriors(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth a filter's output backward."""
        start = _first_measured(estimates)
        if len(estimates) - start < 2:
            return list(estimates)
        run = estimates[start:]
        kalman = KalmanFilter(dim_x=2, dim_z=2)
        x, P, _, _ = kalman.rts_smoother(
            np.array([e.velocity for e in run]),
            np.array([e.covariance for e in run]),
            Fs=[np.eye(2)] * len(run),
            Qs=self._process_noise(run),
        )
        smoothed = [replace(e, velocity=x[k], covariance=0.5 * (P[k] + P[k].T)) for k, e in enumerate(run)]
        return [*estimates[:start], *smoothed]

    def filtered(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Filter the velocities forward, weighed by their covariances."""
        start = _first_measured(estimates)
        run = estimates[start:]
        if not run:
            return list(estimates)
        kalman = KalmanFilter(dim_x=2, dim_z=2)
        kalman.H = np.eye(2)
        kalman.x, kalman.P = run[0].velocity.copy(), run[0].covariance.copy()
        filtered = [run[0]]
        for Q, estimate in zip(self._process_noise(run)[1:], run[1:], strict=True):
            kalman.predict(F=np.eye(2), Q=Q)
            if estimate.status not in _WITHOUT_MEASUREMENT:
                kalman.update(estimate.velocity, R=estimate.covariance)
            filtered.append(replace(estimate, velocity=kalman.x.copy(), covariance=kalman.P.copy()))
        return [*estimates[:start], *filtered]

    def _process_noise(self, run: Sequence[VelocityEstimate]) -> list[np.ndarray]:
        """Give Q of the step that ends at each frame; filterpy reads Qs[k + 1] for the step from k to k + 1."""
        times = np.array([e.timestamp for e in run])
        steps = np.diff(times, prepend=times[0])
        return [self.acceleration_variance * dt**2 * np.eye(2) for dt in steps]


@dataclass(frozen=True)
class FixedLag:
    """Smooth each velocity by the few frames that follow it: what a tracker that may wait for them can know.

    Source: Rauch, Tung & Striebel, 1965, over the frames k to k + lag only.
    """

    lag: int = 1  # frames to wait for
    acceleration_variance: float = ACCELERATION_VARIANCE  # [m^2/s^4]

    def __post_init__(self) -> None:
        """Refuse a negative lag."""
        if self.lag < 0:
            raise ValueError(f"lag must be 0 or more frames, got {self.lag}")

    def measurements(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Filter the velocities forward, weighed by their covariances, then smooth over the lag."""
        return self.posteriors(RauchTungStriebel(self.acceleration_variance).filtered(estimates))

    def posteriors(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth a filter's output over the lag."""
        smoother = RauchTungStriebel(self.acceleration_variance)
        return [smoother.posteriors(estimates[k : k + self.lag + 1])[0] for k in range(len(estimates))]


def in_hindsight(estimates: Sequence[VelocityEstimate], lag: int) -> list[VelocityEstimate]:
    """Replace each velocity by what is said of its step up to `lag` frames later, as long as it is spoken of.

    Args:
        estimates: of one tracklet, consecutive frames.
        lag: frames.
    """
    known: list[Hindsight | None] = [None] * len(estimates)
    index = {estimate.frame: k for k, estimate in enumerate(estimates)}
    for k, later in enumerate(estimates):
        for word in later.hindsight:
            j = index.get(word.frame)
            if j is not None and 0 < k - j <= lag:
                known[j] = word
    return [
        estimate if word is None else replace(estimate, velocity=word.velocity, covariance=word.covariance)
        for estimate, word in zip(estimates, known, strict=True)
    ]


def _first_measured(estimates: Sequence[VelocityEstimate]) -> int:
    measured = (k for k, e in enumerate(estimates) if e.status not in _WITHOUT_MEASUREMENT)
    return next(measured, len(estimates))
