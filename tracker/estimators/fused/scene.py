"""What most objects of a frame have in common: the motion of all that stands, as a moving sensor sees it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import scene_kernels, speeds
from tracker.estimators.fused.steps import Steps

# How fast objects move against what stands: share of all, and standard deviation of each of vx, vy [m/s].  The first
# stand; how exactly was fitted on simulated training sequences, whose labels wobble.
SPEEDS = ((speeds.STANDING, 0.15), *speeds.MOVING)
# Information about the sensor's own velocity and turn before anything was seen: 30 m/s, 0.4 rad/s.
PRIOR = np.diag([30.0**-2, 30.0**-2, 0.4**-2])
# White noise of the change of these, as of a sensor that brakes and turns [m^2/s^3, rad^2/s^3].
DRIFT = np.diag([4.0, 4.0, 0.01])
LEAST_STANDING = 1.8  # objects that stand, for what they have in common to be kept
WRONG = 0.05  # probability that what was kept is not the motion of what stands
VARIANCES = np.array([sd**2 for _, sd in SPEEDS])
MOST_PAIRED = 30  # objects, the surest, whose pairs are tried
N_REFINEMENTS = 4

Matrices = Float64[np.ndarray, "*k 3 3"]
Triples = Float64[np.ndarray, "*k 3"]
Logs = Float64[np.ndarray, "c *k"]  # one for each of SPEEDS


@dataclass(frozen=True)
class Rigid:
    """How all that stands moves, as a moving sensor sees it: with u + w x p at place p.

    Attributes:
        mean: ux, uy [m/s] and w [rad/s].
        information: inverse covariance of these.
    """

    mean: Float64[np.ndarray, "3"]
    information: Float64[np.ndarray, "3 3"]

    def later(self, seconds: float) -> "Rigid":
        """Say what is left of that some time later."""
        return Rigid(self.mean, np.linalg.inv(np.linalg.inv(self.information) + seconds * DRIFT))

    def parts(self) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"], float]:
        """Give mean, information, and the logarithm of its determinant."""
        return self.mean, self.information, float(np.linalg.slogdet(self.information)[1])


UNKNOWN = Rigid(np.zeros(3), PRIOR)


def settle(steps: Steps, before: Rigid) -> tuple[Steps, Rigid]:
    """Weigh the velocities of a frame's objects, in the sensor's axes, with what most of them have in common.

    What stands moves as one rigid body: at place p by u + w x p.  Which objects stand is not known: (u, w) is what
    most of them agree with over their latest step, and goes on as it was before.  An object moves against it by a speed
    out of `SPEEDS`, and gets mean and covariance of that mixture.  What it is weighed with comes from the others alone,
    so an object alone stays nearly as it is; steps over a frame without points stay quite so.

    Source: Bayes' theorem over a mixture of normals; (u, w) by RANSAC (Fischler & Bolles, Comm. ACM 24(6), 1981) over
    all pairs, then expectation maximisation.

    Args:
        steps: of the objects of one frame; the latest one of each leads to it.
        before: what earlier frames tell of (u, w).

    Returns:
        the steps, and what is now told of (u, w): what two objects or more have in common, if that is surer than what
        was told before, and not both, since neighbouring frames share their evidence.
    """
    measured, places = speeds.together(steps)
    expected, doubt, common = _of_others(places, measured, before)
    is_known, sds = measured.is_known[:, 0], np.array([sd for _, sd in SPEEDS])
    off, covariances = (measured.means - expected)[:, 0], measured.expected_covariances()[:, 0] + doubt[:, 0]
    logs, shares = _densities(off, covariances), np.tile(speeds.SHARES[:, None], len(places))
    shares[:, is_known] = speeds.learned(logs[:, is_known])
    moving = np.where(is_known, 1.0 - speeds.of_class(shares, logs)[0], 0.0)
    means, covariances, _ = speeds.mixed(measured, (expected, doubt), sds, shares, moving)
    return measured._replace(means=means, covariances=covariances).given_to(steps), common


def _of_others(
    places: Float64[np.ndarray, "k n 2"], measured: speeds.Velocities, before: Rigid
) -> tuple[Float64[np.ndarray, "k n 2"], Float64[np.ndarray, "k n 2 2"], Rigid]:
    """Say how each object (k) would move n steps back if it stood, as the others tell, and how sure that is."""
    velocities, covariances, is_known = measured.means, measured.expected_covariances(), measured.is_known
    H = np.zeros((*places.shape, 3))
    H[..., 0, 0] = H[..., 1, 1] = 1.0
    H[..., 0, 2], H[..., 1, 2] = -places[..., 1], places[..., 0]
    weighted = np.swapaxes(H, -1, -2) @ np.linalg.inv(covariances + SPEEDS[0][1] ** 2 * np.eye(2))
    A, a = (weighted @ H) * is_known[..., None, None], (weighted @ velocities[..., None])[..., 0] * is_known[..., None]
    now, standing = np.flatnonzero(is_known[:, 0]), np.zeros(len(places))
    own = velocities[now, 0], covariances[now, 0]
    standing[now], known = _standing(places[now, 0], own, (A[now, 0], a[now, 0]), before)
    A, a = standing[:, None, None, None] * A, standing[:, None, None] * a
    own = PRIOR + A[:, 0].sum(axis=0)
    is_surer = standing.sum() > LEAST_STANDING and np.linalg.det(own) > np.linalg.det(before.information)
    common = Rigid(np.linalg.solve(own, a[:, 0].sum(axis=0)), own) if is_surer else before
    A_before, a_before = np.tile(PRIOR, (A.shape[1], 1, 1)), np.zeros(a.shape[1:])
    A_before[0], a_before[0] = known.information, known.information @ known.mean
    doubt = np.linalg.inv(A_before + A.sum(axis=0) - A)
    rigid = doubt @ (a_before + a.sum(axis=0) - a)[..., None]
    return (H @ rigid)[..., 0], H @ doubt @ np.swapaxes(H, -1, -2), common


def _standing(
    places: speeds.Vectors,
    measured: tuple[speeds.Vectors, speeds.Squares],
    told: tuple[Matrices, Triples],
    before: Rigid,
) -> tuple[Float64[np.ndarray, " k"], Rigid]:
    """Say with which probability each object stands: moves as most of them do, and they did before; or not as before.

    Returns:
        the probabilities, and what is known of the motion beside these objects.
    """
    _, covariances = measured
    surest = np.argsort(np.trace(covariances, axis1=1, axis2=2), kind="stable")[:MOST_PAIRED]
    standing, is_before = scene_kernels.standing(
        places, measured, told, surest, before.parts(), UNKNOWN.parts(), VARIANCES, WRONG, N_REFINEMENTS
    )
    return standing, before if is_before else UNKNOWN


def _densities(off: speeds.Vectors, covariances: Float64[np.ndarray, "*l 2 2"]) -> Logs:
    """Give the log densities of differences to what stands, for each of SPEEDS; up to what these have in common."""
    return speeds.log_densities(off, covariances + VARIANCES.reshape(-1, *[1] * covariances.ndim) * np.eye(2))
