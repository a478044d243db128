"""Which tracks train and which test: AlignNet-3D's split of KITTI, as published and as its code does it."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from tracker.errors import InputError
from tracker.kitti.labels import Label

VALIDATION_SEQUENCES = frozenset({"0013", "0014", "0016", "0018"})
TEST_SEQUENCES = frozenset({"0002", "0006", "0007", "0008", "0010"})
HELD_OUT_SEQUENCES = VALIDATION_SEQUENCES | TEST_SEQUENCES
# The released evaluation compares the track id, not the sequence, with the test sequences' numbers.
TEST_IDS = frozenset({2, 6, 7, 8, 10})

SPLITS = ("all", "id-train", "id-val", "id-test", "sequence-train", "sequence-val", "sequence-test")


@dataclass(frozen=True, slots=True)
class PairCount:
    """How many pairs of consecutive frames a part of a split has, by distance of the box at the first."""

    split: str
    within_80m: int
    within_20m: int
    total: int


def in_split(split: str, sequence: str, reindexed_id: int) -> bool:
    """Tell whether a track belongs to a part of a split.

    Args:
        split: one of SPLITS.  `id-*` is the released code's rule: among the held-out sequences, tracks whose
            re-indexed id is in TEST_IDS test and the others validate.  `sequence-*` is the paper's wording.
        sequence: name of the sequence.
        reindexed_id: the track's rank in order of first appearance in its sequence (`reindex`).

    Raises:
        InputError: no such split.
    """
    if split not in SPLITS:
        raise InputError(f"unknown split {split!r}; expected one of {', '.join(SPLITS)}")
    if split == "all":
        return True
    rule, _, part = split.partition("-")
    if sequence not in HELD_OUT_SEQUENCES:
        return part == "train"
    is_test = reindexed_id in TEST_IDS if rule == "id" else sequence in TEST_SEQUENCES
    return part == ("test" if is_test else "val")


def reindex(track_ids: Iterable[int]) -> dict[int, int]:
    """Rank track ids in order of first appearance, over all classes but DontCare."""
    ranks: dict[int, int] = {}
    for track_id in track_ids:
        ranks.setdefault(track_id, len(ranks))
    return ranks


def count_pairs(labels_of: dict[str, list[Label]], classes: Collection[str]) -> list[PairCount]:
    """Count pairs (frame f, frame f + 1) of one object, for each part of both splits.

    Distances are those of the published tables: of the box centre in camera axes, in 3-D, at the first frame.

    Args:
        labels_of: the labels of each sequence, in file order.
        classes: names of the classes that count.
    """
    distances: dict[str, list[float]] = {split: [] for split in SPLITS}
    for sequence, labels in labels_of.items():
        ranks = reindex(label.track_id for label in labels)
        frames = {(label.track_id, label.frame) for label in labels if label.class_name in classes}
        for label in labels:
            is_pair = label.class_name in classes and (label.track_id, label.frame + 1) in frames
            if not is_pair:
                continue
            distance = float(np.linalg.norm(label.center_cam))
            for split in SPLITS:
                if in_split(split, sequence, ranks[label.track_id]):
                    distances[split].append(distance)
    return [
        PairCount(split, sum(d <= 80.0 for d in found), sum(d <= 20.0 for d in found), len(found))
        for split, found in distances.items()
    ]
