"""Poses of a whole sequence, smoothed in time: what a car cannot do between two scans is taken out."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from registration import se3
from tracker.ego_motion.contract import EgoPoses

Series = Float64[np.ndarray, " n"]


@dataclass(frozen=True)
class SmoothSettings:
    """How abruptly a car's acceleration changes: densities of white jerk.

    1 m/s^3 that lasts a second is brisk driving, and 0.3 rad/s^3 is brisk steering (0.3 * 0.3 * 1 s, about 0.1).
    """

    jerk: float = 1.0  # along x and y [m^2/s^5]
    yaw_jerk: float = 0.1  # [rad^2/s^5]


def smooth_poses(poses: EgoPoses, times: Series, settings: SmoothSettings | None = None) -> EgoPoses:
    """Run a constant-acceleration filter over x, y and yaw, forwards and back; height and tilt stay as they are.

    Poses that are guesses count for nothing: the smoothed way leads past them, and they stay flagged.  The covariances
    of steps are those that the smoother itself gives, correlations between the two ends included.

    Args:
        poses: with the covariance of each pose, as a `Refiner` gives them.
        times: of the poses [s].
        settings: how the car moves.

    Source: Rauch, Tung & Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3(8), 1965; the
    covariance between neighbours: Shumway & Stoffer, 1982.
    """
    settings = settings or SmoothSettings()
    T = poses.T_world_lidar
    variances = _variances(poses)
    yaw = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    x, y, turned = (
        _smooth_series(values, variances[:, i], times, density)
        for i, (values, density) in enumerate(
            ((T[:, 0, 3], settings.jerk), (T[:, 1, 3], settings.jerk), (yaw, settings.yaw_jerk))
        )
    )
    smoothed = np.array(
        [se3.from_yaw(float(turn), np.zeros(3)) @ pose for turn, pose in zip(turned.values - yaw, T, strict=True)]
    )
    smoothed[:, :3, 3] = np.column_stack([x.values, y.values, T[:, 2, 3]])
    steps = np.array([np.diag(row) for row in np.column_stack([x.steps, y.steps, turned.steps])])
    return replace(poses, T_world_lidar=smoothed, step_covariances=_about_later_end(steps, smoothed, turned.variances))


@dataclass(frozen=True, slots=True)
class _Smoothed:
    """One coordinate of all poses.

    Attributes:
        values: smoothed.
        variances: of them.
        steps: variance of each one's difference to the one before; NaN for the first.
    """

    values: Series
    variances: Series
    steps: Series


def _variances(poses: EgoPoses) -> Float64[np.ndarray, "n 3"]:
    """Give the variance of each pose's x, y and yaw; infinite for guesses, the largest found for a first scan."""
    variances = np.diagonal(poses.covariances, axis1=1, axis2=2).copy()
    known = np.isfinite(variances).all(axis=1)
    variances[~known] = variances[known].max(axis=0) if known.any() else 1.0
    guessed = [frame for frame in poses.flagged if not known[frame]]
    variances[guessed] = np.inf
    return variances


def _smooth_series(values: Series, variances: Series, times: Series, density: float) -> _Smoothed:
    n = len(values)
    x, P = np.array([values[0], 0.0, 0.0]), np.diag([min(float(variances[0]), 1e6), 60.0**2, 10.0**2])
    filtered, predicted = [], []
    for k in range(n):
        if k:
            F, Q = _motion(float(times[k] - times[k - 1]), density)
            x, P = F @ x, F @ P @ F.T + Q
        predicted.append((x, P))
        if np.isfinite(variances[k]):
            gain = P[:, 0] / (P[0, 0] + variances[k])
            x, P = x + gain * (values[k] - x[0]), P - np.outer(gain, P[0])
        filtered.append((x, P))
    found, spread, steps = np.empty(n), np.empty(n), np.full(n, np.nan)
    for k in range(n - 1, -1, -1):
        x_k, P_k = filtered[k]
        if k < n - 1:
            F, _ = _motion(float(times[k + 1] - times[k]), density)
            gain = P_k @ F.T @ np.linalg.inv(predicted[k + 1][1])
            across = (gain @ P)[0, 0]
            P_after = P
            x_k, P_k = x_k + gain @ (x - predicted[k + 1][0]), P_k + gain @ (P - predicted[k + 1][1]) @ gain.T
            steps[k + 1] = P_after[0, 0] + P_k[0, 0] - 2.0 * across
        x, P = x_k, P_k
        found[k], spread[k] = x[0], P[0, 0]
    return _Smoothed(found, spread, steps)


def _motion(dt: float, density: float) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3 3"]]:
    """Give the transition of position, velocity and acceleration, and the noise of white jerk."""
    F = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    Q = density * np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    return F, Q


def _about_later_end(
    steps: Float64[np.ndarray, "n 3 3"], poses: Float64[np.ndarray, "n 4 4"], yaw_variances: Series
) -> Float64[np.ndarray, "n 3 3"]:
    """Refer the steps' covariances to the sensor at their later end: the earlier yaw swings the way between them."""
    moved = steps.copy()
    moved[0] = np.nan
    for k in range(1, len(poses)):
        x, y = poses[k, :2, 3] - poses[k - 1, :2, 3]
        lever = np.array([-y, x])
        moved[k, :2, :2] += yaw_variances[k - 1] * np.outer(lever, lever)
    return moved
