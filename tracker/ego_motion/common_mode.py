"""What an unsure ego pose makes of velocities in the world: one error, common to all objects of a frame."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from registration.types import Transform
from tracker.types import WORLD, EstimateStatus, SegmentedFrame, StepCovariance, VelocityEstimate


def with_pose_covariance(
    estimates: Mapping[int, VelocityEstimate], frame: SegmentedFrame, dt: float | None
) -> dict[int, VelocityEstimate]:
    """Add the covariance of the ego's last step to those of world velocities: J C J' / dt^2.

    J = [[1, 0, -ry], [0, 1, rx]] for an object at r from the sensor: a yaw error moves far objects more.  Estimates in
    the sensor's frame, those that know no velocity yet, and frames whose step claims no covariance stay as they are.

    Args:
        estimates: of one frame, by track id.
        frame: what they were made of.
        dt: time since the frame before [s]; None at the first.
    """
    C, T = frame.ego_step_covariance, frame.T_world_lidar
    if C is None or T is None or dt is None:
        return dict(estimates)
    return {key: _widened(estimate, C, T, dt) for key, estimate in estimates.items()}


def _widened(estimate: VelocityEstimate, C: StepCovariance, T_world_lidar: Transform, dt: float) -> VelocityEstimate:
    is_known = estimate.frame_name == WORLD and estimate.status is not EstimateStatus.NEW_TRACK
    if not is_known or not np.isfinite(estimate.position).all():
        return estimate
    x, y = estimate.position - T_world_lidar[:2, 3]
    J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
    return replace(estimate, covariance=estimate.covariance + J @ C @ J.T / dt**2)
