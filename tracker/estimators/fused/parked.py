"""What stands in the world: the one motion that is common, exact, and worth a hypothesis of its own."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import parked_kernels, speed_kernels, speeds
from tracker.estimators.fused.step_kernels import SLIP_SD
from tracker.estimators.fused.steps import Steps
from tracker.estimators.fused.window import Rows, Windows

CHANGING = (0.2, 3.0)  # share of what moves that changes its velocity; standard deviation of the acceleration [m/s^2]
PLACE_SD = 0.02  # of the ego's own place between two frames of a window [m]
STANDING_SD = 0.02  # of the velocity of what stands [m/s]
SPEEDS = np.array([0.0, *(sd for _, sd in speeds.MOVING)])  # of each of `speeds.SHARES`, along each axis [m/s]


def settle(windows: Windows, at: Rows, steps: Steps) -> Steps:
    """Weigh the velocities of a frame's objects, in the world, with how fast objects are there, and which stand.

    Args:
        windows: of the objects.
        at: their rows.
        steps: of these; the latest one of each leads to the frame.
    """
    logs = log_likelihoods(windows, at, steps.slips[steps.ends - 1, 0])
    shares = speeds.learned(logs)
    standing = speeds.of_class(shares, logs)[0]
    measured, _ = speeds.together(steps)
    nowhere = np.zeros_like(measured.means), np.zeros_like(measured.covariances)
    means, covariances, gains = speeds.mixed(measured, nowhere, SPEEDS[1:], shares[1:], 1.0 - standing)
    standing = standing / (standing + (1.0 - standing) * gains)
    return mixed(measured._replace(means=means, covariances=covariances).given_to(steps), standing)


def log_likelihoods(windows: Windows, at: Rows, slips: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, "c k"]:
    """Say how well standing and moving, slowly or fast, explain where objects were throughout their windows.

    The displacement's likelihood is a normal's about 0; moving makes it wider by the speed's.  So is that of how far
    the middle is off the line: what turns back may be where it was without ever having stood.  Source: Bayes' theorem
    over the mixture; each window is judged anew, since those of neighbouring frames share their evidence.

    Args:
        windows: of objects.
        at: rows of K of them.
        slips: probability that what is seen of each is off by SLIP_SD.

    Returns:
        for each of `speeds.SHARES`.
    """
    found: Float64[np.ndarray, "c k"] = parked_kernels.log_likelihoods(
        windows.rows.frames, at, slips, SPEEDS, PLACE_SD**2, SLIP_SD**2, CHANGING
    )
    return found


def mixed(steps: Steps, standing: Float64[np.ndarray, " k"]) -> Steps:
    """Give mean and covariance of velocities that are 0 with a probability, each object's own, else as estimated."""
    own = steps.velocities, steps.covariances, steps.doubts
    velocities, covariances, doubts = speed_kernels.halted(steps.owners, standing, STANDING_SD**2, *own)
    return replace(steps, velocities=velocities, covariances=covariances, doubts=doubts)
