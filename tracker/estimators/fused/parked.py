"""What stands in the world: the one motion that is common, exact, and worth a hypothesis of its own."""

import numpy as np

from tracker.estimators.fused import parked_kernels, speeds
from tracker.estimators.fused.step_kernels import SLIP_SD
from tracker.estimators.fused.steps import Steps
from tracker.estimators.fused.window import Rows, Windows

CHANGING = (0.2, 3.0)  # share of what moves that changes its velocity; standard deviation of the acceleration [m/s^2]
PLACE_SD = 0.02  # of the ego's own place between two frames of a window [m]
STANDING_SD = 0.02  # of the velocity of what stands [m/s]
VARIANCES = PLACE_SD**2, SLIP_SD**2, STANDING_SD**2
SPEEDS = np.array([0.0, *(sd for _, sd in speeds.MOVING)])  # of each of `speeds.SHARES`, along each axis [m/s]


def settle(windows: Windows, at: Rows, steps: Steps) -> Steps:
    """Weigh the velocities of a frame's objects, in the world, with how fast objects are there, and which stand.

    Args:
        windows: of the objects.
        at: their rows.
        steps: of these; the latest one of each leads to the frame.
    """
    slots = steps.owners, steps.ends, steps.numbers, steps.lengths
    own = *slots, steps.velocities, steps.covariances, steps.places, steps.slips, steps.doubts
    velocities, covariances, doubts = parked_kernels.settle(
        windows.rows.frames,
        at,
        own,
        (speeds.SHARES, SPEEDS, speeds.LEARNED_FROM),
        VARIANCES,
        CHANGING,
        (speeds.FLOW_SHARE, speeds.FLOW_SD**2, speeds.MOST_GAIN),
    )
    return steps._replace(velocities=velocities, covariances=covariances, doubts=doubts)
