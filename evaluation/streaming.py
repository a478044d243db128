"""What a transform costs in a tracker: each segment prepared once, all objects of a frame aligned in one call."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from time import perf_counter
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

import numpy as np

import registration
from evaluation.runtime import Timing, car_points, open3d_icp
from registration.errors import RegistrationError
from registration.libraries import load_open3d
from registration.types import Points, RegistrationMethod
from tracker.errors import InputError
from tracker.kitti import check_classes, open_sequences
from tracker.store import SegmentStore, cut_sequence
from tracker.tracklets import of_classes

PEER = "Open3D point-to-point ICP, pair by pair"
PLAIN = "its network as published: float32, 512 points, both clouds of a pair"
PASSES = 2  # through the streams, of a learned method and of its plain way
WARM_UP_FRAMES = 3  # what is compiled or loaded on first use is no cost of a transform

Segments = Mapping[int, Points]  # the points of each object of a frame (n, 3) [m]
Progress = Callable[[str, int, int | None], None]


@runtime_checkable
class Streamed(Protocol):
    """What can be timed in a stream: a method, or the plain way that one is measured against."""

    def prepare(self, clouds: Sequence[Points]) -> list[Any]:
        """Do what depends on one cloud only."""

    def align(self, pairs: Sequence[tuple[Any, Any]]) -> list[Any]:
        """Do the rest for all pairs of a frame."""


@dataclass(frozen=True)
class PairByPair:
    """Open3D's ICP as it is called by who has clouds: it prepares nothing, and takes one pair at a time."""

    open3d: ModuleType

    def prepare(self, clouds: Sequence[Points]) -> list[Points]:
        """Leave clouds as they are."""
        return list(clouds)

    def align(self, pairs: Sequence[tuple[Points, Points]]) -> list[object]:
        """Align the pairs of a frame, each with clouds of its own."""
        return [open3d_icp(self.open3d, source, target) for source, target in pairs]


@dataclass
class Contestant:
    """A method on its way through the frames."""

    method: Streamed
    previous: dict[int, Any] = field(default_factory=dict)
    ms: list[float] = field(default_factory=list)  # per transform, one value a frame

    def step(self, segments: Segments) -> None:
        """Prepare the frame's segments, and align those that were there in the last frame."""
        start = perf_counter()
        prepared = dict(zip(segments, self.method.prepare(list(segments.values())), strict=True))
        pairs = [(self.previous[key], now) for key, now in prepared.items() if key in self.previous]
        self.method.align(pairs)
        self.previous = prepared
        if pairs:
            self.ms.append(1e3 * (perf_counter() - start) / len(pairs))

    def run(self, stream: Sequence[Segments]) -> None:
        """Go through a sequence from its start."""
        self.previous = {}
        for segments in stream:
            self.step(segments)

    @property
    def median_ms(self) -> float:
        """Median over frames of the time of a transform, without the first few frames [ms]."""
        return median(self.ms[WARM_UP_FRAMES:])


def time_streams(
    streams: Sequence[Sequence[Segments]], methods: Sequence[str], progress: Progress | None = None
) -> list[Timing]:
    """Let methods, and Open3D's ICP called pair by pair, take turns on the same frames.

    Args:
        streams: one a sequence: its frames in order.
        methods: names; what cannot be created here is left out.
        progress: told of every frame.

    Returns:
        for each method the median over frames of the time of a transform; the same of the peer beside it.  Learned
        methods also stand beside their own network's plain way.

    Raises:
        MissingLibraryError: Open3D cannot be imported.
        InputError: no more frames with a transform in them than are left out at first.
    """
    peer = Contestant(PairByPair(load_open3d("the comparison with Open3D's ICP")))
    contestants = {name: Contestant(method) for name in methods if (method := _created(name)) is not None}
    for stream in streams:
        for contestant in (*contestants.values(), peer):
            contestant.previous = {}
        for k, segments in enumerate(stream):
            for contestant in (*contestants.values(), peer):
                contestant.step(segments)
            if progress is not None:
                progress("timing transforms", k + 1, len(stream))
    if len(peer.ms) <= WARM_UP_FRAMES:
        what = f"expected more than {WARM_UP_FRAMES} frames with objects that were there in the frame before"
        raise InputError(f"{what}, to time transforms; got {len(peer.ms)}")
    timings = [
        Timing(f"{name}: a transform", PEER, contestant.median_ms, peer.median_ms)
        for name, contestant in contestants.items()
    ]
    return timings + [
        _beside_plain_way(name, contestant.method, streams)
        for name, contestant in contestants.items()
        if hasattr(contestant.method, "plain_way")
    ]


def _beside_plain_way(name: str, method: Any, streams: Sequence[Sequence[Segments]]) -> Timing:
    """Time a learned method and its network's plain way, each with the machine's caches to itself, in turn."""
    ours, plain = Contestant(method), Contestant(method.plain_way())
    for contestant in (ours, plain) * PASSES:
        for stream in streams:
            contestant.run(stream)
    return Timing(f"{name}: a transform by itself", PLAIN, ours.median_ms, plain.median_ms)


def kitti_stores(root: Path, sequences: Sequence[str], classes: Sequence[str], cache: Path) -> list[SegmentStore]:
    """Cut the segments of KITTI sequences; all that have scans where none is named.

    Raises:
        TrackerError: no such sequence, none of the classes, no scans, damaged data.
    """
    opened = open_sequences(root, tuple(sequences))
    check_classes(opened, classes)
    return [cut_sequence(sequence, cache) for sequence in opened]


def kitti_stream(store: SegmentStore, classes: Sequence[str]) -> list[Segments]:
    """Read the non-empty segments of some classes, frame by frame."""
    return [_points(of_classes(frame.segments, classes)) for frame in store.frames()]


def generated_stream(rng: np.random.Generator, n_frames: int = 25, n_objects: int = 8) -> Iterator[Segments]:
    """Make frames of car-like segments of 20 to 3000 points, as many near as far in the logarithm."""
    sizes = np.geomspace(20, 3000, n_objects).astype(int)
    for k in range(n_frames):
        yield {i: car_points(rng, int(n)) + [0.05 * k, 0.02 * k, 0.0] for i, n in enumerate(sizes)}


def _points(segments: Mapping[int, Any]) -> Segments:
    return {key: segment.points_lidar for key, segment in segments.items() if len(segment.points_lidar)}


def _created(name: str) -> RegistrationMethod | None:
    try:
        return registration.create(name)
    except RegistrationError:  # its library, or its weights, are not here
        return None
