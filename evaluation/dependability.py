"""Whether velocities can be relied on: parked objects that seem to move, tracks that stay lost."""

import numpy as np
from jaxtyping import Float64, Int64

MOVING = 0.3  # a parked object at this speed or below is no false alarm [m/s]
LOST = 2.0  # an error above this, ... [m/s]
SETTLED = 5  # ... in every frame after a track's first ones of this number


def false_motion(estimated: Float64[np.ndarray, "n 2"]) -> float:
    """Give the share of parked objects' steps in which they seem to move; NaN where there are none.

    Args:
        estimated: velocities of objects that stand still in the world, in the world frame [m/s].  In the sensor's
            frame a parked object moves as fast as the ego, and nothing tells false motion.
    """
    if len(estimated) == 0:
        return float("nan")
    return float(np.mean(np.hypot(*estimated.T) > MOVING))


def lost_tracks(
    error: Float64[np.ndarray, " n"], tracklet: Int64[np.ndarray, " n"], age: Int64[np.ndarray, " n"]
) -> Int64[np.ndarray, " lost"]:
    """List the tracks whose error stays above 2 m/s in every scored frame after their fifth.

    Args:
        error: length of the error vector of each step [m/s].
        tracklet: which gap-free track the step belongs to.
        age: frames of the track before the one in which the step ends; 5 in the first one after the fifth.

    Returns:
        Their numbers, ascending; a track without a scored frame after the fifth cannot be lost.
    """
    is_settled = age >= SETTLED
    return np.setdiff1d(tracklet[is_settled], tracklet[is_settled & (error <= LOST)])
