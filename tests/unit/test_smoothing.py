"""Smoothing: the paper's window without its dummy, and Rauch-Tung-Striebel with real time steps."""

import numpy as np
import pytest

from tests.segments import estimate
from tracker.errors import InputError
from tracker.estimators import create_smoothing
from tracker.smoothing import RauchTungStriebel, WindowMean
from tracker.types import EstimateStatus


def series(*vx, **kwargs):
    return [estimate(k, (v, 0.0), **kwargs) for k, v in enumerate(vx)]


def x(estimates):
    return [float(e.velocity[0]) for e in estimates]


def test_a_window_of_0_changes_nothing():
    assert x(WindowMean(0).measurements(series(1.0, 5.0, 3.0))) == [1.0, 5.0, 3.0]


def test_a_window_of_1_is_the_mean_with_both_neighbours_as_far_as_they_exist():
    found = x(WindowMean(1).measurements(series(1.0, 5.0, 3.0, 7.0)))
    assert found == pytest.approx([(1 + 5) / 2, (1 + 5 + 3) / 3, (5 + 3 + 7) / 3, (3 + 7) / 2])


def test_a_window_of_5_spans_eleven_frames():
    velocities = np.arange(20.0) ** 2
    found = x(WindowMean(5).measurements(series(*velocities)))
    assert found[10] == pytest.approx(velocities[5:16].mean())
    assert found[2] == pytest.approx(velocities[:8].mean())


def test_the_first_scan_of_a_track_is_no_member_of_any_window():
    run = [estimate(0, (0.0, 0.0), status=EstimateStatus.NEW_TRACK)]
    run += [estimate(k, (6.0, 0.0)) for k in (1, 2, 3)]
    found = WindowMean(1).measurements(run)
    assert x(found) == [0.0, 6.0, 6.0, 6.0]  # the released code's dummy zero would make the second one 4
    assert found[0].status is EstimateStatus.NEW_TRACK


def test_a_frame_without_points_takes_its_neighbours_mean_and_gives_nothing():
    run = series(2.0, 9.0, 4.0)
    run[1] = estimate(1, (9.0, 0.0), status=EstimateStatus.NO_POINTS)
    assert x(WindowMean(1).measurements(run)) == [2.0, 3.0, 4.0]


def test_independent_measurements_make_the_mean_surer():
    found = WindowMean(1).measurements(series(1.0, 1.0, 1.0, variance=0.9))
    np.testing.assert_allclose(found[1].covariance, 0.3 * np.eye(2))


def test_a_negative_window_is_refused():
    with pytest.raises(ValueError, match="half_width must be 0 or more, got -1"):
        WindowMean(-1)
    with pytest.raises(InputError, match="a window of -1"):
        create_smoothing("window", -1)


def test_an_unknown_smoothing_lists_what_there_is():
    with pytest.raises(InputError, match="expected one of causal, window, rts"):
        create_smoothing("median")


def batch_answer(run, acceleration_variance):
    """Solve the smoothing problem at once: the least-squares answer that RTS must equal."""
    n = len(run)
    information, right = np.zeros((n, n)), np.zeros(n)
    for k, e in enumerate(run):
        if e.status is EstimateStatus.CONVERGED:
            information[k, k] += 1.0 / e.covariance[0, 0]
            right[k] += e.velocity[0] / e.covariance[0, 0]
    for k in range(1, n):
        q = acceleration_variance * (run[k].timestamp - run[k - 1].timestamp) ** 2
        information[np.ix_([k - 1, k], [k - 1, k])] += np.array([[1, -1], [-1, 1]]) / q
    return np.linalg.solve(information, right), np.diag(np.linalg.inv(information))


def test_rts_equals_the_batch_least_squares_answer_with_irregular_steps_and_gaps_in_the_measurements():
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.05, 0.3, 12))
    run = [
        estimate(k, (rng.normal(), 0.0), variance=rng.uniform(0.05, 2.0), time=float(t)) for k, t in enumerate(times)
    ]
    run[5] = estimate(5, (99.0, 0.0), status=EstimateStatus.NO_POINTS, time=float(times[5]))
    found = RauchTungStriebel(acceleration_variance=7.0).measurements(run)
    mean, variance = batch_answer(run, 7.0)
    np.testing.assert_allclose(x(found), mean, atol=1e-10)
    np.testing.assert_allclose([e.covariance[0, 0] for e in found], variance, atol=1e-10)


def test_rts_of_a_filters_output_is_the_same_as_filtering_and_smoothing():
    run = series(1.0, 4.0, 2.0, 6.0)
    rts = RauchTungStriebel(10.0)
    filtered = rts.filtered(run)
    np.testing.assert_allclose(x(rts.posteriors(filtered)), x(rts.measurements(run)))
    assert x(filtered)[-1] == pytest.approx(x(rts.measurements(run))[-1])  # the last frame has no future


def test_a_wild_measurement_that_says_so_moves_the_smoothed_track_little():
    run = [estimate(k, (5.0, 0.0), variance=0.01) for k in range(7)]
    run[3] = estimate(3, (25.0, 0.0), variance=100.0)
    assert abs(x(RauchTungStriebel().measurements(run))[3] - 5.0) < 0.1
    assert abs(x(WindowMean(1).measurements(run))[3] - 5.0) > 5.0


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_and_a_single_frame_stay_as_they_are(n):
    run = [estimate(0, (0.0, 0.0), status=EstimateStatus.NEW_TRACK)][:n]
    for smoothing in (WindowMean(), RauchTungStriebel()):
        assert x(smoothing.measurements(run)) == x(run)
        assert x(smoothing.posteriors(run)) == x(run)
