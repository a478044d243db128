"""Two explanations of a look, a sudden change and one that is off as a whole, and the next look, which settles it."""

from dataclasses import replace

import numpy as np
import pytest

from registration import planar
from tests.segments import car_cloud, segment
from tests.windows import Window, solve
from tracker.estimators import create_estimator
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.window import MotionModel

MODEL = MotionModel(density=2.0, rate_sd=15.0)
TAILS = MODEL.tails
NARROW = 0.04**2 * np.eye(2)


def still(n):
    """Axes that do not turn, after n frames."""
    axes = Heading(turns=False, n_frames=9)
    for k in range(n):
        axes.advance(0.1 * k)
    return axes


def weighed(shown, step=None, covariance=NARROW, tails=TAILS):
    """Weigh a step that was expected to be 1 m: give its window, its doubt, and the other explanation."""
    window = Window.start(replace(MODEL, tails=tails), 0.0, still(1), np.zeros(2))
    axes = still(2)
    window.advance(0.1, axes)
    window.explained.expected[0, 0], window.explained.expected_covariances[0, 0] = [1.0, 0.0], covariance
    window.state[-1, 0] = shown if step is None else step
    if step is not None:
        window.explained.rivals[0] = shown
    window.weigh_look(axes)
    return window, window.doubts[-1].copy(), window.other


def test_what_is_expected_is_not_doubted():
    _, doubt, other = weighed([1.01, 0.0])
    assert np.abs(doubt).max() < 1e-6
    assert other is None or other.cost > 5.0


def test_the_farther_off_the_likelier_the_look_is_wrong_until_both_are_of_one_mind():
    shares, doubts = [], []
    for off in (0.1, 0.2, 0.3, 0.6):
        _, doubt, other = weighed([1.0 + off, 0.0])
        assert not other.is_sudden
        np.testing.assert_allclose(other.off[0], -off, rtol=0.05)  # back to where it was expected
        np.testing.assert_allclose(other.rate, [10.0, 0.0])
        shares.append(other.probability)
        doubts.append(doubt[0, 0])
        assert doubt[0, 0] == pytest.approx(shares[-1] * other.off[0] ** 2, rel=1e-6)
    assert np.all(np.diff(shares) > 0.0)
    assert shares[0] < 0.02
    assert shares[-1] > 0.5


def test_a_motion_that_nothing_is_known_of_makes_no_look_suspicious():
    _, doubt, _ = weighed([3.0, 0.0], covariance=1.5**2 * np.eye(2))
    assert doubt.max() < 0.03**2


def test_a_change_that_was_not_taken_stays_possible():
    window, doubt, other = weighed([0.2, 0.0], step=[0.98, 0.0])
    assert other.is_sudden
    np.testing.assert_allclose(other.off, [-0.78, 0.0])
    assert -2.5 <= other.rate[0] <= 2.0  # between a jerk at the end of the step, and one at its start
    assert 0.1**2 < doubt[0, 0] < 0.78**2
    window.covariance[-2:, -2:] = (NARROW - np.eye(2) * MODEL.density * 0.1**3 / 3.0) / 0.1**2
    window.advance(0.2, still(3))
    step, covariance = window.explained.expected[0, 1], window.explained.expected_covariances[0, 1]
    np.testing.assert_allclose(window.explained.expected_covariances[0, 0], NARROW)
    assert abs(step[0] - 0.2) < 2.0 * np.sqrt(covariance[0, 0])
    window.take_other()
    np.testing.assert_array_equal(window.other.off, -other.off)
    assert (window.other.cost, window.other.is_sudden) == (-other.cost, False)
    window.take_other()
    np.testing.assert_array_equal(window.other.off, other.off)
    assert (window.other.cost, window.other.is_sudden) == (other.cost, True)


def looked_at(places, dt=0.1, lags=(1, 2, 4), turn=0.0, vague=None):
    """Compare each of the places (n, 2) with earlier ones, exact to 2 cm, in axes that turn by so much a frame.

    `vague` maps frames to standard deviations that their own comparisons have instead [m]; None: they have none.  Give
    the axes and the window at each frame but the first.
    """
    axes, window = Heading(turns=False, n_frames=9), None
    for k, place in enumerate(places):
        axes.advance(k * dt)
        axes.angles[-1] = turn * k
        if window is None:
            window = Window.start(MODEL, 0.0, axes, np.asarray(place))
            continue
        window.advance(k * dt, axes)
        sd = (vague or {}).get(k, 0.02)
        for lag in lags:
            if k >= lag and sd is not None:
                old = planar.rotation(-turn * (k - lag)) @ places[k - lag]
                window.compare(lag, old, planar.rotation(-turn * k) @ place - old, np.eye(2) / sd**2)
        solve([window], axes)
        window.weigh_look(axes)
        yield axes, window


def followed(places, dt=0.1, turn=0.0):
    """Give, for each frame but the first, in steady axes: the mean rate over the latest step, its own covariance, and
    the doubts of the latest two rates."""
    for k, (_, window) in enumerate(looked_at(places, dt, turn=turn), start=1):
        R, R_before = planar.rotation(turn * k), planar.rotation(turn * (k - 1))
        rate = (R @ window.state[-1, 0] - R_before @ window.state[-2, 0]) / dt
        doubts = np.array(window.doubts[-2:])
        yield rate, R @ window.difference(-2) @ R.T / dt**2, R @ doubts @ R.T / dt**2


THERE, BACK = 5, 6  # of rates, when the seventh place is off


@pytest.mark.parametrize("turn", [0.0, 0.03])
@pytest.mark.parametrize("jump", [0.2, 0.3, 0.45, 1.0])
def test_a_look_that_is_off_is_told_by_the_covariance_and_forgotten_when_the_object_is_back(jump, turn):
    places = np.column_stack([20.0 + 0.3 * np.arange(20), np.zeros(20)])
    places[6, 1] = jump
    rates, covariances, doubts = zip(*followed(places, turn=turn), strict=True)
    error = rates[THERE] - [3.0, 0.0]
    assert error @ np.linalg.solve(covariances[THERE] + doubts[THERE][-1], error) < 7.0**2
    if 0.2 < jump < 0.5:  # it is followed; what is known of places and rates alone would not tell
        assert error[1] > 2.0
        assert error @ np.linalg.solve(covariances[THERE], error) > 10.0**2
        assert error @ np.linalg.solve(covariances[THERE] + doubts[THERE][-1], error) < 3.0**2
    np.testing.assert_allclose(rates[BACK:], np.tile([3.0, 0.0], (13, 1)), atol=0.15)
    assert doubts[BACK].max() < 0.3**2  # in hindsight too
    for k in (THERE - 1, BACK + 1, BACK + 2):
        assert doubts[k][-1].max() < 0.05**2


@pytest.mark.parametrize("change", [4.0, 8.0, 15.0])
def test_a_sudden_change_is_followed_with_the_next_look_at_the_latest_and_never_kept_secret(change):
    places = np.cumsum([[2.0, 0.0]] * 6 + [[2.0 - 0.1 * change, 0.0]] * 14, axis=0)
    rates, covariances, doubts = zip(*followed(places), strict=True)
    error = rates[THERE][0] - (20.0 - change)
    assert doubts[THERE][-1, 0, 0] > max(1.0, 0.02 * error**2)
    if change < 5.0:
        assert abs(error) < 0.2
    np.testing.assert_allclose([rate[0] for rate in rates[BACK:]], 20.0 - change, atol=0.1)
    assert doubts[BACK].max() < 0.2**2
    assert covariances[BACK][0, 0] < 0.5**2


def test_what_was_believed_of_a_rate_does_not_outlive_the_explanation_it_stood_on():
    places = np.cumsum([[2.0, 0.0]] * 6 + [[1.2, 0.0]] * 12, axis=0)
    for _, window in looked_at(places):
        if (
            window.n_left == 6
        ):  # the frame of the change is the first one now; all before it is what is known of its rate
            mean, covariance = window.first_rate
            assert abs(mean[0] - 12.0) < 3.0 * np.sqrt(covariance[0, 0])
            break
    else:
        pytest.fail("the window is too short")


@pytest.mark.parametrize("sd", [5.0, None])
@pytest.mark.parametrize(("change", "jump"), [(8.0, 0.0), (12.0, 0.0), (0.0, 0.3), (0.0, 0.5)])
def test_nothing_is_settled_by_a_look_that_tells_next_to_nothing(change, jump, sd):
    places = np.cumsum([[2.0, 0.0]] * 6 + [[2.0 - 0.1 * change, 0.0]] * 8, axis=0)
    places[6, 1] = jump
    for k, (_, window) in enumerate(looked_at(places, vague={7: sd}), start=1):
        if k == 6:
            before = window.other
        if k == 7:
            likely = before.probability  # the likelier one is taken, if there is anything to go on from
            assert window.unsettled == pytest.approx(likely if sd is None else min(likely, 1.0 - likely), rel=0.4)
            own = window.unsettled * np.outer(before.off, before.off)
            np.testing.assert_allclose(window.doubts[-2], own, atol=1e-6)
            assert not window.is_off[6 - window.n_left]
        if k == 8:  # the step to frame 7 still begins at a look that was not settled
            assert window.doubts[-2].max() >= 0.9 * own.max()
        if k >= 10:
            assert window.state[-1, 1, 0] == pytest.approx(20.0 - change, abs=0.2)


def test_a_look_that_is_off_is_never_heard_again():
    places = np.column_stack([0.3 * np.arange(9), np.zeros(9)])
    places[5, 1] = 1.0
    for k, (_, window) in enumerate(looked_at(places, lags=(1, 2, 3, 4)), start=1):
        if k > 5:
            assert window.is_off[5]
            assert not any(5 in (c.older, c.newer) for c in window.comparisons)
    places[5, 1] = 0.0
    np.testing.assert_allclose(window.state[:, 0], places, atol=0.01)


@pytest.mark.parametrize("in_world", [True, False])
def test_a_car_whose_box_jumps_for_one_frame_is_not_said_to_have_moved_for_sure(in_world):
    """The whole estimator, on points; without poses, axes that turn explain a jump too."""
    estimator, pose = create_estimator("fused"), np.eye(4) if in_world else None
    others = [car_cloud(300, seed=j) + place for j, place in enumerate([[8.0, -4.0, -1.7], [20.0, -5.0, -1.7]])]
    found = []
    for k in range(12):
        points = car_cloud(300, seed=k) + [12.0 + 0.5 * k, 4.0 + 0.35 * (k == 8), -1.7]
        clouds = {7: points, 8: others[0], 9: others[1]}
        segments = {key: segment(cloud, k, track_id=key) for key, cloud in clouds.items()}
        found.append(estimator.step(segments, 0.1 * k, pose)[7])
    error = found[8].velocity - [5.0, 0.0]
    assert error @ np.linalg.solve(found[8].covariance, error) < 3.0**2
    assert found[8].covariance[1, 1] > 2.0**2 * found[7].covariance[1, 1] > 0.0
    for later in found[9:]:
        np.testing.assert_allclose(later.velocity, [5.0, 0.0], atol=0.3)


@pytest.mark.parametrize("n_points", [40, 300])
@pytest.mark.parametrize("start", [8.0, 20.0])
def test_a_sudden_change_is_not_denied_by_shapes_that_confirm_what_is_expected_of_them(start, n_points):
    """From 15 to 10 m/s in a frame: at half a metre from where they are sought, planes find what they expect."""
    estimator, at, found = create_estimator("fused"), start, []
    for k in range(13):
        at += 1.5 if k < 9 else 1.0
        cloud = car_cloud(n_points, seed=k) + [at, 3.0, -1.7]
        found.append(estimator.step({7: segment(cloud, k)}, 0.1 * k, np.eye(4))[7])
    error = found[9].velocity - [10.0, 0.0]
    assert error @ np.linalg.solve(found[9].covariance, error) < 4.0**2
    for later in found[10:]:
        np.testing.assert_allclose(later.velocity, [10.0, 0.0], atol=0.5)


def test_an_id_that_goes_on_with_another_car_is_no_reason_to_fail():
    estimator = create_estimator("fused")
    for k in range(12):
        points = car_cloud(200, seed=k) + [12.0 + 20.0 * (k > 8), 4.0, -1.7]
        found = estimator.step({7: segment(points, k)}, 0.1 * k, np.eye(4))[7]
        assert np.isfinite(found.velocity).all()
        assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_what_no_motion_explains_may_be_a_crash_however_sure_the_motion_was():
    for sd in (0.04, 0.004):
        _, _, other = weighed([1.8, 0.0], step=[1.0, 0.0], covariance=sd**2 * np.eye(2))
        assert other.is_sudden
        assert other.probability > 0.05


def test_what_is_far_beyond_a_normal_error_is_weighed_too():
    for tails in (TAILS, (0.0, 0.0)):
        for off in (1.0, 12.0, 100.0):
            _, doubt, other = weighed([1.0 + off, 0.0], tails=tails)
            assert np.isfinite(doubt).all()
            assert other is None or np.isfinite(other.cost)


def test_a_car_that_crashes_is_followed_with_the_second_look():
    estimator, at, found = create_estimator("fused"), 40.0, []
    for k in range(14):
        at -= 1.5 if k < 9 else 0.3  # from 15 to 3 m/s: 12 g
        found.append(estimator.step({7: segment(car_cloud(300, seed=k) + [at, 3.0, -1.7], k)}, 0.1 * k, np.eye(4))[7])
    assert abs(found[8].velocity[0] + 15.0) < 0.3
    assert found[9].covariance[0, 0] > 4.0**2  # it is 12 m/s off
    for later in found[10:]:
        assert later.velocity[0] == pytest.approx(-3.0, abs=0.5)
