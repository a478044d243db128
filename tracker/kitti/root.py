"""What a folder holds: a tracking benchmark's tree or raw drives, and its sequences by name."""

from collections.abc import Collection, Sequence
from pathlib import Path

from registration.errors import unknown_name
from tracker.errors import InputError, MissingDataError
from tracker.kitti import raw, tracking
from tracker.kitti.sequence import KittiSequence


def sequence_names(root: Path) -> list[str]:
    """List the sequences below ROOT: `0000`, ... of the tracking benchmark, or raw drives' folder names.

    Raises:
        MissingDataError: there is no such folder, or it holds neither.
    """
    if not root.is_dir():
        raise MissingDataError(f"{root}: no such folder")
    folder = tracking.training_folder(root)
    drives = [] if folder is not None else raw.drive_folders(root)
    names = [path.name for path in drives] if folder is None else tracking.sequence_names(folder)
    if not names:
        found = ", ".join(sorted(path.name for path in root.iterdir())[:8]) or "an empty folder"
        raise MissingDataError(
            f"{root}: expected a KITTI tracking folder (label_02/*.txt, velodyne, calib; or the same below training) "
            f"or a raw drive (velodyne_points, tracklet_labels.xml), got {found}"
        )
    return names


def open_sequence(root: Path, name: str, clock: str = "auto", recorded: str = "auto") -> KittiSequence:
    """Open one sequence of ROOT.

    Args:
        root: a tracking benchmark's folder, a raw drive, or a day of raw drives.
        name: one of `sequence_names(root)`.
        clock: `auto` (recorded stamps where there are any) or `nominal` (10 Hz).
        recorded: which poses of the ego to read: `poses`, `oxts`, `none`, or `auto`: the first of these that is there.

    Raises:
        MissingDataError, DataError: a file is not there, or malformed.
        InputError: no such sequence, no such clock, or no such poses.
    """
    names = sequence_names(root)
    if name not in names:
        raise InputError(f"{root}: {unknown_name('sequence', name, names)}")
    folder = tracking.training_folder(root)
    if folder is not None:
        return tracking.open_tracking(root, folder, name, clock, recorded)
    drive = next(path for path in raw.drive_folders(root) if path.name == name)
    return raw.open_raw(root, drive, clock, recorded)


def open_sequences(
    root: Path, names: Sequence[str] = (), clock: str = "auto", recorded: str = "auto"
) -> list[KittiSequence]:
    """Open the sequences named, or all of ROOT that have any scan.

    Raises:
        MissingDataError: a sequence asked for has no scan, or none has; or see `open_sequence`.
        DataError, InputError: see `open_sequence`.
    """
    found = [open_sequence(root, name, clock, recorded) for name in names or sequence_names(root)]
    with_scans = [sequence for sequence in found if len(sequence.missing_scans()) < len(sequence)]
    if not with_scans or (names and len(with_scans) < len(found)):
        empty = next(sequence for sequence in found if sequence not in with_scans)
        what = f"sequence {empty.name} has" if names else f"none of its {len(found)} sequences has"
        raise MissingDataError(f"{root}: {what} scans ({empty.scan_path(0)} ...)")
    return with_scans


def check_classes(sequences: Sequence[KittiSequence], classes: Collection[str]) -> None:
    """Refuse a wish for classes that occur in none of the sequences: a misspelt one would find nothing, silently.

    Raises:
        InputError: none of the classes occurs; the message lists those that do.
    """
    present = sorted({name for sequence in sequences for name in sequence.class_names})
    if not any(name in present for name in classes):
        wish, found = ", ".join(classes) or "class", ", ".join(present) or "nothing"
        raise InputError(f"no {wish} in the labels; they hold {found}")


def check_poses(sequences: Sequence[KittiSequence]) -> None:
    """Refuse sequences without ego poses, before any work that needs them.

    Raises:
        MissingDataError: naming the first such sequence.
    """
    for sequence in sequences:
        if sequence.poses is None:
            raise MissingDataError(
                f"sequence {sequence.name} has no ego poses (oxts or poses), which velocities in the world need: "
                "ask for the sensor frame, or for odometry"
            )
