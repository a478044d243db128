"""The only place that knows the files, axes and quirks of KITTI."""

from tracker.kitti.root import check_classes, check_poses, open_sequence, open_sequences, sequence_names
from tracker.kitti.sequence import KittiSequence

__all__ = ["KittiSequence", "check_classes", "check_poses", "open_sequence", "open_sequences", "sequence_names"]
