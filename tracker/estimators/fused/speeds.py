"""How fast objects are before one is measured: as most are, as those are that are in sight, and as one of these is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from tracker.estimators.fused import speed_kernels
from tracker.estimators.fused.steps import Steps

# How fast objects are: share of all, and standard deviation of each of vx, vy [m/s].  Slow ones have a share of their
# own, so that one that rolls is not taken for one that stands, and fast ones too.
STANDING = 0.5
MOVING = ((0.1, 0.5), (0.1, 2.0), (0.15, 8.0), (0.15, 20.0))
SHARES = np.array([STANDING, *(share for share, _ in MOVING)])
LEARNED_FROM = 4.0  # objects that these shares count for, beside those in sight
# Share of the objects that move as another one does that is in sight, as in a lane, if all others move; standard
# deviation of the difference along each axis [m/s].
FLOW_SHARE, FLOW_SD = 0.3, 2.0
MOST_GAIN = 50.0  # logarithm of how much likelier that can make a velocity: no overflow where all objects leap at once

Vectors = Float64[np.ndarray, "*k 2"]
Squares = Float64[np.ndarray, "*k 2 2"]
Shares = Float64[np.ndarray, "c k"]
Probabilities = Float64[np.ndarray, " k"]
Indices = Int64[np.ndarray, " m"]
Expected = tuple[Float64[np.ndarray, "k n 2"], Float64[np.ndarray, "k n 2 2"]]


class Velocities(NamedTuple):
    """Measured velocities of K objects at N times, the latest first.

    Attributes:
        means: [m/s].
        covariances: of these.
        is_known: whether there are any.
        slips: probability that each is off, and the variance that it then has beside its own [m^2/s^2].
    """

    means: Float64[np.ndarray, "k n 2"]
    covariances: Float64[np.ndarray, "k n 2 2"]
    is_known: Bool[np.ndarray, "k n"]
    slips: Float64[np.ndarray, "k n 2"]

    def expected_covariances(self) -> Float64[np.ndarray, "k n 2 2"]:
        """Give the covariances of both errors together."""
        return self.covariances + self.slips.prod(axis=2)[:, :, None, None] * np.eye(2)

    def given_to(self, steps: Steps) -> Steps:
        """Give the objects' steps these velocities, where they have a place among them."""
        velocities, covariances = steps.velocities.copy(), steps.covariances.copy()
        speed_kernels.apart(*_slots(steps), self.means, self.covariances, velocities, covariances)
        return steps._replace(velocities=velocities, covariances=covariances)


def together(steps: Steps) -> tuple[Velocities, Float64[np.ndarray, "k n 2"]]:
    """Put the velocities of all objects side by side, and where these were [m]; no steps over several frames."""
    n_objects, n = len(steps.centers), int(np.bincount(steps.owners).max())
    means, places, slips = np.zeros((3, n_objects, n, 2))
    covariances, is_known = np.zeros((n_objects, n, 2, 2)), np.zeros((n_objects, n), dtype=np.bool_)
    covariances[:, :, 0, 0] = covariances[:, :, 1, 1] = 1.0
    own = steps.velocities, steps.covariances, steps.places, steps.slips
    speed_kernels.together(*_slots(steps), *own, (means, covariances, is_known, slips, places))
    return Velocities(means, covariances, is_known, slips), places


def _slots(steps: Steps) -> tuple[Indices, Int64[np.ndarray, " k"], Indices, Indices]:
    """Give what tells which steps are from one frame to the next, whose, and how many frames ago they ended."""
    return steps.owners, steps.ends, steps.numbers, steps.lengths


def of_class(shares: Shares, logs: Shares) -> Shares:
    """Give the probability of each class (C) for each object (K), from shares and log likelihoods."""
    found: Shares = speed_kernels.of_class(shares, logs)
    return found


def learned(logs: Shares) -> Shares:
    """Give the shares of all classes for each object, as all the others in sight have them.

    Source: the mean of a Dirichlet distribution, `LEARNED_FROM` objects strong, after one step of expectation
    maximisation.

    Args:
        logs: log likelihoods of C classes for K objects that were measured.
    """
    found: Shares = speed_kernels.learned(SHARES, np.ascontiguousarray(logs), LEARNED_FROM)
    return found


def mixed(
    measured: Velocities, expected: Expected, sds: Float64[np.ndarray, " c"], shares: Shares, moving: Probabilities
) -> tuple[Vectors, Squares, Probabilities]:
    """Weigh velocities with how fast objects may be.

    Args:
        measured: velocities.
        expected: mean and covariance of those that what stands would have (k n 2), (k n 2 2) [m/s].
        sds: how fast classes of objects are against that, along each axis [m/s].
        shares: of these classes, for each object.
        moving: probability that each object moves against what stands.

    Returns:
        means and covariances (k n 2), (k n 2 2), and by which factor each object's latest velocity is likelier since
        it may move as another one does.
    """
    means, covariances, gains = speed_kernels.mix(
        *measured, *expected, sds**2, np.ascontiguousarray(shares), moving, (FLOW_SHARE, FLOW_SD**2)
    )
    return means, covariances, np.exp(np.minimum(gains, MOST_GAIN))


def log_densities(off: Vectors, covariances: Float64[np.ndarray, "*l 2 2"]) -> Float64[np.ndarray, "..."]:
    """Give the logarithm of a normal's density, but for a constant; arguments are broadcast."""
    a, b, c = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    x, y = off[..., 0], off[..., 1]
    determinant = a * c - b * b
    return -0.5 * (np.log(determinant) + (c * x * x - 2.0 * b * x * y + a * y * y) / determinant)
