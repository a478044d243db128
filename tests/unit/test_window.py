"""The fused estimator's window: what it finds from comparisons, and what upsets it."""

from dataclasses import replace

import numpy as np
import pytest

from registration import planar
from tests.windows import Window, solve
from tracker.estimators.fused import heavy_tails, parked, parked_kernels, speeds
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.window import MotionModel

MODEL = MotionModel(density=1.0, rate_sd=30.0, n_frames=9)


def window_of(velocity, n=6, wrong=None, lags_wrong=(1, 2), dt=0.1, tails=(4.0, 4.0)):
    """Compare each frame with the 1 and 2 before it; `wrong` maps a newer frame to an error of its comparisons."""
    velocity = np.asarray(velocity, dtype=np.float64)
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window = Window.start(replace(MODEL, tails=tails), 0.0, axes, np.zeros(2))
    for k in range(1, n):
        axes.advance(k * dt)
        window.advance(k * dt, axes)
        if k == 1:
            window.place_last(velocity * dt)
        for lag in (1, 2):
            if k >= lag:
                off = np.asarray((wrong or {}).get(k, np.zeros(2))) * (lag in lags_wrong)
                window.compare(lag, np.zeros(2), velocity * lag * dt + off, np.eye(2) / 0.02**2)
        solve([window], axes)
    return window


def standing_of(window):
    """Say how likely an object alone stands, of which 3000 points are seen."""
    variances, slips = parked.VARIANCES[:2], np.array([3000.0**-2])
    logs = parked_kernels.log_likelihoods(window.frames, window.at, slips, parked.SPEEDS, *variances, parked.CHANGING)
    return speeds.of_class(speeds.learned(logs), logs)[0, 0]


def test_a_window_finds_a_constant_velocity_and_is_surer_the_longer_it_looks():
    for n in (2, 4, 9, 14):
        velocity, covariance = window_of([3.0, -1.0], n).step()
        np.testing.assert_allclose(velocity, [3.0, -1.0], atol=1e-3)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    few, many = (np.trace(window_of([3.0, -1.0], n).step()[1]) for n in (2, 9))
    assert many < 0.5 * few


def nine_frames(step_to, lags, noise, claims, doubt=0.0, seed=5, **model):
    """Compare nine frames with those before; `step_to` gives the true step from a frame to one `lag` later.

    Comparisons have errors of `noise` and claim `claims`, with `doubt` beside that: standard deviations [m].
    """
    rng = np.random.default_rng(seed)
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window = Window.start(replace(MODEL, **model), 0.0, axes, np.zeros(2))
    for k in range(1, 9):
        axes.advance(0.1 * k)
        window.advance(0.1 * k, axes)
        for lag in range(1, min(k, lags) + 1):
            step = np.array([step_to(k, lag), 0.0]) + rng.normal(0.0, noise, 2)
            window.compare(lag, np.zeros(2), step, np.eye(2) / claims**2, doubt**2 * np.eye(2))
        solve([window], axes)
    return window


def window_with_noise(sd, claimed, doubt=0.0):
    """Nine frames at 3 m/s; each comparison claims 2 cm along each axis, and has an error of `sd`."""
    return nine_frames(lambda _, lag: 0.3 * lag, 4, sd, 0.02, doubt, claimed=claimed)


def test_how_well_comparisons_agree_tells_how_large_their_errors_are():
    as_claimed = np.trace(window_with_noise(0.005, np.inf).step()[1])
    good, bad = (np.trace(window_with_noise(sd, 5.0).step()[1]) for sd in (0.005, 0.04))
    assert good < 0.6 * as_claimed
    assert bad > 2.0 * as_claimed


def test_what_is_doubted_for_another_reason_tells_nothing_of_the_claims():
    as_claimed, found = (np.trace(window_with_noise(0.005, x, doubt=0.3).step()[1]) for x in (np.inf, 5.0))
    assert found == pytest.approx(as_claimed, rel=0.1)


def braking_window(change, seed):
    """Nine frames of a car that brakes at 3 m/s^2 from 10 m/s; single steps, with errors of 1 cm."""
    return nine_frames(lambda k, _: 0.1 * (10.0 - 0.3 * (k - 0.5)), 1, 0.01, 0.01, seed=seed, change=change)


def test_accelerations_that_last_are_followed_and_errors_of_single_steps_are_not():
    errors = {}
    for change in (np.inf, 5.0):
        steps = [braking_window(change, seed).steps()[0] / 0.1 for seed in range(30)]
        off = np.array(steps)[:, 2:, 0] - (10.0 - 0.3 * (np.arange(2, 8) + 0.5))
        errors[change] = np.sqrt(np.mean(np.square(off)))
        assert np.abs(np.mean(off, axis=0)).max() < 0.05
    assert errors[5.0] < 0.9 * errors[np.inf]


def test_one_comparison_that_is_off_is_not_followed():
    off = window_of([3.0, 0.0], 7, wrong={6: [0.0, 0.3]}, lags_wrong=(1,))
    assert abs(off.step()[0][1]) < 0.3  # the step itself says 3 m/s
    normal = window_of([3.0, 0.0], 7, wrong={6: [0.0, 0.3]}, lags_wrong=(1,), tails=(0.0, 0.0))
    assert abs(off.step()[0][1]) < abs(normal.step()[0][1])


def test_a_sudden_change_that_all_comparisons_tell_of_is_followed_at_once():
    """From 20 to 15 m/s in one frame, as in a crash: 5 g."""
    window = window_of([20.0, 0.0], 7, wrong={6: [-0.5, 0.0]})
    assert window.step()[0][0] == pytest.approx(15.0, abs=0.2)


def test_a_look_that_is_off_by_what_nothing_can_move_is_taken_for_an_error():
    off = window_of([3.0, 0.0], 7, wrong={6: [0.0, 1.5]})
    assert abs(off.step()[0][1]) < 0.5  # the step itself says 15 m/s


@pytest.mark.parametrize("speed", [5.0, 20.0, 40.0])
def test_a_first_answer_that_is_off_yields_to_an_exact_one_at_any_speed(speed):
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window = Window.start(MODEL, 0.0, axes, np.zeros(2))
    axes.advance(0.1)
    window.advance(0.1, axes)
    window.place_last(np.array([0.1 * speed + 1.5, 0.0]))
    window.compare(1, np.zeros(2), np.array([0.1 * speed + 1.5, 0.0]), np.eye(2) / 0.1**2)
    solve([window], axes)
    window.compare(1, np.zeros(2), np.array([0.1 * speed, 0.0]), np.eye(2) / 0.02**2)
    solve([window], axes)
    assert window.step()[0][0] == pytest.approx(speed, abs=0.1)


def test_a_step_over_a_gap_may_change_as_much_as_its_time_allows():
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window, at = Window.start(MODEL, 0.0, axes, np.zeros(2)), 0.0
    for time, moved in ((0.1, 1.0), (0.2, 1.0), (0.3, 1.0), (0.4, 1.0), (0.7, 0.5)):  # it stops where nobody sees it
        axes.advance(time)
        window.advance(time, axes)
        at += moved
        for lag in (1, 2):
            if len(window) > lag:
                before = window.state[-1 - lag, 0, 0]
                window.compare(lag, np.zeros(2), np.array([at - before, 0.0]), np.eye(2) / 0.02**2)
        solve([window], axes)
    assert window.step()[0][0] == pytest.approx(0.5 / 0.3, abs=0.2)


def test_the_cost_of_what_is_far_off_grows_as_its_weight_falls():
    for tail in (0.0, 3.0):
        distances = np.linspace(0.1, 60.0, 400)
        costs = np.array([heavy_tails.cost(tail, 2, d) for d in distances])
        weights = np.array([heavy_tails.weight(tail, 2, d) for d in distances])
        np.testing.assert_allclose(np.gradient(costs, distances)[1:-1], 0.5 * weights[1:-1], rtol=0.03)


@pytest.mark.parametrize("speed", [0.0, 1.0, 3.0])
def test_what_is_where_it_was_has_not_stood_if_it_was_elsewhere_between(speed):
    """It turns back half a window ago: there and back again is no displacement."""
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window = Window.start(replace(MODEL, tails=(3.0, 4.0)), 0.0, axes, np.zeros(2))
    places = 0.1 * speed * np.concatenate([np.arange(5), np.arange(3, -1, -1)])
    for k in range(1, 9):
        axes.advance(0.1 * k)
        window.advance(0.1 * k, axes)
        for lag in (1, 4):
            if k >= lag:
                window.compare(lag, np.zeros(2), np.array([places[k] - places[k - lag], 0.0]), np.eye(2) / 0.02**2)
        solve([window], axes)
    standing = standing_of(window)
    assert (standing > 0.9) == (speed == 0.0)
    assert speed == 0.0 or standing < 0.05


def test_steps_without_shakes_are_differences_of_places():
    window = window_of([3.0, 1.0], 6)
    moved, covariances, shaken = window.steps()
    np.testing.assert_allclose(moved, np.diff(window.state[:, 0], axis=0), atol=1e-12)
    np.testing.assert_allclose(covariances[-1], window.difference(-2), atol=1e-12)
    np.testing.assert_array_equal(shaken, 0.0)


def test_steps_leave_out_what_only_the_axes_shook():
    """Poses that turn by 1 mrad at random shift all at 40 m by 4 cm, which is 0.4 m/s a step, and no motion."""
    rng, shake_sd, dt = np.random.default_rng(0), 0.04, 0.1
    axes = Heading(turns=False, n_frames=9)
    axes.advance(0.0)
    window, before = Window.start(MODEL, 0.0, axes, np.zeros(2)), 0.0
    for k in range(1, 30):
        axes.advance(k * dt)
        window.advance(k * dt, axes, np.diag([1e-9, shake_sd**2]))
        shaken = shake_sd * rng.standard_normal()
        window.compare(1, np.zeros(2), np.array([8.0 * dt, shaken - before]), np.eye(2) / 0.01**2)
        solve([window], axes)
        before = shaken
    seen = np.diff(window.state[:, 0], axis=0) / dt
    moved, known, shaken = (part / dt**power for part, power in zip(window.steps(), (1, 2, 2), strict=True))
    normalised = moved[:, 1] ** 2 / (known + shaken)[:, 1, 1]
    assert normalised.mean() < 2.0  # truth is 0
    own = MODEL.density * dt**3 / 12.0  # between two rates; two variances that share a displacement
    assert shaken[:, 1, 1].min() >= 0.999 * own * shake_sd**2 / (own + shake_sd**2) / dt**2
    assert np.abs(moved[:, 1]).max() < 0.4 * np.abs(seen[:, 1]).max()
    np.testing.assert_allclose(moved[:, 0], 8.0, atol=0.02)


def test_a_window_knows_no_more_than_its_last_frames():
    window = window_of([3.0, 0.0], 40)
    assert len(window) == 9
    assert window.state.shape == (9, 2, 2)
    assert window.covariance.shape == (36, 36)
    assert max(c.newer for c in window.comparisons) - window.n_left == 8
    assert min(c.older for c in window.comparisons) - window.n_left == 0


def test_the_difference_of_two_frames_is_what_the_joint_covariance_says():
    window = window_of([3.0, 1.0], 5)
    A = np.zeros((2, 20))
    A[:, 16:18], A[:, 4:6] = np.eye(2), -np.eye(2)
    np.testing.assert_allclose(window.difference(1, 4), A @ window.covariance @ A.T, atol=1e-15)


def test_objects_tell_together_how_their_axes_turn():
    """Three objects at constant velocities, seen from a sensor that begins to turn; nobody tells of turns."""
    axes = Heading(turns=True, n_frames=9)
    angles = np.concatenate([np.zeros(5), np.cumsum(np.linspace(0.0, 0.05, 10))])
    starts = np.array([[40.0, 10.0], [30.0, -20.0], [10.0, 5.0]])
    velocities = np.array([[-10.0, 0.0], [0.0, 12.0], [0.0, 0.0]])
    windows = []
    for k, angle in enumerate(angles):
        axes.advance(0.1 * k)
        seen = (starts + 0.1 * k * velocities) @ planar.rotation(angle)
        if k == 0:
            windows = Window.start_all(MODEL, 0.0, axes, seen)
            before = seen
            continue
        for window, old, place in zip(windows, before, seen, strict=True):
            window.advance(0.1 * k, axes)
            window.compare(1, old, place - old, np.eye(2) / 0.01**2)
        solve(windows, axes)
        before = seen
    old = (starts + 0.1 * (k - 1) * velocities) @ planar.rotation(angles[-2])
    for window, place, previous in zip(windows, before, old, strict=True):
        np.testing.assert_allclose(window.step()[0], (place - previous) / 0.1, atol=0.05)
    assert axes.angles[-1] - axes.angles[-3] == pytest.approx(angles[-1] - angles[-3], abs=0.01)


def test_axes_that_stop_turning_at_once_are_followed():
    """A sensor that circles at 0.5 rad/s among others that circle with it, and leaves the ring; some objects stand."""
    axes, rng, rate, radius, last = Heading(turns=True, n_frames=9), np.random.default_rng(6), 0.5, 16.0, 15
    phases, standing = rng.uniform(0.0, 2.0 * np.pi, 7), np.array([[30.0, 10.0], [-25.0, 20.0], [5.0, -35.0]])
    looks, windows = [], []
    for k in range(last + 4):
        ring = radius * np.column_stack([np.cos(phases + 0.1 * k * rate), np.sin(phases + 0.1 * k * rate)])
        turned, gone = 0.1 * min(k, last) * rate, 0.1 * max(k - last, 0) * rate * radius
        ahead = np.array([-np.sin(turned), np.cos(turned)])
        sensor = radius * np.array([np.cos(turned), np.sin(turned)]) + gone * ahead
        looks.append((np.vstack([ring, standing]) - sensor) @ planar.rotation(turned))
        axes.advance(0.1 * k)
        windows = windows or Window.start_all(replace(MODEL, density=0.5), 0.0, axes, looks[0])
        for i, window in enumerate(windows if k else []):
            window.advance(0.1 * k, axes)
            if k == 1:
                window.place_last(looks[1][i])
            for lag in {1, min(k, 3), min(k, 8)}:
                window.compare(lag, looks[-1 - lag][i], looks[-1][i] - looks[-1 - lag][i], np.eye(2) / 0.05**2)
        if k:
            axes.hear([axes.latest - 1], np.array([-0.1 * rate * (k <= last)]), np.array([0.02**2]))
            solve(windows, axes)
        if k > last:
            found = np.array([window.step()[0] for window in windows])
            assert np.abs(found - (looks[-1] - looks[-2]) / 0.1).max() < 3.0


def test_a_comparison_without_information_is_left_out():
    window = window_of([1.0, 0.0], 3)
    n = len(window.comparisons)
    window.compare(2, np.zeros(2), np.zeros(2), np.zeros((2, 2)))
    assert len(window.comparisons) == n


def test_what_stands_is_taken_to_stand_and_what_rolls_is_not():
    assert standing_of(window_of([0.0, 0.0], 9)) > 0.98
    assert standing_of(window_of([0.5, 0.0], 9)) < 0.01
    assert standing_of(window_of([5.0, 0.0], 9)) < 1e-6
