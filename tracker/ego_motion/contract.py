"""What an estimator of the ego's motion is, and what it gives: a pose a scan, and how sure its step is."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from registration.types import Transform
from tracker.kitti.poses import Poses
from tracker.types import Frame, StepCovariance

PlanarCovariance = Float64[np.ndarray, "3 3"]  # (x, y, yaw) about the sensor, in world axes


@dataclass(frozen=True, slots=True)
class EgoPose:
    """Where the sensor was when the beams of one scan pointed forward.

    Attributes:
        T_world_lidar: pose of the sensor.
        covariance: of the pose relative to what is around it, (x, y, yaw) about the sensor, in world axes
            [m^2, m rad, rad^2]; None where none is claimed.
        step_covariance: of the step from the pose before, likewise; None for the first.
        is_flagged: the pose is a guess, because the scan held nothing that could be measured against.
    """

    T_world_lidar: Transform
    covariance: PlanarCovariance | None = None
    step_covariance: StepCovariance | None = None
    is_flagged: bool = False


@runtime_checkable
class EgoEstimator(Protocol):
    """Scans in, poses out, online: a pose depends on the scans so far only."""

    def update(self, frame: Frame) -> EgoPose | None:
        """Take the next scan; None where not even a guess is possible."""


@dataclass(frozen=True)
class EgoPoses:
    """The ego's way through a sequence.

    Attributes:
        T_world_lidar: a pose a frame.
        source: what they come from, in words.
        covariances: of the poses, see `EgoPose`; NaN where none is claimed.
        step_covariances: of the steps to them; NaN where none is claimed.
        flagged: frames whose pose is a guess.
    """

    T_world_lidar: Poses
    source: str
    covariances: Float64[np.ndarray, "n 3 3"]
    step_covariances: Float64[np.ndarray, "n 3 3"]
    flagged: tuple[int, ...] = ()


class RecordedPoses:
    """The poses that frames bring along, as an estimator: the start of a refinement."""

    def update(self, frame: Frame) -> EgoPose | None:
        """Give the frame's own pose; None where it has none."""
        return None if frame.T_world_lidar is None else EgoPose(frame.T_world_lidar)
