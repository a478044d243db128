"""One KITTI sequence, tracking benchmark or raw drive, read lazily: frames with boxes, points, time and pose."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.lidar import HDL_64E_KITTI
from registration.types import Transform
from tracker.ego_motion.sweep import twist_of_step
from tracker.errors import DataError, InputError
from tracker.kitti.clock import NOMINAL_PERIOD, nominal_times, read_times
from tracker.kitti.poses import Poses
from tracker.kitti.scans import read_scan
from tracker.types import UNKNOWN_STEP, Box, Frame, StepCovariance, Sweep, Twist

CLOCKS = ("auto", "nominal")
RECORDED = ("auto", "poses", "oxts", "none")  # which of the poses that come with a data set are read
TURN_TOLERANCE = 0.1  # scans this much nearer or farther apart than a turn takes still follow each other, relative


@dataclass(frozen=True)
class KittiSequence:
    """A sequence whose labels are known and whose scans are read one at a time.

    Attributes:
        name: `0000`, or a raw drive's folder name.
        root: the folder that the user named.
        timestamps: time of each frame [s].
        clock: where they come from.
        poses: T_world_lidar of each frame, or None.
        ego: where they come from: `poses`, `oxts`, `none`, or an estimate's own words (`tracker.ego_motion`).
        scan_path: path of a frame's scan, whether or not it exists.
        boxes_of: the boxes of a frame, in LiDAR axes; made when asked for.
        reindexed: each track id's rank in order of first appearance (protocol of AlignNet-3D's split).
        class_names: the classes that occur in its labels.
        sources: the files that boxes, times and poses come from.
        T_cam_lidar: LiDAR to rectified camera, where the data set's labels live there.
        truth_path: where a simulator's exact truth is or would be; None where there can be none.
        step_covariances: of each pose's step from the frame before (x, y, yaw about the sensor, in world axes), NaN
            where none is claimed; or None.
        flagged: frames whose pose is a guess: a gap in the records, or a scan with nothing static in it.
        sweep: how the sensor turns, where points are to be moved to one instant (its twist is found anew for each
            frame); None to take scans as they are.
        is_swept: see `Frame`; KITTI's raw and tracking scans are (docs/ego-motion.md).
        lasers: see `Frame`; those of KITTI's sensor, if nobody says otherwise.
        is_simulated: see `Frame`.
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
    step_covariances: Float64[np.ndarray, "n 3 3"] | None = None
    flagged: tuple[int, ...] = ()
    sweep: Sweep | None = None
    is_swept: bool = True
    lasers: str | None = HDL_64E_KITTI.name
    is_simulated: bool = False

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
            ego_step_covariance=self.step_covariance(index),
            sweep=None if self.sweep is None else replace(self.sweep, twist_lidar=self._twist(index), period=self.turn),
            is_swept=self.is_swept,
            lasers=self.lasers,
            is_simulated=self.is_simulated,
        )

    def step_covariance(self, index: int) -> StepCovariance | None:
        """Give the covariance of the step that ends at a frame; a large one from or to a flagged pose that claims none,
        and None where nobody claims any.
        """
        if self.poses is None or index == 0:
            return None
        if self.step_covariances is not None and np.isfinite(self.step_covariances[index]).all():
            return self.step_covariances[index]
        return UNKNOWN_STEP.copy() if {index - 1, index} & set(self.flagged) else None

    @property
    def turn(self) -> float:
        """Time that the sensor takes for a turn [s]: that between scans where it is about what its model says."""
        nominal = NOMINAL_PERIOD if self.sweep is None else self.sweep.period
        between = float(np.median(np.diff(self.timestamps))) if len(self) > 1 else nominal
        return between if abs(between / nominal - 1.0) < TURN_TOLERANCE else nominal

    def _twist(self, index: int) -> Twist:
        """Find the sensor's motion at a frame from the step before it, or else after it; unknown is none."""
        for after in (index, index + 1):
            if self.poses is None or not 1 <= after < len(self) or {after - 1, after} & set(self.flagged):
                continue
            dt = float(self.timestamps[after] - self.timestamps[after - 1])
            return twist_of_step(se3.invert(self.poses[after - 1]) @ self.poses[after], dt)
        return np.zeros(6)

    def fingerprint(self) -> str:
        """Tell sequences apart by the bytes of their tables and poses, and the sizes and times of their scans."""
        digest = hashlib.sha256(f"{self.clock} {self.ego} {self.flagged} {self.sweep}".encode())
        for path in self.sources:
            digest.update(path.read_bytes())
        for table in (self.poses, self.step_covariances):
            digest.update(b"" if table is None else table.tobytes())
        for frame in range(len(self)):
            path = self.scan_path(frame)
            if path.is_file():
                stat = path.stat()
                digest.update(f"{frame} {stat.st_size} {stat.st_mtime_ns}\n".encode())
        return digest.hexdigest()

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


def check_recorded(wish: str) -> None:
    """Refuse a wish for poses of a kind that no data set comes with.

    Raises:
        InputError: it is none of RECORDED.
    """
    if wish not in RECORDED:
        raise InputError(f"unknown recorded poses {wish!r}; expected one of {', '.join(RECORDED)}")


def count_frames(last_labelled: int, scan_folder: Path) -> int:
    """Count frames up to the last that has a label or a scan."""
    last_scan = max((int(path.stem) for path in scan_folder.glob("*.bin") if path.stem.isdigit()), default=-1)
    return max(last_labelled, last_scan) + 1
