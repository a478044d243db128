"""What most objects of a frame have in common: the motion of all that stands, as a moving sensor sees it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64

from tracker.estimators.fused.track import Steps

# How fast objects move against what stands, before anything is known: share of all, and standard deviation of each of
# vx, vy [m/s].  The first stand; slow ones have a share of their own, so that one that rolls is not taken to stand.
SPEEDS = ((0.5, 0.15), (0.1, 0.5), (0.1, 2.0), (0.3, 8.0))
# Information about the sensor's own velocity and turn before anything was seen: 30 m/s, 0.4 rad/s.
PRIOR = np.diag([30.0**-2, 30.0**-2, 0.4**-2])
N_REFINEMENTS = 4

Vectors = Float64[np.ndarray, "k n 2"]
Squares = Float64[np.ndarray, "k n 2 2"]
Known = Bool[np.ndarray, "k n"]
Systems = tuple[Float64[np.ndarray, "k n 3 3"], Float64[np.ndarray, "k n 3"]]
Shares = Float64[np.ndarray, " k"]


def settle(tracks: Sequence[Steps]) -> list[Steps]:
    """Weigh the velocities of a frame's objects, in the sensor's axes, with what most of them have in common.

    What stands moves as one rigid body: at place p by u + w x p.  Which objects stand is not known: (u, w) is what
    most of them agree with over their latest step.  An object moves against it by a speed out of `SPEEDS`, and gets
    mean and covariance of that mixture.  What it is weighed with comes from the others alone, so an object alone stays
    as it is; so do steps over a frame without points.

    Source: Bayes' theorem over a mixture of normals; (u, w) by RANSAC (Fischler & Bolles, Comm. ACM 24(6), 1981) over
    all pairs, then expectation maximisation.

    Args:
        tracks: of one frame; all of them have a step that leads to it.
    """
    if len(tracks) < 2:
        return list(tracks)
    latest, n = max(steps.frames[-1] for steps in tracks), max(len(steps.frames) for steps in tracks)
    places, velocities = np.zeros((2, len(tracks), n, 2))
    covariances, is_known = np.tile(np.eye(2), (len(tracks), n, 1, 1)), np.zeros((len(tracks), n), dtype=np.bool_)
    for k, steps in enumerate(tracks):
        back = latest - steps.frames
        own = np.flatnonzero((back < n) & (steps.lengths == 1))
        back = back[own]
        places[k, back], velocities[k, back] = steps.places[own], steps.velocities[own]
        covariances[k, back], is_known[k, back] = steps.covariances[own], True
    if is_known[:, 0].sum() > 1:
        velocities, covariances = _weighed(places, velocities, covariances, is_known)
    return [_taken(steps, latest, velocities[k], covariances[k], is_known[k]) for k, steps in enumerate(tracks)]


def _taken(
    steps: Steps,
    latest: int,
    velocities: Float64[np.ndarray, "n 2"],
    covariances: Float64[np.ndarray, "n 2 2"],
    is_known: Bool[np.ndarray, " n"],
) -> Steps:
    back = latest - steps.frames
    use = np.flatnonzero((back < len(is_known)) & (steps.lengths == 1))
    v, C = steps.velocities.copy(), steps.covariances.copy()
    v[use], C[use] = velocities[back[use]], covariances[back[use]]
    return replace(steps, velocities=v, covariances=C)


def _weighed(places: Vectors, velocities: Vectors, covariances: Squares, is_known: Known) -> tuple[Vectors, Squares]:
    """Give mean and covariance of all velocities (k objects, n steps back) under the mixture."""
    H = np.zeros((*places.shape, 3))
    H[..., 0, 0] = H[..., 1, 1] = 1.0
    H[..., 0, 2], H[..., 1, 2] = -places[..., 1], places[..., 0]
    weighted = np.swapaxes(H, -1, -2) @ np.linalg.inv(covariances + SPEEDS[0][1] ** 2 * np.eye(2))
    A, a = weighted @ H, (weighted @ velocities[..., None])[..., 0]
    A, a = A * is_known[..., None, None], a * is_known[..., None]
    now = np.flatnonzero(is_known[:, 0])
    shares = np.zeros(len(places))
    shares[now] = _standing(H[now, 0], velocities[now, 0], covariances[now, 0], A[now, 0], a[now, 0])
    A, a = shares[:, None, None, None] * A, shares[:, None, None] * a
    others = np.linalg.inv(PRIOR + A.sum(axis=0) - A)
    rigid = others @ (a.sum(axis=0) - a)[..., None]
    expected, doubt = (H @ rigid)[..., 0], H @ others @ np.swapaxes(H, -1, -2)
    logs, means, spreads = _mixture(velocities - expected, covariances, doubt)
    weights = np.exp(logs - logs.max(axis=0))
    weights /= weights.sum(axis=0)
    mean = np.einsum("c...,c...i->...i", weights, means)
    off = means - mean
    spread = np.einsum("c...,c...ij->...ij", weights, spreads + off[..., :, None] * off[..., None, :])
    return expected + mean, spread


def _standing(H, velocities, covariances, A, a):
    """Say with which probability each object stands: moves as most of them do."""
    i, j = np.triu_indices(len(H), 1)
    rigid = np.linalg.solve(PRIOR + A[i] + A[j], (a[i] + a[j])[..., None])[..., 0]
    logs = _densities(velocities - np.einsum("kij,pj->pki", H, rigid), covariances)
    best = rigid[np.logaddexp.reduce(logs, axis=0).sum(axis=1).argmax()]
    for _ in range(N_REFINEMENTS):
        logs = _densities(velocities - H @ best, covariances)
        shares = np.exp(logs[0] - np.logaddexp.reduce(logs, axis=0))
        best = np.linalg.solve(PRIOR + np.tensordot(shares, A, 1), shares @ a)
    return shares


def _densities(off, covariances):
    """Give the log densities of what velocities differ by from those of what stands, for each of SPEEDS."""
    logs = []
    for share, sd in SPEEDS:
        total = covariances + sd**2 * np.eye(2)
        det = total[..., 0, 0] * total[..., 1, 1] - total[..., 0, 1] * total[..., 1, 0]
        x, y = off[..., 0], off[..., 1]
        distance = (total[..., 1, 1] * x * x - 2.0 * total[..., 0, 1] * x * y + total[..., 0, 0] * y * y) / det
        logs.append(np.log(share) - 0.5 * (np.log(det) + distance))
    return np.array(logs)


def _mixture(off, covariances, doubt):
    """Give log weight, mean and covariance of each of SPEEDS, given velocities that differ by `off` from what stands."""
    logs, means, spreads = _densities(off, covariances + doubt), [], []
    for _, sd in SPEEDS:
        gain = covariances @ np.linalg.inv(covariances + doubt + sd**2 * np.eye(2))
        means.append(off - (gain @ off[..., None])[..., 0])
        spreads.append(covariances - gain @ covariances)
    return logs, np.array(means), np.array(spreads)
