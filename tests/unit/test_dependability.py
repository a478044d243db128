"""Parked objects that seem to move and tracks that stay lost, counted by hand."""

import numpy as np
import pytest

from evaluation.dependability import false_motion, lost_tracks


def test_false_motion_is_the_share_of_steps_faster_than_0_3():
    assert false_motion(np.array([[0.3, 0.0], [0.0, -0.31], [0.2, 0.2], [0.3, 0.3]])) == pytest.approx(2 / 4)


def test_without_parked_objects_false_motion_is_undefined_not_zero():
    assert np.isnan(false_motion(np.empty((0, 2))))


AGE = np.arange(1, 9)  # eight steps of a track of nine frames; the fifth and later end after its fifth frame


@pytest.mark.parametrize(
    ("error", "is_lost"),
    [
        ([9.0, 9.0, 9.0, 9.0, 2.1, 2.1, 2.1, 2.1], True),
        ([0.1, 0.1, 0.1, 0.1, 2.1, 2.1, 2.1, 2.1], True),  # found at first, then lost for good
        ([9.0, 9.0, 9.0, 9.0, 2.1, 2.0, 2.1, 2.1], False),  # one good frame is enough
        ([9.0, 9.0, 9.0, 9.0, 0.1, 0.1, 0.1, 0.1], False),  # found in time
    ],
)
def test_a_track_is_lost_when_it_stays_wrong_in_every_frame_after_the_fifth(error, is_lost):
    found = lost_tracks(np.array(error), np.full(8, 3), AGE)
    assert found.tolist() == ([3] if is_lost else [])


def test_a_track_of_five_frames_cannot_be_lost_and_one_of_six_can():
    assert lost_tracks(np.full(4, 9.0), np.zeros(4, dtype=np.int64), AGE[:4]).tolist() == []
    assert lost_tracks(np.full(5, 9.0), np.zeros(5, dtype=np.int64), AGE[:5]).tolist() == [0]


def test_tracks_do_not_mix():
    tracklet = np.array([4, 2] * 8)
    error = np.array([9.0, 0.1] * 8)
    assert lost_tracks(error, tracklet, np.repeat(AGE, 2)).tolist() == [4]
