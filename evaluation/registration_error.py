"""How far a registration is off: translation at the object's centre, turn, and shares within the paper's levels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from registration import planar, se3
from registration.types import Point, Transform

# Joint levels of AlignNet-3D's tables: (translation [m], turn [deg]), strictly below.
LEVELS = ((0.02, 1.0), (0.10, 5.0), (0.20, 10.0))

Errors = Float64[np.ndarray, "n 2"]  # rows of (translation [m], turn [rad])


@dataclass(frozen=True, slots=True)
class RegistrationScore:
    """A row of the registration table; NaN where n is 0.

    Attributes:
        n: number of pairs.
        share_2cm_1deg: share of pairs off by less than 2 cm and less than 1 degree; likewise the next two.
        rmse_t: [m].
        rmse_r_deg: [deg].
    """

    n: int
    share_2cm_1deg: float
    share_10cm_5deg: float
    share_20cm_10deg: float
    rmse_t: float
    rmse_r_deg: float


def pair_error(
    T_estimated: Transform, T_true: Transform, center: Point, heading_axis: bool = True
) -> Float64[np.ndarray, "2"]:
    """Compare two motions at a centre given in the source frame: horizontal distance [m] and turn [rad].

    Args:
        T_estimated: T_target_source of a method.
        T_true: the true one.
        center: the object's true centre in the source frame; both motions are taken about it.
        heading_axis: forgive a turn by pi (the paper's choice for cars and persons).

    Source: AlignNet-3D (3DV 2019), section 4.1, and its released evaluation.
    """
    off = planar.motion_about(T_estimated, center) - planar.motion_about(T_true, center)
    turn = abs(planar.wrap(float(off[2])))
    if heading_axis:
        turn = min(turn, np.pi - turn)
    return np.array([np.hypot(off[0], off[1]), turn])


def score(errors: Errors) -> RegistrationScore:
    """Sum up the errors of many pairs."""
    n = len(errors)
    if n == 0:
        nan = float("nan")
        return RegistrationScore(0, nan, nan, nan, nan, nan)
    turn_deg = np.rad2deg(errors[:, 1])
    near, closer, closest = (float(np.mean((errors[:, 0] < t) & (turn_deg < deg))) for t, deg in reversed(LEVELS))
    return RegistrationScore(
        n=n,
        share_2cm_1deg=closest,
        share_10cm_5deg=closer,
        share_20cm_10deg=near,
        rmse_t=float(np.sqrt(np.mean(errors[:, 0] ** 2))),
        rmse_r_deg=float(np.sqrt(np.mean(turn_deg**2))),
    )


def box_motion(T_source_obj: Transform, T_target_obj: Transform) -> Transform:
    """Give the planar motion that carries a box from its first pose to its second: T_target_source."""
    yaw = se3.yaw(T_target_obj) - se3.yaw(T_source_obj)
    center_source, center_target = T_source_obj[:3, 3], T_target_obj[:3, 3]
    turn = se3.from_yaw(yaw, np.zeros(3))
    return se3.pose(turn[:3, :3], center_target - turn[:3, :3] @ center_source)
