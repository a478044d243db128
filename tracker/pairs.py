"""Pairs of one object's segments from KITTI tracklets, as AlignNet-3D's data sets are made of them."""

from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration import planar, se3
from registration.pair_set import CloudPair
from registration.types import Transform
from tracker.errors import InputError
from tracker.kitti import KittiSequence
from tracker.kitti.splits import in_split
from tracker.store import cut_sequence
from tracker.tracklets import of_classes
from tracker.types import Box, Segment, SegmentedFrame

# name of the set -> its classes; `-hard` is appended for the hard variant
PAIR_SETS = {
    "kitti-tracklets-cars": ("Car", "Van"),
    "kitti-tracklets-cars-persons": ("Car", "Van", "Pedestrian"),
}
HARD = "-hard"
# name of the set -> its classes: looks 1 to 8 scans apart, in the sensor's own axes, as a tracker compares them
LOOK_SETS = {"kitti-looks-cars": ("Car", "Van")}
LOOKS_APART = (1, 3, 8)  # each look is compared with one before, so many scans ago in turn
LOOKS_HELD = 10  # one of so many tracks that the split trains on validates, in sets of looks
HARD_FRAMES, HARD_TURN = 10, np.deg2rad(45.0)  # at least so far apart, and turned by at least so much

SPLIT_RULES = ("id", "sequence")

# Camera axes (x right, y down, z forward) to x forward, y left, z up: the axes of the published sets.
_T_OUT_CAM = se3.pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _Look:
    """One segment with its box."""

    segment: Segment
    box: Box


Choice = Callable[[Iterable[dict[int, _Look]]], Iterator[tuple[_Look, _Look]]]


def pair_set_names() -> list[str]:
    """List the sets that `kitti_pairs` knows."""
    return [*(name + suffix for name in PAIR_SETS for suffix in ("", HARD)), *LOOK_SETS]


def kitti_pairs(
    name: str, sequences: Sequence[KittiSequence], cache: Path, rule: str = "id", progress: Progress | None = None
) -> Iterator[tuple[str, CloudPair]]:
    """Give (part, pair) of a named set from sequences with scans.

    Regular sets pair consecutive frames; hard ones all frames of a track at least 10 apart between which the object
    turned by at least 45 degrees.  Pairs with an empty cloud are left out.  As published, nothing compensates the
    ego's motion, axes start at the camera (calibrated here), and the second cloud is moved to the first one's ground.
    Sets of looks are ours, to train on: each look with the one 1, 3 or 8 scans ago, in turn, in the sensor's axes (on
    the first one's ground too, which nothing that sees clouds about their own means can tell); one in ten of the tracks
    that would train validates.

    Args:
        name: one of `pair_set_names()`.
        sequences: what to take them from.
        cache: where cut segments are kept.
        rule: which part a pair belongs to: `id` (the released code's) or `sequence` (the paper's text).
        progress: told of every frame that is cut.

    Raises:
        InputError: no such set or rule.
    """
    if name not in pair_set_names():
        raise InputError(f"unknown set of pairs {name!r}; expected one of {', '.join(pair_set_names())}")
    if rule not in SPLIT_RULES:
        raise InputError(f"unknown split rule {rule!r}; expected one of {', '.join(SPLIT_RULES)}")
    classes = LOOK_SETS[name] if name in LOOK_SETS else PAIR_SETS[name.removesuffix(HARD)]
    chosen = _in_turn if name in LOOK_SETS else _far_apart if name.endswith(HARD) else _consecutive
    for sequence in sequences:
        is_in_sensor = name in LOOK_SETS or sequence.T_cam_lidar is None
        T_out_lidar = np.eye(4) if is_in_sensor else _T_OUT_CAM @ sequence.T_cam_lidar
        for rank, pair in track_pairs(sequence, classes, cache, T_out_lidar, progress, chosen):
            part = next(p for p in ("train", "val", "test") if in_split(f"{rule}-{p}", sequence.name, rank))
            is_held = name in LOOK_SETS and part == "train" and rank % LOOKS_HELD == LOOKS_HELD // 2
            yield "val" if is_held else part, pair


def track_pairs(
    sequence: KittiSequence,
    classes: Collection[str],
    cache: Path,
    T_out_lidar: Transform,
    progress: Progress | None = None,
    chosen: Choice | None = None,
) -> Iterator[tuple[int, CloudPair]]:
    """Give (re-indexed track id, pair) of a sequence's tracks; pairs with an empty cloud are left out.

    Args:
        sequence: what to take them from.
        classes: of the objects.
        cache: where cut segments are kept.
        T_out_lidar: the axes of the pairs; upright.
        progress: told of every frame that is cut.
        chosen: which looks are paired; consecutive ones by default.
    """
    report = None if progress is None else partial(progress, f"{sequence.name}: cutting segments")
    frames = cut_sequence(sequence, cache, report).frames()
    for first, second in (chosen or _consecutive)(_looks(frames, classes)):
        rank = sequence.reindexed[first.box.track_id]
        yield rank, _pair(sequence.name, rank, first, second, T_out_lidar)


def hard_frames(yaws: dict[int, float]) -> Iterator[tuple[int, int]]:
    """Choose the pairs of frames of one track that are far apart and turned, from its heading [rad] by frame."""
    for first, second in combinations(sorted(yaws), 2):
        turn = abs(planar.wrap(yaws[second] - yaws[first]))
        if second - first >= HARD_FRAMES and turn >= HARD_TURN:
            yield first, second


def _looks(frames: Iterable[SegmentedFrame], classes: Collection[str]) -> Iterator[dict[int, _Look]]:
    """Give the non-empty segments of each frame by track."""
    for frame in frames:
        segments = of_classes(frame.segments, classes)
        yield {key: _Look(s, frame.boxes[key]) for key, s in segments.items() if len(s.points_lidar)}


def _consecutive(frames: Iterable[dict[int, _Look]]) -> Iterator[tuple[_Look, _Look]]:
    before: dict[int, _Look] = {}
    for now in frames:
        yield from ((before[track_id], look) for track_id, look in now.items() if track_id in before)
        before = now


def _in_turn(frames: Iterable[dict[int, _Look]]) -> Iterator[tuple[_Look, _Look]]:
    """Pair the looks of each frame with those 1, 3 or 8 scans before, frame by frame in turn."""
    kept: deque[dict[int, _Look]] = deque(maxlen=max(LOOKS_APART))
    for number, now in enumerate(frames):
        apart = LOOKS_APART[number % len(LOOKS_APART)]
        if apart <= len(kept):
            before = kept[-apart]
            yield from ((before[track_id], look) for track_id, look in now.items() if track_id in before)
        kept.append(now)


def _far_apart(frames: Iterable[dict[int, _Look]]) -> Iterator[tuple[_Look, _Look]]:
    lives: dict[int, dict[int, _Look]] = defaultdict(dict)
    for now in frames:
        for track_id, look in now.items():
            lives[track_id][look.segment.frame] = look
    for life in lives.values():
        yaws = {frame: look.box.yaw_lidar for frame, look in life.items()}
        yield from ((life[first], life[second]) for first, second in hard_frames(yaws))


def _pair(sequence: str, rank: int, first: _Look, second: _Look, T_out_lidar: Transform) -> CloudPair:
    T_out_first, T_out_second = (T_out_lidar @ look.box.T_lidar_obj for look in (first, second))
    grounds = [T[2, 3] - 0.5 * look.box.size[2] for T, look in ((T_out_first, first), (T_out_second, second))]
    level = np.array([0.0, 0.0, grounds[0] - grounds[1]])
    return CloudPair(
        source=_points(T_out_lidar, first),
        target=_points(T_out_lidar, second) + level,
        start_position=T_out_first[:3, 3].copy(),
        end_position=T_out_second[:3, 3] + level,
        start_angle=se3.yaw(T_out_first),
        end_angle=se3.yaw(T_out_second),
        extra={
            "class": first.box.class_name,
            "truncated": [first.box.truncation, second.box.truncation],
            "occluded": [first.box.occlusion, second.box.occlusion],
            "seq": int(sequence) if sequence.isdigit() else sequence,
            "frames": [first.segment.frame, second.segment.frame],
            "trackids": [rank, rank],
        },
    )


def _points(T_out_lidar: Transform, look: _Look) -> Float64[np.ndarray, "n 3"]:
    return se3.transform(T_out_lidar, look.segment.points_lidar)
