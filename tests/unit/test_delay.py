"""How late an estimate follows a step of the acceleration: delays put in by hand come out again."""

import numpy as np
import pytest

from evaluation.delay import acceleration_steps, delays, runs

TIMES = np.arange(80) * 0.1


def braking(times, start=4.0, deceleration=5.0, v0=15.0):
    """Drive at v0, brake at once from `start` for 2 s, go on slower."""
    speed = v0 - deceleration * np.clip(times - start, 0.0, 2.0)
    return np.column_stack([0.6 * speed, 0.8 * speed])


@pytest.mark.parametrize("late", [0.0, 0.07, 0.23, 0.5, -0.1])
def test_an_estimate_that_is_late_by_so_much_has_that_delay(late):
    found = delays(TIMES, braking(TIMES - late), braking(TIMES))
    assert len(found) == 2, "it starts to brake, and it stops braking"
    for delay, middle in zip(found, (4.0, 6.0), strict=True):
        assert delay.seconds == pytest.approx(late, abs=0.02)
        assert TIMES[delay.row] == pytest.approx(middle, abs=0.11)


def test_a_filter_of_the_first_order_is_late_by_its_time_constant():
    true, gain = braking(TIMES, deceleration=3.0), 0.39
    filtered = true.copy()
    for k in range(1, len(true)):
        filtered[k] = filtered[k - 1] + gain * (true[k] - filtered[k - 1])
    time_constant = 0.1 * (1.0 - gain) / gain  # of the lag behind a ramp, in steady state: 0.156 s
    assert [d.seconds for d in delays(TIMES, filtered, true)] == pytest.approx([time_constant] * 2, abs=0.03)


def test_one_that_never_follows_gets_the_longest_delay():
    stays = np.tile(braking(TIMES)[0], (len(TIMES), 1))
    assert delays(TIMES, stays, braking(TIMES))[0].seconds == 1.0


def test_noise_makes_a_delay_uncertain_by_some_hundredths_of_a_second():
    rng = np.random.default_rng(0)
    true = braking(TIMES)
    found = [d.seconds for _ in range(50) for d in delays(TIMES, true + rng.normal(0.0, 0.2, true.shape), true)]
    assert np.median(found) == pytest.approx(0.0, abs=0.011)
    assert 0.005 < np.std(found) < 0.04


@pytest.mark.parametrize(
    ("true", "n"),
    [
        (np.column_stack([10.0 - 1.4 * np.clip(TIMES - 4.0, 0.0, 2.0), 0.0 * TIMES]), 0),  # too gentle
        (np.column_stack([10.0 - 1.6 * np.clip(TIMES - 4.0, 0.0, 2.0), 0.0 * TIMES]), 2),
        (np.column_stack([10.0 - 2.0 * TIMES, 0.0 * TIMES]), 0),  # brakes all the time
        (np.column_stack([10.0 + 0.1 * (-1.0) ** np.arange(80), 0.0 * TIMES]), 0),  # jitters: 2 m/s^2, briefly
        (np.column_stack([10.0 * np.cos(0.3 * np.clip(TIMES - 4.0, 0.0, 9.0)),
                          10.0 * np.sin(0.3 * np.clip(TIMES - 4.0, 0.0, 9.0))]), 1),  # turns in: 3 m/s^2 across
    ],
)  # fmt: skip
def test_a_step_is_a_change_of_1_5_metres_a_second_squared_that_lasts(true, n):
    assert len(acceleration_steps(TIMES, true)) == n


@pytest.mark.parametrize(("start", "n"), [(1.4, 0), (1.6, 1), (6.0, 1), (6.3, 0)])
def test_steps_near_the_ends_of_a_track_are_left_out(start, n):
    true = np.column_stack([10.0 - 4.0 * np.clip(TIMES - start, 0.0, 99.0), 0.0 * TIMES])
    assert len(acceleration_steps(TIMES, true)) == n


@pytest.mark.parametrize("n", [0, 1, 2, 30])
def test_short_tracks_have_none(n):
    assert delays(TIMES[:n], braking(TIMES)[:n], braking(TIMES)[:n]) == []


def test_runs_are_consecutive_steps_of_one_track_in_order_of_time():
    tracklet = np.array([1, 0, 1, 0, 1, 1])
    frames = np.array([5, 9, 6, 8, 9, 10])
    assert [run.tolist() for run in runs(tracklet, frames)] == [[3, 1], [0, 2], [4, 5]]
    assert list(runs(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))) == []
