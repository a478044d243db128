"""Run the tracker over sequences on disk: one CSV of tracks with velocities a sequence, and how it was made."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from tracker.ego_motion.modes import EgoConfig, with_ego
from tracker.errors import InputError
from tracker.estimators import create_estimator
from tracker.files import write_whole
from tracker.kitti import KittiSequence, check_classes, check_poses, open_sequences
from tracker.pipeline import Track, Tracker
from tracker.tracks_file import write_tracks
from tracker.types import SENSOR, WORLD

Progress = Callable[[str, int, int], None]  # what is under way, how much of it is done, of how much


@dataclass(frozen=True)
class TrackConfig:
    """What to follow, and how."""

    estimator: str = "icp"  # an estimator's or registration method's name
    sequences: tuple[str, ...] = ()  # names; empty: all that have scans
    classes: tuple[str, ...] = ("Car", "Van")
    frame: str = WORLD  # world, or sensor: relative to the ego
    clock: str = "auto"  # recorded stamps where there are any, or `nominal`: 10 Hz
    ego: str = "auto"  # where the ego's poses come from: one of tracker.ego_motion.modes.EGO_MODES
    deskew: bool = False  # move each object's points to one instant by the ego's motion during the sweep
    correct_beam_angles: bool = False  # in odometry: KITTI's 0.205 degrees

    def __post_init__(self) -> None:
        """Refuse a frame that does not exist."""
        if self.frame not in (WORLD, SENSOR):
            raise InputError(f"unknown frame {self.frame!r}; expected {WORLD} or {SENSOR}")
        _ = self.ego_config

    @property
    def ego_config(self) -> EgoConfig:
        """The settings of the ego's poses."""
        return EgoConfig(self.ego, self.deskew, self.correct_beam_angles)


def track_sequences(
    root: Path, config: TrackConfig, out: Path, progress: Progress | None = None
) -> list[tuple[Path, int]]:
    """Track each sequence and write `out/NAME.csv`; only one scan is in memory at a time.

    Args:
        root: a KITTI tracking folder or raw drives.
        config: what to follow, and how.
        out: folder of the CSV files; poses that had to be estimated are kept in it too.
        progress: told of every frame.

    Returns:
        path and number of lines of each file.

    Raises:
        InputError: an unknown sequence.
        MissingDataError: no scans, or no ego poses for the world frame.
        TrackerError, RegistrationError: data or a method that cannot be used.
    """
    sequences = open_sequences(root, config.sequences, config.clock, config.ego_config.recorded)
    check_classes(sequences, config.classes)
    in_world = config.frame == WORLD
    sequences = [with_ego(s, config.ego_config, out / "ego-motion", in_world, progress) for s in sequences]
    if in_world:
        check_poses(sequences)
    written = []
    for sequence in sequences:
        path = out / f"{sequence.name}.csv"
        tracker = Tracker(create_estimator(config.estimator), config.classes)
        written.append((path, write_tracks(path, _track(sequence, tracker, config.frame, progress))))
    ego = {sequence.name: {"poses": sequence.ego, "flagged": list(sequence.flagged)} for sequence in sequences}
    about = {"version": version("regmot"), "root": str(root), "config": asdict(config), "ego": ego}
    write_whole(out / "tracks.json", json.dumps(about, indent=1))
    return written


def _track(sequence: KittiSequence, tracker: Tracker, frame_name: str, progress: Progress | None) -> Iterator[Track]:
    for frame in sequence.frames():
        yield from tracker.update(frame if frame_name == WORLD else frame.without_pose())
        if progress is not None:
            progress(sequence.name, frame.index + 1, len(sequence))
