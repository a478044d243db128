"""One KITTI sequence, tracking benchmark or raw drive, read lazily: frames with boxes, points, time and pose."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration.types import Transform
from tracker.errors import DataError, InputError
from tracker.kitti.clock import nominal_times, read_times
from tracker.kitti.poses import Poses
from tracker.kitti.scans import read_scan
from tracker.types import Box, Frame

CLOCKS = ("auto", "nominal")


@dataclass(frozen=True)
class KittiSequence:
    """A sequence whose labels are known and whose scans are read one at a time.

    Attributes:
        name: `0000`, or a raw drive's folder name.
        root: the folder that the user named.
        timestamps: time of each frame [s].
        clock: where they come from.
        poses: T_world_lidar of each frame, or None.
        ego: where they come from: `poses`, `oxts` or `none`.
        scan_path: path of a frame's scan, whether or not it exists.
        boxes_of: the boxes of a frame, in LiDAR axes; made when asked for.
        reindexed: each track id's rank in order of first appearance (protocol of AlignNet-3D's split).
        class_names: the classes that occur in its labels.
        sources: the files that boxes, times and poses come from.
        T_cam_lidar: LiDAR to rectified camera, where the data set's labels live there.
        truth_path: where a simulator's exact truth is or would be; None where there can be none.
    """

    name: str
    root: Path
    timestamps: Float64[np.ndarray, " n"]
    clock: str
    poses: Poses | None
    ego: str
    scan_path: Callable[[int], Path]
    boxes_of: Callable[[int], tuple[Box, ...]]
    reindexed: dict[int, int]
    class_names: tuple[str, ...]
    sources: tuple[Path, ...]
    truth_path: Path | None = None
    T_cam_lidar: Transform | None = None

    def __len__(self) -> int:
        """Count the frames, with or without a scan."""
        return len(self.timestamps)

    def missing_scans(self) -> list[int]:
        """List the frames that have no scan file."""
        return [k for k in range(len(self)) if not self.scan_path(k).is_file()]

    def frame(self, index: int, with_points: bool = True) -> Frame:
        """Read one frame; its points are None where the scan is missing or not wanted.

        Raises:
            IndexError: there is no such frame.
            DataError: the scan is damaged.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"sequence {self.name} has frames 0 to {len(self) - 1}, got {index}")
        path = self.scan_path(index)
        return Frame(
            index=index,
            timestamp=float(self.timestamps[index]),
            boxes=self.boxes_of(index),
            points_lidar=read_scan(path) if with_points and path.is_file() else None,
            T_world_lidar=None if self.poses is None else self.poses[index],
        )

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Read frames one after the other; only one scan is in memory at a time."""
        for index in range(start, len(self) if stop is None else min(stop, len(self))):
            yield self.frame(index)


def choose_times(
    candidates: list[Path], n_frames: int, clock: str
) -> tuple[Float64[np.ndarray, " n"], str, tuple[Path, ...]]:
    """Take the first timestamp file that exists, or the nominal rate; say which.

    Raises:
        InputError: `clock` is none of CLOCKS.
        DataError: the file holds fewer stamps than there are frames.
    """
    if clock not in CLOCKS:
        raise InputError(f"unknown clock {clock!r}; expected one of {', '.join(CLOCKS)}")
    path = next((path for path in candidates if path.is_file()), None)
    if path is None or clock == "nominal":
        return nominal_times(n_frames), "nominal 10 Hz", ()
    times = read_times(path)
    if len(times) < n_frames:
        raise DataError(path, f"expected a timestamp for each of {n_frames} frames, got {len(times)}")
    return times[:n_frames], str(Path(*path.parts[-2:])), (path,)


def count_frames(last_labelled: int, scan_folder: Path) -> int:
    """Count frames up to the last that has a label or a scan."""
    last_scan = max((int(path.stem) for path in scan_folder.glob("*.bin") if path.stem.isdigit()), default=-1)
    return max(last_labelled, last_scan) + 1
