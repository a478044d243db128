"""Velocity errors: figures a reader can redo by hand."""

import numpy as np
import pytest

from evaluation.velocity_error import score

ESTIMATED = np.array([[3.0, 4.0], [1.0, 0.0], [0.0, 2.0]])
TRUE = np.array([[3.0, 0.0], [1.0, 0.0], [0.0, -2.0]])  # errors: 4, 0, 4; of the speed: 2, 0, 0
COVARIANCE = np.array([np.eye(2), np.eye(2), 4.0 * np.eye(2)])


def test_vector_and_speed_errors_are_root_mean_squares_of_different_things():
    found = score(ESTIMATED, TRUE, COVARIANCE, np.array([False, False, True]))
    assert found.n == 3
    assert found.rmse_velocity == pytest.approx(np.sqrt((16 + 0 + 16) / 3))
    assert found.rmse_speed == pytest.approx(np.sqrt((4 + 0 + 0) / 3))
    assert found.median_velocity_error == 4.0
    assert found.abstained == 1


def test_nees_weighs_errors_by_their_covariance_and_coverage_counts_the_ellipse():
    found = score(ESTIMATED, TRUE, COVARIANCE, np.zeros(3, dtype=bool))
    assert found.nees == pytest.approx((16 / 1 + 0 + 16 / 4) / 3)
    assert found.coverage_95 == pytest.approx(2 / 3)  # 16 > 5.99 > 4


def test_an_honest_covariance_has_nees_2_and_covers_95_percent():
    rng = np.random.default_rng(0)
    covariance = np.tile([[0.5, 0.2], [0.2, 0.3]], (20_000, 1, 1))
    error = rng.multivariate_normal([0, 0], covariance[0], 20_000)
    found = score(error, np.zeros_like(error), covariance, np.zeros(20_000, dtype=bool))
    assert found.nees == pytest.approx(2.0, rel=0.03)
    assert found.coverage_95 == pytest.approx(0.95, abs=0.005)


def test_no_steps_give_undefined_figures_not_zeros():
    found = score(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, dtype=bool))
    assert found.n == 0
    assert np.isnan(found.rmse_velocity)
    assert np.isnan(found.nees)


def test_the_99th_percentile_looks_at_the_tail_the_median_at_the_middle():
    error = np.zeros((101, 2))
    error[:, 1] = np.arange(101.0)  # 0 to 100 m/s: as many percent
    found = score(error, np.zeros_like(error), np.tile(np.eye(2), (101, 1, 1)), np.zeros(101, dtype=bool))
    assert found.median_velocity_error == pytest.approx(50.0)
    assert found.p99_velocity_error == pytest.approx(99.0)
