"""The centroid filter: the released program's gains and semantics."""

import numpy as np
import pytest

from tests.segments import moving_tracklet, segment, steps
from tracker.estimators import create_estimator
from tracker.estimators.centroid_kalman import CentroidFilter
from tracker.types import EstimateStatus


def test_the_gains_at_ten_hertz_are_0926_then_0390():
    centroid_filter = CentroidFilter(np.zeros(3), 0.0)
    first, _ = centroid_filter.update(np.array([0.1, 0.0, 0.0]), 0.1)  # moves at 1 m/s
    assert first[0] == pytest.approx(5.0 / 5.4)
    for k in range(2, 40):
        centroid_filter.update(np.array([0.1 * k, 0.0, 0.0]), 0.1 * k)
    before, _ = centroid_filter.update(np.array([4.0, 0.0, 0.0]), 4.0)
    after, _ = centroid_filter.update(np.array([4.2, 0.0, 0.0]), 4.1)  # one step at 2 m/s
    assert (after[0] - before[0]) / (2.0 - before[0]) == pytest.approx(0.390, abs=5e-4)


def test_the_steady_variance_solves_its_own_equation():
    centroid_filter = CentroidFilter(np.zeros(3), 0.0)
    for k in range(1, 60):
        _, P = centroid_filter.update(np.zeros(3), 0.1 * k)
    predicted = P[0, 0] + 10.0 * 0.1**2
    assert P[0, 0] == pytest.approx(predicted * 0.4 / (predicted + 0.4))


def test_steps_shorter_than_ten_milliseconds_count_as_ten():
    centroid_filter = CentroidFilter(np.zeros(3), 0.0)
    v, _ = centroid_filter.update(np.array([0.01, 0.0, 0.0]), 1e-6)
    assert v[0] == pytest.approx(1.0 * 5.0 / 5.4)


def test_a_constant_velocity_is_found():
    last = steps(create_estimator("centroid-kf"), moving_tracklet((8.0, -3.0), n_frames=30))[-1]
    np.testing.assert_allclose(last.velocity, [8.0, -3.0], atol=1e-5)
    assert last.status is EstimateStatus.CONVERGED
    assert last.frame_name == "sensor"


def test_an_empty_segment_keeps_the_old_model_and_its_time():
    estimator = create_estimator("centroid-kf")
    points = np.array([[10.0, 0.0, 0.0], [11.0, 1.0, 0.0]])
    estimator.step({7: segment(points, 0)}, 0.0, None)
    held = estimator.step({7: segment(np.empty((0, 3)), 1)}, 0.1, None)[7]
    after = estimator.step({7: segment(points + [0.2, 0.0, 0.0], 2)}, 0.2, None)[7]
    assert held.status is EstimateStatus.NEW_TRACK  # nothing was ever measured
    assert after.velocity[0] == pytest.approx(1.0 * 5.0 / 5.4)  # 0.2 m in 0.2 s
