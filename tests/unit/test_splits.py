"""AlignNet-3D's split: by re-indexed track id as its code does it, by sequence as its paper words it."""

import numpy as np
import pytest

from tracker.errors import InputError
from tracker.kitti.labels import Label
from tracker.kitti.splits import HELD_OUT_SEQUENCES, SPLITS, count_pairs, in_split, reindex


def label(frame, track_id, distance, class_name="Car"):
    """Stand a box of height 2 so that its centre is `distance` from the camera."""
    size = np.array([4.0, 1.6, 2.0])
    return Label(frame, track_id, class_name, 0, 0, np.array([0.0, 1.0, distance]), size, 0.0)


def counts(labels_of, classes=("Car",)):
    found = count_pairs(labels_of, classes)
    assert tuple(count.split for count in found) == SPLITS
    return {count.split: (count.within_20m, count.within_80m, count.total) for count in found}


def test_track_ids_are_ranked_in_order_of_first_appearance():
    assert reindex([7, 2, 7, 40, 2, 0]) == {7: 0, 2: 1, 40: 2, 0: 3}
    assert reindex([]) == {}


@pytest.mark.parametrize(
    ("sequence", "reindexed_id", "by_id", "by_sequence"),
    [
        ("0000", 2, "train", "train"),
        ("0012", 5, "train", "train"),
        ("0002", 2, "test", "test"),
        ("0002", 3, "val", "test"),
        ("0010", 10, "test", "test"),
        ("0013", 6, "test", "val"),
        ("0018", 9, "val", "val"),
    ],
)
def test_a_track_is_in_one_part_of_each_rule(sequence, reindexed_id, by_id, by_sequence):
    parts = {split for split in SPLITS if in_split(split, sequence, reindexed_id)}
    assert parts == {"all", f"id-{by_id}", f"sequence-{by_sequence}"}


def test_nine_sequences_are_held_out():
    assert sorted(HELD_OUT_SEQUENCES) == ["0002", "0006", "0007", "0008", "0010", "0013", "0014", "0016", "0018"]


def test_an_unknown_split_is_refused():
    with pytest.raises(InputError, match="unknown split 'test'; expected one of all, id-train"):
        in_split("test", "0000", 0)


def test_pairs_are_consecutive_frames_of_one_object_and_gaps_make_none():
    labels = [label(k, 5, 10.0) for k in (0, 1, 2, 4, 5)] + [label(3, 6, 10.0)]
    assert counts({"0000": labels})["all"] == (3, 3, 3)


def test_the_distance_is_that_of_the_centre_at_the_first_frame_borders_included():
    labels = [label(0, 5, 20.0), label(1, 5, 20.5), label(2, 5, 80.0), label(3, 5, 81.0), label(4, 5, 5.0)]
    assert counts({"0000": labels})["all"] == (1, 3, 4)


def test_the_distance_counts_height_too():
    low = [Label(k, 5, "Car", 0, 0, np.array([0.0, 13.0, 16.0]), np.array([4.0, 1.6, 2.0]), 0.0) for k in (0, 1)]
    assert counts({"0000": low})["all"] == (1, 1, 1)  # centre (0, 12, 16): 20 m
    lower = [Label(k, 5, "Car", 0, 0, np.array([0.0, 13.1, 16.0]), np.array([4.0, 1.6, 2.0]), 0.0) for k in (0, 1)]
    assert counts({"0000": lower})["all"] == (0, 1, 1)


def test_only_the_classes_asked_for_count_but_all_are_ranked():
    # Two pedestrians come first: the car is the third object of the sequence, rank 2, and so a test track.
    walkers = [label(k, i, 10.0, "Pedestrian") for i in (8, 9) for k in (0, 1, 2)]
    cars = [label(k, 30, 10.0) for k in (0, 1)]
    found = counts({"0013": walkers + cars})
    assert (found["id-test"], found["id-val"], found["sequence-val"]) == ((1, 1, 1), (0, 0, 0), (1, 1, 1))
    found = counts({"0013": walkers + cars}, ("Car", "Pedestrian"))
    assert (found["id-test"], found["id-val"], found["sequence-val"]) == ((1, 1, 1), (4, 4, 4), (5, 5, 5))


def test_a_step_in_which_an_object_changes_its_class_is_no_pair_of_either():
    labels = [label(0, 5, 10.0, "Van"), label(1, 5, 10.0), label(2, 5, 10.0)]
    assert counts({"0000": labels})["all"] == (1, 1, 1)
    assert counts({"0000": labels}, ("Van",))["all"] == (0, 0, 0)
    assert counts({"0000": labels}, ("Car", "Van"))["all"] == (2, 2, 2)


def test_ranks_start_anew_in_each_sequence():
    tracks = [label(k, i, 10.0) for i in range(3) for k in (0, 1)]
    found = counts({"0002": tracks, "0006": tracks})
    assert (found["id-test"][2], found["id-val"][2], found["sequence-test"][2]) == (2, 4, 6)
