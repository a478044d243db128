"""The tracker: frames with given associations in, tracks with velocities out, one frame at a time."""

from collections.abc import Collection
from dataclasses import dataclass

from tracker.ego_motion.common_mode import with_pose_covariance
from tracker.estimators import Estimator
from tracker.tracklets import cut, of_classes
from tracker.types import Box, Frame, SegmentedFrame, VelocityEstimate


@dataclass(frozen=True, slots=True)
class Track:
    """One object as of the latest frame.

    Attributes:
        track_id: the identity that the data set gives.
        class_name: the data set's own word.
        age: number of consecutive frames it has been seen in.
        box: as given, in the LiDAR frame.
        estimate: its velocity; `status` is `new-track` at age 1.
    """

    track_id: int
    class_name: str
    age: int
    box: Box
    estimate: VelocityEstimate


class Tracker:
    """Follow all objects of some classes; the estimator is given, the tracker names none."""

    def __init__(self, estimator: Estimator, classes: Collection[str] = ("Car", "Van")) -> None:
        """Start with no tracks."""
        self._estimator, self._classes = estimator, classes
        self._ages: dict[int, int] = {}
        self._time: float | None = None

    def update(self, frame: Frame) -> list[Track]:
        """Take the next frame: cut its segments and estimate a velocity for each.

        A frame without a scan ends all tracks, and one that the object is missing from ends its track.
        """
        return self.update_segments(cut(frame))

    def update_segments(self, frame: SegmentedFrame) -> list[Track]:
        """Take the next frame, cut already."""
        segments = of_classes(frame.segments, self._classes)
        self._ages = {track_id: self._ages.get(track_id, 0) + 1 for track_id in segments}
        estimates = self._estimator.step(segments, frame.timestamp, frame.T_world_lidar)
        estimates = with_pose_covariance(estimates, frame, None if self._time is None else frame.timestamp - self._time)
        self._time = frame.timestamp
        return [
            Track(track_id, segment.class_name, self._ages[track_id], frame.boxes[track_id], estimates[track_id])
            for track_id, segment in segments.items()
        ]
