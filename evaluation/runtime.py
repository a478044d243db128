"""How long things take: ours and the plain way side by side, in one run, as medians and ratios."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from time import perf_counter
from types import ModuleType

import numpy as np

import registration
from registration import se3
from registration.errors import MissingLibraryError, RegistrationError
from registration.libraries import load_open3d
from registration.types import Points
from tracker.boxes import points_in_boxes
from tracker.types import Box

N_POINTS, N_BOXES = 120_000, 20  # of the frame that segments are cut from

METHODS = ("icp", "plane-icp", "gicp", "adh-3d")
POINTS, N_PAIRS = (50, 200, 1000, 4000), 8  # how time grows with the points of a segment, ...
PAIRS, FEW_POINTS = (1, 4, 32), 200  # ... and with the pairs of a frame


@dataclass(frozen=True, slots=True)
class Timing:
    """One line of the benchmark: what ours took, what the peer took, and ours as a share of it."""

    what: str
    peer: str
    ours_ms: float
    peer_ms: float

    @property
    def ratio(self) -> float:
        """Our time as a share of the peer's."""
        return self.ours_ms / self.peer_ms


def side_by_side(
    what: str, peer_name: str, ours: Callable[[], object], peer: Callable[[], object], repeats: int = 15
) -> Timing:
    """Time two callables in turn, so that both meet the same moods of the machine; give medians."""
    ours(), peer()
    times = np.array([[_seconds(ours), _seconds(peer)] for _ in range(repeats)])
    return Timing(what, peer_name, 1e3 * median(times[:, 0]), 1e3 * median(times[:, 1]))


def benchmark(
    seed: int = 0, methods: Sequence[str] = METHODS, points: Sequence[int] = POINTS, pairs: Sequence[int] = PAIRS
) -> list[Timing]:
    """Time cutting segments, and how methods grow with points and pairs where Open3D is there to compare with."""
    rng = np.random.default_rng(seed)
    timings = [_cutting(rng)]
    try:
        open3d = load_open3d("the comparison with Open3D's ICP")
    except MissingLibraryError:
        return timings
    for name in methods:
        if not _is_ready(name):
            continue
        for n_points in points:
            timings.append(_aligning(name, n_points, N_PAIRS, open3d, rng))
        for n_pairs in pairs:
            timings.append(_aligning(name, FEW_POINTS, n_pairs, open3d, rng))
    return timings


def _is_ready(name: str) -> bool:
    try:
        registration.create(name)
    except RegistrationError:  # its library is not here
        return False
    return True


def _cutting(rng: np.random.Generator) -> Timing:
    """Time cutting segments; both ways must agree first: a fast wrong answer is no time at all."""
    points, boxes = crowded_frame(rng)
    if any(
        not np.array_equal(a, b) for a, b in zip(points_in_boxes(points, boxes), one_by_one(points, boxes), strict=True)
    ):
        raise AssertionError("cutting segments disagrees with the loop over boxes")
    return side_by_side(
        f"cut {N_BOXES} segments from {N_POINTS} points",
        "NumPy, box by box",
        partial(points_in_boxes, points, boxes),
        partial(one_by_one, points, boxes),
    )


def _aligning(name: str, n_points: int, n_pairs: int, open3d: ModuleType, rng: np.random.Generator) -> Timing:
    """Time a method on a frame of pairs, in ms a pair, against Open3D's point-to-point ICP called pair by pair.

    In a tracker each segment is prepared once and aligned twice: as many segments are prepared as pairs aligned.
    """
    method = registration.create(name)
    sources = [car_points(rng, n_points) for _ in range(n_pairs)]
    targets = [car_points(rng, n_points) + [0.05, 0.02, 0.0] for _ in range(n_pairs)]
    prepared = method.prepare(sources)

    def ours() -> object:
        return method.align(list(zip(prepared, method.prepare(targets), strict=True)))

    def peer() -> object:
        return [open3d_icp(open3d, *pair) for pair in zip(sources, targets, strict=True)]

    what = f"{name}, {n_points} points, {n_pairs} {'pair' if n_pairs == 1 else 'pairs'} a call: a pair"
    timing = side_by_side(what, "Open3D point-to-point ICP", ours, peer, repeats=7)
    return replace(timing, ours_ms=timing.ours_ms / n_pairs, peer_ms=timing.peer_ms / n_pairs)


def crowded_frame(rng: np.random.Generator) -> tuple[Points, list[Box]]:
    """Make a frame of 120 000 points, most of them on the ground, and 20 car-sized boxes in it."""
    reach = rng.uniform(3.0, 80.0, N_POINTS)
    bearing = rng.uniform(-np.pi, np.pi, N_POINTS)
    points = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing), rng.normal(-1.6, 0.3, N_POINTS)])
    boxes = []
    for track_id in range(N_BOXES):
        center = np.array([*rng.uniform(-40.0, 40.0, 2), -0.9])
        pose = se3.from_yaw(rng.uniform(-np.pi, np.pi), center)
        boxes.append(Box(track_id, "Car", pose, np.array([4.2, 1.8, 1.6])))
    return points, boxes


def one_by_one(points: Points, boxes: list[Box]) -> list[np.ndarray]:
    """Cut segments the plain way: turn the whole scan into each upright box's axes and compare."""
    found = []
    for box in boxes:
        x, y, z = (points - box.center_lidar).T
        c, s = np.cos(box.yaw_lidar), np.sin(box.yaw_lidar)
        half_length, half_width, half_height = 0.5 * box.size
        inside = (np.abs(c * x + s * y) <= half_length) & (np.abs(c * y - s * x) <= half_width)
        found.append(np.flatnonzero(inside & (np.abs(z) <= half_height)))
    return found


def car_points(rng: np.random.Generator, n: int) -> Points:
    """Sample the side and the rear of a car."""
    on_side = rng.random(n) < 0.7
    x = np.where(on_side, rng.uniform(-2.0, 2.0, n), -2.0)
    y = np.where(on_side, -0.9, rng.uniform(-0.9, 0.9, n))
    return np.column_stack([x, y, rng.uniform(0.0, 1.4, n)]) + rng.normal(0.0, 0.02, (n, 3)) + [12.0, 5.0, 0.0]


def open3d_icp(open3d: ModuleType, source: Points, target: Points) -> object:
    """Let Open3D align two clouds, from their centroids and with the published radius."""
    clouds = []
    for points in (source, target):
        cloud = open3d.geometry.PointCloud()
        cloud.points = open3d.utility.Vector3dVector(points)
        clouds.append(cloud)
    start = se3.pose(np.eye(3), target.mean(axis=0) - source.mean(axis=0))
    return open3d.pipelines.registration.registration_icp(*clouds, 0.1, start)


def _seconds(action: Callable[[], object]) -> float:
    start = perf_counter()
    action()
    return perf_counter() - start
