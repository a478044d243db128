"""What most objects of a frame have in common: the motion of all that stands, as a moving sensor sees it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from tracker.estimators.fused import parked
from tracker.estimators.fused.track import Steps

# How fast objects move against what stands: share of all, and standard deviation of each of vx, vy [m/s].  The first
# stand; how exactly was fitted on simulated training sequences, whose labels wobble.
SPEEDS = ((parked.STANDING, 0.15), *parked.MOVING)
# Information about the sensor's own velocity and turn before anything was seen: 30 m/s, 0.4 rad/s.
PRIOR = np.diag([30.0**-2, 30.0**-2, 0.4**-2])
N_REFINEMENTS = 4

Vectors = Float64[np.ndarray, "*k 2"]
Squares = Float64[np.ndarray, "*k 2 2"]
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
    if not tracks[1:]:
        return list(tracks)
    n = max(len(steps.frames) for steps in tracks)
    slots = [_slots(steps, n) for steps in tracks]
    velocities, places = np.zeros((2, len(tracks), n, 2))
    covariances, is_known = np.tile(np.eye(2), (len(tracks), n, 1, 1)), np.zeros((len(tracks), n), dtype=np.bool_)
    for k, (steps, (own, back)) in enumerate(zip(tracks, slots, strict=True)):
        velocities[k, back], places[k, back] = steps.velocities[own], steps.places[own]
        covariances[k, back], is_known[k, back] = steps.covariances[own], True
    expected, doubt = _of_others(places, velocities, covariances, is_known)
    velocities, covariances = _mixed(velocities, covariances, expected, doubt)
    settled = []
    for k, (steps, (own, back)) in enumerate(zip(tracks, slots, strict=True)):
        steps = replace(steps, velocities=steps.velocities.copy(), covariances=steps.covariances.copy())
        steps.velocities[own], steps.covariances[own] = velocities[k, back], covariances[k, back]
        settled.append(steps)
    return settled


def _slots(steps: Steps, n: int) -> tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]:
    """Say which of an object's steps are from one frame to the next, and how many frames ago they ended, below n."""
    back = steps.numbers[-1] - steps.numbers
    own = np.flatnonzero((back < n) & (steps.lengths == 1))
    return own, back[own]


def _of_others(
    places: Vectors, velocities: Vectors, covariances: Squares, is_known: Bool[np.ndarray, "k n"]
) -> tuple[Vectors, Squares]:
    """Say how each object (k) would move n steps back if it stood, as the others tell, and how sure that is."""
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
    H: Places, velocities: Vectors, covariances: Squares, A: Matrices, a: Triples
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


def _mixed(velocities: Vectors, covariances: Squares, expected: Vectors, doubt: Squares) -> tuple[Vectors, Squares]:
    """Give mean and covariance of velocities that differ by a speed out of SPEEDS from the expected ones."""
    off = velocities - expected
    logs = _densities(off, covariances + doubt)
    weights = np.exp(logs - np.logaddexp.reduce(logs, axis=0))
    gains = [covariances @ np.linalg.inv(covariances + doubt + sd**2 * np.eye(2)) for _, sd in SPEEDS]
    means = np.array([velocities - (gain @ off[..., None])[..., 0] for gain in gains])
    mean = np.einsum("c...,c...i->...i", weights, means)
    apart = means - mean
    spreads = covariances - np.array([gain @ covariances for gain in gains])
    return mean, np.einsum("c...,c...ij->...ij", weights, spreads + apart[..., :, None] * apart[..., None, :])


def _densities(off: Vectors, covariances: Float64[np.ndarray, "*l 2 2"]) -> Logs:
    """Give the log densities of differences to what stands, for each of SPEEDS; up to what these have in common."""
    logs = []
    for share, sd in SPEEDS:
        C = covariances + sd**2 * np.eye(2)
        det = C[..., 0, 0] * C[..., 1, 1] - C[..., 0, 1] ** 2
        x, y = off[..., 0], off[..., 1]
        distance = (C[..., 1, 1] * x * x - 2.0 * C[..., 0, 1] * x * y + C[..., 0, 0] * y * y) / det
        logs.append(np.log(share) - 0.5 * (np.log(det) + distance))
    return np.array(logs)
