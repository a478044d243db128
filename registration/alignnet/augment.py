"""Make one pair look like many others that a LiDAR might have seen: turns, mirrors, losses, clutter, jitter."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from registration.alignnet.dataset import Batch

LEAST = 5  # a loss that leaves a cloud fewer points than this does not happen
RING = float(np.deg2rad(0.42))  # between two beams [rad]

Kept = Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class AugmentSettings:
    """How often each change happens (a share of clouds, or of pairs) and how strong it is; all off by default."""

    jitter: float = 0.0  # standard deviation of each coordinate, at most 5 of it [m]
    turn: bool = False  # the pair, about the sensor, by any angle
    mirror: float = 0.0  # share of pairs seen in a mirror
    swap: float = 0.0  # share of pairs that run backwards in time
    occlusion: float = 0.0  # share of clouds of which something hides a part
    thinning: float = 0.0  # share of clouds that lose points at random, as farther ones do
    rings: float = 0.0  # share of clouds that lose whole beams
    gaps: float = 0.0  # share of clouds with holes
    crop: float = 0.0  # share of clouds cut by a box that does not fit
    clutter: float = 0.0  # share of clouds with foreign points at the bottom


def augment(batch: Batch, settings: AugmentSettings, rng: np.random.Generator) -> Batch:
    """Apply the changes in the order in which the world makes them: pose, scene, sensor, box."""
    batch = _turned(batch, settings, rng)
    batch = _with_clutter(batch, settings.clutter, rng)
    for share, loss in (
        (settings.occlusion, _hidden),
        (settings.rings, _lost_rings),
        (settings.thinning, _thinned),
        (settings.gaps, _holes),
        (settings.crop, _cropped),
    ):
        if share > 0.0:
            batch = _without(batch, loss(batch, rng) & (rng.random(batch.n_clouds) < share)[batch.cloud])
    if settings.jitter > 0.0:
        noise = np.clip(rng.standard_normal(batch.points.shape, np.float32), -5.0, 5.0)
        batch = replace(batch, points=batch.points + np.float32(settings.jitter) * noise)
    return batch


def _turned(batch: Batch, settings: AugmentSettings, rng: np.random.Generator) -> Batch:
    """Swap, mirror and turn whole pairs about the sensor."""
    half = batch.n_clouds // 2
    if settings.swap > 0.0:
        batch = _swapped(batch, rng.random(half) < settings.swap)
    sign = np.tile(np.where(rng.random(half) < settings.mirror, -1.0, 1.0), 2)
    angle = np.tile(rng.uniform(-np.pi, np.pi, half) * settings.turn, 2)
    points, center = batch.points.copy(), batch.center.copy()
    for rows, s, a in ((points, sign[batch.cloud], angle[batch.cloud]), (center, sign, angle)):
        x, y, cos, sin = rows[:, 0].copy(), s * rows[:, 1], np.cos(a), np.sin(a)
        rows[:, 0], rows[:, 1] = cos * x - sin * y, sin * x + cos * y
    return replace(batch, points=points, center=center, heading=sign * batch.heading + angle)


def _swapped(batch: Batch, swaps: Bool[np.ndarray, " pairs"]) -> Batch:
    half = len(swaps)
    index = np.arange(half)
    goes_to = np.concatenate([np.where(swaps, index + half, index), np.where(swaps, index, index + half)])
    cloud = goes_to[batch.cloud]
    order = np.argsort(cloud, kind="stable")
    return Batch(
        batch.points[order], cloud[order], batch.n_seen[goes_to], batch.center[goes_to], batch.heading[goes_to]
    )


def _hidden(batch: Batch, rng: np.random.Generator) -> Kept:
    """Hide what lies beyond an edge through a random point, as the sensor sees it: left, right, below, or aslant.

    What hides stands on the ground, so what is above is never what is lost.
    """
    x, y, z = batch.points.T
    bearing, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    picked = _one_of_each(batch, rng)
    off = (bearing - bearing[picked][batch.cloud] + np.pi) % (2.0 * np.pi) - np.pi
    lower = elevation[picked][batch.cloud] - elevation
    is_low = rng.random(batch.n_clouds) < 0.5
    slant = np.where(is_low, rng.uniform(0.0, np.pi, batch.n_clouds), rng.choice([0.0, np.pi], batch.n_clouds))
    return (np.cos(slant)[batch.cloud] * off + np.sin(slant)[batch.cloud] * lower) > 0.0


def _lost_rings(batch: Batch, rng: np.random.Generator) -> Kept:
    """Lose every second beam, or two of three, or beams at random."""
    x, y, z = batch.points.T
    ring = np.floor(np.arctan2(z, np.hypot(x, y)) / RING).astype(np.int64)
    step, phase = rng.integers(2, 4, batch.n_clouds)[batch.cloud], rng.integers(0, 6, batch.n_clouds)[batch.cloud]
    return (ring + phase) % step != 0


def _thinned(batch: Batch, rng: np.random.Generator) -> Kept:
    """Lose a random share of the points, up to 95 of 100."""
    share = 1.0 - np.exp(rng.uniform(np.log(0.05), 0.0, batch.n_clouds))
    return rng.random(len(batch.cloud)) < share[batch.cloud]


def _holes(batch: Batch, rng: np.random.Generator) -> Kept:
    """Lose what is near a random point: a window, a dark plate, a post in the way."""
    middle = batch.points[_one_of_each(batch, rng)]
    radius = rng.uniform(0.1, 0.8, batch.n_clouds)
    off = batch.points - middle[batch.cloud]
    return (off * off).sum(axis=1) < np.square(radius)[batch.cloud]


def _cropped(batch: Batch, rng: np.random.Generator) -> Kept:
    """Cut slices off the object's sides, as a box that is too small, shifted or turned does."""
    turn = batch.heading + rng.normal(0.0, np.deg2rad(3.0), batch.n_clouds)
    off = batch.points - batch.center[batch.cloud]
    cos, sin = np.cos(turn)[batch.cloud], np.sin(turn)[batch.cloud]
    along, across = cos * off[:, 0] + sin * off[:, 1], cos * off[:, 1] - sin * off[:, 0]
    lost = np.zeros(len(batch.cloud), dtype=bool)
    for way in (along, -along, across, -across, off[:, 2], -off[:, 2]):
        slice_ = np.maximum(rng.normal(0.0, 0.15, batch.n_clouds), 0.0)
        lost |= way > (_largest(way, batch) - slice_)[batch.cloud]
    return lost


def _with_clutter(batch: Batch, share: float, rng: np.random.Generator) -> Batch:
    """Add points of the ground about the object's foot to some clouds: up to a fifth of their own."""
    own = np.bincount(batch.cloud, minlength=batch.n_clouds)
    more = (rng.uniform(0.0, 0.2, batch.n_clouds) * own * (rng.random(batch.n_clouds) < share)).astype(np.int64)
    if not more.any():
        return batch
    cloud = np.repeat(np.arange(batch.n_clouds), more)
    foot = -_largest(-batch.points[:, 2].astype(np.float64), batch)
    place = rng.uniform(-0.5, 0.5, (len(cloud), 2)) * [4.5, 2.0]
    cos, sin = np.cos(batch.heading)[cloud], np.sin(batch.heading)[cloud]
    points = batch.center[cloud]
    points[:, 0] += cos * place[:, 0] - sin * place[:, 1]
    points[:, 1] += sin * place[:, 0] + cos * place[:, 1]
    points[:, 2] = foot[cloud] + np.abs(rng.normal(0.0, 0.03, len(cloud)))
    all_clouds = np.concatenate([batch.cloud, cloud])
    order = np.argsort(all_clouds, kind="stable")
    all_points = np.concatenate([batch.points, points.astype(np.float32)])[order]
    scale = 1.0 + more / np.maximum(own, 1)
    return replace(batch, points=all_points, cloud=all_clouds[order], n_seen=batch.n_seen * scale)


def _without(batch: Batch, lost: Kept) -> Batch:
    """Drop points, but never so many that fewer than LEAST of a cloud remain."""
    before = np.bincount(batch.cloud, minlength=batch.n_clouds)
    left = np.bincount(batch.cloud[~lost], minlength=batch.n_clouds)
    kept = ~lost | (left < LEAST)[batch.cloud]
    after = np.bincount(batch.cloud[kept], minlength=batch.n_clouds)
    n_seen = batch.n_seen * after / np.maximum(before, 1)
    return replace(batch, points=batch.points[kept], cloud=batch.cloud[kept], n_seen=n_seen)


def _one_of_each(batch: Batch, rng: np.random.Generator) -> np.ndarray:
    """Pick a point of each cloud; of an empty one, any."""
    sizes = np.bincount(batch.cloud, minlength=batch.n_clouds)
    first = np.cumsum(sizes) - sizes
    picked = first + (rng.random(batch.n_clouds) * sizes).astype(np.int64)
    return np.minimum(picked, max(len(batch.cloud) - 1, 0))


def _largest(values: Float64[np.ndarray, " n"], batch: Batch) -> Float64[np.ndarray, " b"]:
    """Give the largest value of each cloud; of an empty one, minus infinity."""
    largest = np.full(batch.n_clouds, -np.inf)
    np.maximum.at(largest, batch.cloud, values)
    return largest
