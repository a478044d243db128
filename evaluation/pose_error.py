"""Ego poses against the truth: how far each step is off, which is what velocities are made of."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from registration import se3

Poses = Float64[np.ndarray, "n 4 4"]


@dataclass(frozen=True)
class PoseScore:
    """Errors of the steps between consecutive poses.

    Attributes:
        n: number of steps.
        rms_shift: of the horizontal translation, in the sensor's axes [m].
        max_shift: the largest of them [m].
        rms_yaw: of the turn [rad].
        mean_forward: mean error along the sensor's x-axis: a speed that is wrong throughout [m].
        nees: mean normalised squared error of (x, y, yaw); 3 for honest covariances, NaN without any.
    """

    n: int
    rms_shift: float
    max_shift: float
    rms_yaw: float
    mean_forward: float
    nees: float


def score_steps(
    estimated: Poses, true: Poses, step_covariances: Float64[np.ndarray, "n 3 3"] | None = None
) -> PoseScore:
    """Compare the steps of two ways through a sequence; where their worlds are does not matter.

    Args:
        estimated: T_world_lidar of each frame.
        true: the same, exact; its world may be another one.
        step_covariances: of the estimated steps, (x, y, yaw) about the sensor at the step's end in the axes of the
            estimate's world; rows of NaN and the first row are left out.
    """
    errors = step_errors(estimated, true)
    shift = np.hypot(errors[:, 0], errors[:, 1])
    return PoseScore(
        n=len(errors),
        rms_shift=float(np.sqrt(np.mean(shift**2))),
        max_shift=float(shift.max()),
        rms_yaw=float(np.sqrt(np.mean(errors[:, 2] ** 2))),
        mean_forward=float(errors[:, 0].mean()),
        nees=float("nan") if step_covariances is None else _nees(errors, estimated, step_covariances),
    )


def step_errors(estimated: Poses, true: Poses) -> Float64[np.ndarray, "m 3"]:
    """Give what is left of each step when the true step is taken back: (x, y, yaw) at the sensor [m, m, rad]."""
    steps, true_steps = (se3.invert(poses[:-1]) @ poses[1:] for poses in (estimated, true))
    left = se3.invert(true_steps) @ steps
    return np.column_stack([left[:, 0, 3], left[:, 1, 3], np.arctan2(left[:, 1, 0], left[:, 0, 0])])


def _nees(
    errors: Float64[np.ndarray, "m 3"], estimated: Poses, step_covariances: Float64[np.ndarray, "n 3 3"]
) -> float:
    in_world = errors.copy()
    in_world[:, :2] = np.einsum("nij,nj->ni", estimated[1:, :2, :2], errors[:, :2])
    claimed = np.isfinite(step_covariances[1:]).all(axis=(1, 2))
    if not claimed.any():
        return float("nan")
    e, C = in_world[claimed], step_covariances[1:][claimed]
    return float(np.mean(np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0])))
