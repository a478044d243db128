"""What is around the boxes of KITTI tracking labels: neighbours beside them, and what stands before hidden ones."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from registration import planar, se3
from registration.synthetic import traffic
from tracker.types import Box

OVERLAP = 0.15  # share of a box's angular width that something nearer covers, to count as what hides it
_SITTING = {"Person": "Person_sitting"}  # the tracking labels' own name for it


class Scenery(NamedTuple):
    """What is around boxes."""

    gaps: list[float]  # to the nearest other box, where nearer than 1 m [m]
    sides: list[int]  # 0 front, 1 back, 2 left, 3 right
    neighbours: list[str]
    occluders: list[str]  # of boxes labelled as hidden; "" where no labelled box does it
    depths: list[float]  # distance of what hides, as a share of that of the hidden box


def summarise_scenery(sequences: Sequence[dict[int, list[Box]]], classes: Sequence[str]) -> dict[str, Any]:
    """Summarise which boxes are beside others, and what stands before hidden ones."""
    seen = Scenery([], [], [], [], [])
    n = 0
    for boxes in (boxes for frames in sequences for boxes in frames.values()):
        for i, box in enumerate(boxes):
            if box.class_name in classes:
                n += 1
                _look_around(box, boxes[:i] + boxes[i + 1 :], seen)
    beside = {
        "share": len(seen.gaps) / n,
        "sides": np.bincount(seen.sides, minlength=4) / len(seen.sides),
        "gap": np.quantile(seen.gaps, traffic.LEVELS),
        "classes": _shares(seen.neighbours),
    }
    return {
        "beside": beside,
        "before": {"classes": _shares(seen.occluders), "depth": np.quantile(seen.depths, traffic.LEVELS)},
    }


def _look_around(box: Box, others: Sequence[Box], seen: Scenery) -> None:
    if not others:
        return
    gaps = [free_space(box, other) for other in others]
    nearest = int(np.argmin([np.hypot(*np.maximum(gap[:2], 0.0)) for gap in gaps]))
    gap = np.maximum(gaps[nearest][:2], 0.0)
    if np.hypot(*gap) < traffic.BESIDE:
        seen.gaps.append(float(np.hypot(*gap)))
        seen.sides.append(int(gaps[nearest][2]))
        seen.neighbours.append(others[nearest].class_name)
    if 1 <= box.occlusion < traffic.N_LEVELS:
        covers = [cover(box, other) for other in others]
        first = int(np.argmax(covers))
        seen.occluders.append(others[first].class_name if covers[first] >= OVERLAP else "")
        if covers[first] >= OVERLAP:
            seen.depths.append(float(polar(others[first].center_lidar)[0] / polar(box.center_lidar)[0]))


def free_space(box: Box, other: Box) -> Float64[np.ndarray, "3"]:
    """Free space between two boxes along the first one's axes [m], negative where they overlap, and the side."""
    corners = se3.transform(se3.invert(box.T_lidar_obj), other.corners_lidar)[:, :2]
    half = 0.5 * box.size[:2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    free = np.maximum(low, -high) - half
    axis = int(np.argmax(free))
    is_negative = (low + high)[axis] < 0.0
    return np.array([*free, 2 * axis + is_negative])


def cover(box: Box, other: Box) -> float:
    """Share of a box's angular width that a nearer box covers."""
    distance, bearing = polar(box.center_lidar)
    if polar(other.center_lidar)[0] >= distance:
        return 0.0
    spans = []
    for corners in (box.corners_lidar, other.corners_lidar):
        angles = [planar.wrap(float(a) - bearing) for a in np.arctan2(corners[:, 1], corners[:, 0])]
        spans.append((min(angles), max(angles)))
    (low, high), (other_low, other_high) = spans
    if other_high - other_low > np.pi or high - low > np.pi:
        return 0.0
    return max(0.0, min(high, other_high) - max(low, other_low)) / (high - low)


def polar(center: Float64[np.ndarray, "3"]) -> tuple[float, float]:
    """Give horizontal range [m] and bearing [rad] of a point."""
    return float(np.hypot(*center[:2])), float(np.arctan2(center[1], center[0]))


def _shares(names: Sequence[str]) -> dict[str, float]:
    counts = Counter(_SITTING.get(name, name) for name in names)
    return {name: n / len(names) for name, n in sorted(counts.items())}
