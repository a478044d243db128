"""Whether an object stands still: the one motion that is common, exact, and worth a hypothesis of its own."""

from dataclasses import replace

import numpy as np

from tracker.estimators.fused.track import Steps
from tracker.estimators.fused.window import Square, Vector, Window

# How fast objects are, before anything is known: share of all, and standard deviation of each of vx, vy [m/s].
# Slow ones have a share of their own, so that one that rolls is not taken for one that stands.
STANDING = 0.5
MOVING = ((0.1, 0.5), (0.1, 2.0), (0.3, 8.0))
PLACE_SD = 0.02  # of the ego's own place between two frames of a window [m]
STANDING_SD = 0.02  # of the velocity of what stands [m/s]


def probability(window: Window) -> float:
    """Compare how well standing and moving explain the displacement over a window.

    The displacement's likelihood is a normal's about 0; moving makes it wider by the speed's share.  Source: Bayes'
    theorem over the mixture; each window is judged anew, since those of neighbouring frames share their evidence.
    """
    step: Vector = window.state[-1, 0] - window.state[0, 0]
    seconds = window.times[-1] - window.times[0]
    covariance = window.difference(0) + PLACE_SD**2 * np.eye(2)
    standing = STANDING * _density(step, covariance)
    moving = sum(share * _density(step, covariance + (speed * seconds) ** 2 * np.eye(2)) for share, speed in MOVING)
    return float(standing / (standing + moving))


def mixed(steps: Steps, standing: float) -> Steps:
    """Give mean and covariance of velocities that are 0 with a probability, and as estimated otherwise."""
    moving, v = 1.0 - standing, steps.velocities
    spread = moving * steps.covariances + standing * STANDING_SD**2 * np.eye(2)
    spread = spread + standing * moving * v[:, :, None] * v[:, None, :]
    return replace(steps, velocities=moving * v, covariances=spread)


def _density(x: Vector, covariance: Square) -> float:
    distance = float(x @ np.linalg.solve(covariance, x))
    return float(np.exp(-0.5 * distance) / np.sqrt(np.linalg.det(covariance)))
