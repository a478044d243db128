"""What most objects of a frame have in common: the motion of all that stands, as a moving sensor sees it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import speeds
from tracker.estimators.fused.track import Steps

# How fast objects move against what stands: share of all, and standard deviation of each of vx, vy [m/s].  The first
# stand; how exactly was fitted on simulated training sequences, whose labels wobble.
SPEEDS = ((speeds.STANDING, 0.15), *speeds.MOVING)
# Information about the sensor's own velocity and turn before anything was seen: 30 m/s, 0.4 rad/s.
PRIOR = np.diag([30.0**-2, 30.0**-2, 0.4**-2])
N_REFINEMENTS = 4

Places = Float64[np.ndarray, "*k 2 3"]  # how u + w x p at a place p depends on (ux, uy, w)
Matrices = Float64[np.ndarray, "*k 3 3"]
Triples = Float64[np.ndarray, "*k 3"]
Logs = Float64[np.ndarray, "c *k"]  # one for each of SPEEDS


def settle(tracks: Sequence[Steps]) -> list[Steps]:
    """Weigh the velocities of a frame's objects, in the sensor's axes, with what most of them have in common.

    What stands moves as one rigid body: at place p by u + w x p.  Which objects stand is not known: (u, w) is what
    most of them agree with over their latest step.  An object moves against it by a speed out of `SPEEDS`, and gets
    mean and covariance of that mixture.  What it is weighed with comes from the others alone, so an object alone stays
    as it is; so do steps over a frame without points.

    Source: Bayes' theorem over a mixture of normals; (u, w) by RANSAC (Fischler & Bolles, Comm. ACM 24(6), 1981) over
    all pairs, then expectation maximisation.

    Args:
        tracks: of one frame; the latest step of each leads to it.
    """
    measured, places = speeds.together(tracks)
    expected, doubt = _of_others(places, measured)
    is_known, sds = measured.is_known[:, 0], np.array([sd for _, sd in SPEEDS])
    off, covariances = (measured.means - expected)[:, 0], measured.expected_covariances()[:, 0] + doubt[:, 0]
    logs, shares = _densities(off, covariances), np.tile(speeds.SHARES[:, None], len(tracks))
    shares[:, is_known] = speeds.learned(logs[:, is_known])
    moving = np.where(is_known, 1.0 - speeds.of_class(shares, logs)[0], 0.0)
    means, covariances, _ = speeds.mixed(measured, (expected, doubt), sds, shares, moving)
    return measured._replace(means=means, covariances=covariances).given_to(tracks)


def _of_others(places: Float64[np.ndarray, "k n 2"], measured: speeds.Velocities) -> speeds.Expected:
    """Say how each object (k) would move n steps back if it stood, as the others tell, and how sure that is."""
    velocities, covariances, is_known = measured.means, measured.expected_covariances(), measured.is_known
    H = np.zeros((*places.shape, 3))
    H[..., 0, 0] = H[..., 1, 1] = 1.0
    H[..., 0, 2], H[..., 1, 2] = -places[..., 1], places[..., 0]
    weighted = np.swapaxes(H, -1, -2) @ np.linalg.inv(covariances + SPEEDS[0][1] ** 2 * np.eye(2))
    A, a = (weighted @ H) * is_known[..., None, None], (weighted @ velocities[..., None])[..., 0] * is_known[..., None]
    now = np.flatnonzero(is_known[:, 0])
    standing = np.zeros(len(places))
    if len(now) > 1:
        standing[now] = _standing(H[now, 0], velocities[now, 0], covariances[now, 0], A[now, 0], a[now, 0])
    A, a = standing[:, None, None, None] * A, standing[:, None, None] * a
    doubt = np.linalg.inv(PRIOR + A.sum(axis=0) - A)
    rigid = doubt @ (a.sum(axis=0) - a)[..., None]
    return (H @ rigid)[..., 0], H @ doubt @ np.swapaxes(H, -1, -2)


def _standing(
    H: Places, velocities: speeds.Vectors, covariances: speeds.Squares, A: Matrices, a: Triples
) -> Float64[np.ndarray, " k"]:
    """Say with which probability each object stands: moves as most of them do."""
    i, j = np.triu_indices(len(H), 1)
    rigid = np.linalg.solve(PRIOR + A[i] + A[j], (a[i] + a[j])[..., None])[..., 0]
    logs = _densities(velocities - np.einsum("kij,pj->pki", H, rigid), covariances)
    best = rigid[np.logaddexp.reduce(logs, axis=0).sum(axis=1).argmax()]
    standing = np.zeros(len(H))
    for _ in range(N_REFINEMENTS):
        logs = _densities(velocities - H @ best, covariances)
        standing = np.exp(logs[0] - np.logaddexp.reduce(logs, axis=0))
        best = np.linalg.solve(PRIOR + np.tensordot(standing, A, 1), standing @ a)
    return standing


def _densities(off: speeds.Vectors, covariances: Float64[np.ndarray, "*l 2 2"]) -> Logs:
    """Give the log densities of differences to what stands, for each of SPEEDS; up to what these have in common."""
    return np.array([speeds.log_densities(off, covariances + sd**2 * np.eye(2)) for _, sd in SPEEDS])
