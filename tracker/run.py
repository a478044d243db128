"""Run the tracker over sequences on disk: one CSV of tracks with velocities a sequence."""

from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from tracker.errors import InputError, MissingDataError
from tracker.estimators import create_estimator
from tracker.kitti import KittiSequence, open_sequence, sequence_names
from tracker.pipeline import Track, Tracker
from tracker.tracks_file import write_tracks
from tracker.types import SENSOR, WORLD

Progress = Callable[[str, int, int], None]  # what is under way, how much of it is done, of how much


def track_sequences(
    root: Path,
    out: Path,
    estimator: str = "icp",
    sequences: Sequence[str] = (),
    classes: Collection[str] = ("Car", "Van"),
    frame_name: str = WORLD,
    clock: str = "auto",
    progress: Progress | None = None,
) -> list[tuple[Path, int]]:
    """Track each sequence and write `out/NAME.csv`; only one scan is in memory at a time.

    Args:
        root: a KITTI tracking folder or raw drives.
        out: folder of the CSV files.
        estimator: an estimator's or registration method's name.
        sequences: names; empty: all that have scans.
        classes: which objects to follow.
        frame_name: WORLD, or SENSOR (relative to the ego).
        clock: `auto` or `nominal`.
        progress: told of every frame.

    Returns:
        path and number of lines of each file.

    Raises:
        InputError: an unknown sequence or frame name.
        MissingDataError: no scans, or no ego poses for WORLD.
        TrackerError, RegistrationError: data or a method that cannot be used.
    """
    if frame_name not in (WORLD, SENSOR):
        raise InputError(f"unknown frame {frame_name!r}; expected {WORLD} or {SENSOR}")
    written = []
    for name in sequences or sequence_names(root):
        sequence = open_sequence(root, name, clock)
        if len(sequence.missing_scans()) == len(sequence):
            if not sequences:
                continue
            raise MissingDataError(f"sequence {name} has no scans ({sequence.scan_path(0)} ...)")
        if frame_name == WORLD and sequence.poses is None:
            raise MissingDataError(f"sequence {name} has no ego poses (oxts or poses): ask for the sensor frame")
        path = out / f"{name}.csv"
        tracker = Tracker(create_estimator(estimator), classes)
        written.append((path, write_tracks(path, _track(sequence, tracker, frame_name, progress))))
    if not written:
        raise MissingDataError(f"{root}: none of its sequences has scans")
    return written


def _track(sequence: KittiSequence, tracker: Tracker, frame_name: str, progress: Progress | None) -> Iterator[Track]:
    for frame in sequence.frames():
        yield from tracker.update(frame if frame_name == WORLD else frame.without_pose())
        if progress is not None:
            progress(sequence.name, frame.index + 1, len(sequence))
