"""The arrays that windows of many objects share: rows that are used again, room for more, and solving together."""

import itertools

import numpy as np
import pytest

from tests.segments import car_cloud, segment
from tests.windows import Window, solve
from tracker.estimators import create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings, rows
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.window import MotionModel, Windows

MODEL = MotionModel(density=1.0, rate_sd=30.0)
VELOCITIES = np.array([[3.0, -1.0], [-3.0, 1.0], [3.0, -1.0]])  # one turned round: all settle in as many iterations


def follow(windows, velocities, n=12):
    """Let windows go on for n frames, each compared with the 1 and 2 before; one look of each is off, backwards."""
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    at = np.concatenate([window.at for window in windows])
    windows[0].windows.start(at, np.zeros(len(at)), axes, np.zeros((len(at), 2)))
    for k in range(1, n):
        axes.advance(0.1 * k)
        for window, velocity in zip(windows, velocities, strict=True):
            window.advance(0.1 * k, axes)
            for lag in range(1, min(k, 2) + 1):
                step = (0.1 * lag - 0.15 * (k == 6)) * velocity
                window.compare(lag, np.zeros(2), step, np.eye(2) / 0.02**2)
        solve(windows, axes)
        windows[0].windows.weigh_looks(at, axes)


def known(window):
    """Give all that is known of a window, but for what lies behind its end, and what nothing depends on."""
    n, heard, own = len(window), window.comparisons, window.explained
    frames = [array[window.row, :n] for array in window.frames[1:4]]
    frames += [window.covariance, *(array[window.row, :n] for array in window.frames[5:])]
    told = [c.measured for c in heard], [(c.older, c.newer) for c in heard]
    explained = [own.others, own.rivals, own.contrary, own.contrary_shares, own.unsettled, own.left]
    return [*frames, *told, *(array[window.row] for array in explained)]


def assert_same(some, others, **tolerance):
    for a, b in zip(some, others, strict=True):
        np.testing.assert_allclose(a, b, **tolerance)


def alone(velocity, n=12):
    window = Window(Windows(MODEL, 2), 0)
    follow([window], [velocity], n)
    return window


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_a_row_that_is_used_again_knows_nothing_of_the_object_before(n):
    window = Window(Windows(MODEL, 2), 0)
    follow([window], VELOCITIES[1:2], 7)  # the last look is off: two explanations, and both are dropped
    assert window.other is not None
    window.n_left = 0
    follow([window], VELOCITIES[:1], n)
    assert_same(known(window), known(alone(VELOCITIES[0], n)), rtol=0.0)


def test_a_window_is_the_same_alone_or_among_others_in_any_order():
    for order in itertools.permutations(range(3)):
        shared = Windows(MODEL, 2)
        windows = [Window(shared, row) for row in order]
        follow(windows, VELOCITIES)
        for window, velocity in zip(windows, VELOCITIES, strict=True):
            assert_same(known(window), known(alone(velocity)), rtol=1e-6, atol=1e-9)


def test_where_there_is_no_more_room_all_that_was_known_stays():
    windows = Windows(MODEL, 2)
    window = Window(windows, windows.n_rows - 1)
    follow([window], VELOCITIES[:1])
    before, n_rows, n_comparisons = known(window), windows.n_rows, windows.rows.comparisons.ends.shape[1]
    windows.make_room()
    windows.make_room_for_comparisons()
    assert windows.n_rows == 2 * n_rows
    assert windows.rows.comparisons.ends.shape[1] == 2 * n_comparisons
    assert_same(known(window), before, rtol=0.0)
    fresh, made = rows.empty(n_rows, 9, 1, 2), windows.rows
    for array, empty in zip(itertools.chain(*made), itertools.chain(*fresh), strict=True):
        assert array.dtype == empty.dtype
        assert array.flags.c_contiguous


def test_more_comparisons_than_there_was_room_for_are_heard_in_their_order():
    lags = tuple(range(1, 9))
    estimator = FusedEstimator(settings=FusedSettings(shape_lags=lags, learned_lags=lags))
    room = estimator._known.places.rows.comparisons.ends.shape[1]
    for k in range(9):
        cloud = car_cloud(100, seed=k) + [14.0 + 0.4 * k, 4.0, -1.7]
        found = estimator.step({7: segment(cloud, k)}, 0.1 * k, np.eye(4))[7]
    heard = Window(estimator._known.places, estimator._tracks[7].row).comparisons
    assert len(heard) == 2 * 36 > room
    assert [c.newer for c in heard] == [k for k in range(1, 9) for _ in range(2 * k)]
    assert [c.older for c in heard[-16:]] == [*range(7, -1, -1)] * 2
    np.testing.assert_allclose(found.velocity, [4.0, 0.0], atol=0.1)


def test_many_objects_that_come_and_go_are_followed_as_one_alone_is():
    """More than there is room for at first; those that come take the rows of those that went."""
    estimator, single = create_estimator("fused"), create_estimator("fused")
    for k in range(8):
        keys = [0, *range(1 + 7 * k, 13 + 7 * k)]
        segments = {
            key: segment(car_cloud(40, seed=key) + [10.0 + 9.0 * (key % 20), 4.0 * (key % 3) + 0.5 * k, -1.7], k)
            for key in keys
        }
        many = estimator.step(segments, 0.1 * k, np.eye(4))
        one = single.step({0: segments[0]}, 0.1 * k, np.eye(4))
        assert set(many) == set(keys)
    frames = (tracks._known.places.rows.frames for tracks in (estimator, single))
    a, b = (own.state[tracks._tracks[0].row] for own, tracks in zip(frames, (estimator, single), strict=True))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert one[0].velocity == pytest.approx([0.0, 5.0], abs=0.3)
    assert len(estimator._known.looks) == 16
    assert len({track.row for track in estimator._tracks.values()}) == 13
