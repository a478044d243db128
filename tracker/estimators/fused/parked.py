"""What stands in the world: the one motion that is common, exact, and worth a hypothesis of its own."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import speeds
from tracker.estimators.fused.steps import SLIP_SD, Steps
from tracker.estimators.fused.window import Window

CHANGING = (0.2, 3.0)  # share of what moves that changes its velocity; standard deviation of the acceleration [m/s^2]
PLACE_SD = 0.02  # of the ego's own place between two frames of a window [m]
STANDING_SD = 0.02  # of the velocity of what stands [m/s]


def settle(windows: Sequence[Window], steps: Steps) -> Steps:
    """Weigh the velocities of a frame's objects, in the world, with how fast objects are there, and which stand.

    Args:
        windows: of the objects.
        steps: of these; the latest one of each leads to the frame.
    """
    logs = log_likelihoods(windows, steps.slips[steps.ends - 1, 0])
    shares = speeds.learned(logs)
    standing = speeds.of_class(shares, logs)[0]
    measured, _ = speeds.together(steps)
    nowhere = np.zeros_like(measured.means), np.zeros_like(measured.covariances)
    sds = np.array([sd for _, sd in speeds.MOVING])
    means, covariances, gains = speeds.mixed(measured, nowhere, sds, shares[1:], 1.0 - standing)
    standing = standing / (standing + (1.0 - standing) * gains)
    return mixed(measured._replace(means=means, covariances=covariances).given_to(steps), standing)


def log_likelihoods(windows: Sequence[Window], slips: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, "c k"]:
    """Say how well standing and moving, slowly or fast, explain where objects were throughout their windows.

    The displacement's likelihood is a normal's about 0; moving makes it wider by the speed's.  So is that of how far
    the middle is off the line: what turns back may be where it was without ever having stood.  Source: Bayes' theorem
    over the mixture; each window is judged anew, since those of neighbouring frames share their evidence.

    Args:
        windows: of K objects.
        slips: probability that what is seen of each is off by SLIP_SD.

    Returns:
        for each of `speeds.SHARES`.
    """
    steps, seconds, covariances = _since(windows, [0] * len(windows))
    halves, shorts, half_covariances = _since(windows, [(len(window) - 1) // 2 for window in windows])
    sure, off = np.log(1.0 - slips), np.log(slips)
    one, sds = np.eye(2), np.array([0.0, *(sd for _, sd in speeds.MOVING)])
    beside = ((sds[:, None] * seconds) ** 2)[:, :, None, None] * one
    surely = sure + speeds.log_densities(steps, covariances + beside)
    classes = np.logaddexp(surely, off + speeds.log_densities(steps, covariances + SLIP_SD**2 * one + beside))
    bends, (share, acceleration) = halves - (shorts / seconds)[:, None] * steps, CHANGING
    wide = half_covariances + ((0.5 * acceleration * shorts * (seconds - shorts)) ** 2)[:, None, None] * one
    steady = speeds.log_densities(bends, half_covariances)
    changing = np.logaddexp(np.log(1.0 - share) + steady, np.log(share) + speeds.log_densities(bends, wide))
    return np.concatenate([classes[:1] + steady, classes[1:] + changing])


def _since(
    windows: Sequence[Window], numbers: Sequence[int]
) -> tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, " k"], Float64[np.ndarray, "k 2 2"]]:
    """Give each displacement since a frame, the time, and the displacement's covariance."""
    steps = np.array([window.state[-1, 0] - window.state[i, 0] for window, i in zip(windows, numbers, strict=True)])
    seconds = np.array([window.times[-1] - window.times[i] for window, i in zip(windows, numbers, strict=True)])
    known = np.array([window.difference(i) for window, i in zip(windows, numbers, strict=True)])
    return steps, seconds, known + PLACE_SD**2 * np.eye(2)


def mixed(steps: Steps, standing: Float64[np.ndarray, " k"]) -> Steps:
    """Give mean and covariance of velocities that are 0 with a probability, each object's own, else as estimated."""
    share, v = standing[steps.owners][:, None], steps.velocities
    moving, squares = 1.0 - share, v[:, :, None] * v[:, None, :]
    spread = moving[:, None] * steps.covariances + share[:, None] * STANDING_SD**2 * np.eye(2)
    spread = spread + (share * moving)[:, None] * squares
    return replace(steps, velocities=moving * v, covariances=spread, doubts=moving[:, None] * steps.doubts)
