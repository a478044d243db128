"""Whether an object stands still: the one motion that is common, exact, and worth a hypothesis of its own."""

import math
from dataclasses import replace

import numpy as np

from tracker.estimators.fused.track import Steps
from tracker.estimators.fused.window import Square, Vector, Window

# How fast objects are, before anything is known: share of all, and standard deviation of each of vx, vy [m/s].
# Slow ones have a share of their own, so that one that rolls is not taken for one that stands, and fast ones too.
STANDING = 0.5
MOVING = ((0.1, 0.5), (0.1, 2.0), (0.15, 8.0), (0.15, 20.0))
CHANGING = (0.2, 3.0)  # share of what moves that changes its velocity; standard deviation of the acceleration [m/s^2]
PLACE_SD = 0.02  # of the ego's own place between two frames of a window [m]
STANDING_SD = 0.02  # of the velocity of what stands [m/s]


def probability(window: Window) -> float:
    """Compare how well standing and moving explain where an object was at the beginning, middle and end of a window.

    The displacement's likelihood is a normal's about 0; moving makes it wider by the speed's share.  So is that of how
    far the middle is off the line: what turns back may be where it was without ever having stood.  Source: Bayes'
    theorem over the mixture; each window is judged anew, since those of neighbouring frames share their evidence.
    """
    middle = (len(window) - 1) // 2
    step, seconds, covariance = _since(window, 0)
    standing = math.log(STANDING) + _log_density(step, covariance)
    moving = np.logaddexp.reduce(
        [
            math.log(share) + _log_density(step, covariance + (speed * seconds) ** 2 * np.eye(2))
            for share, speed in MOVING
        ]
    )
    half, short, covariance = _since(window, middle)
    bend, (share, acceleration) = half - short / seconds * step, CHANGING
    wide = covariance + (0.5 * acceleration * short * (seconds - short)) ** 2 * np.eye(2)
    steady = _log_density(bend, covariance)
    changing = np.logaddexp(math.log(1.0 - share) + steady, math.log(share) + _log_density(bend, wide))
    return float(np.exp(standing + steady - np.logaddexp(standing + steady, moving + changing)))


def _since(window: Window, i: int) -> tuple[Vector, float, Square]:
    """Give the displacement since frame i, the time, and the displacement's covariance."""
    step: Vector = window.state[-1, 0] - window.state[i, 0]
    return step, window.times[-1] - window.times[i], window.difference(i) + PLACE_SD**2 * np.eye(2)


def mixed(steps: Steps, standing: float) -> Steps:
    """Give mean and covariance of velocities that are 0 with a probability, and as estimated otherwise."""
    moving, v = 1.0 - standing, steps.velocities
    spread = moving * steps.covariances + standing * STANDING_SD**2 * np.eye(2)
    spread = spread + standing * moving * v[:, :, None] * v[:, None, :]
    return replace(steps, velocities=moving * v, covariances=spread)


def _log_density(x: Vector, covariance: Square) -> float:
    (a, b), (_, c) = covariance.tolist()
    u, v = x.tolist()
    determinant = a * c - b * b
    return -0.5 * ((c * u * u - 2.0 * b * u * v + a * v * v) / determinant + math.log(determinant))
