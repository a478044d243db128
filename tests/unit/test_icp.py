"""Point-to-point ICP: what it finds, when it gives up, and how sure it says it is."""

import numpy as np
import pytest

import registration
from registration import planar, se3
from registration.types import MotionPrior, Status


def l_shape(n, seed=0, noise=0.01):
    """Sample the long side and the rear of a car."""
    rng = np.random.default_rng(seed)
    on_side = rng.random(n) < 0.7
    x = np.where(on_side, rng.uniform(-2.0, 2.0, n), -2.0)
    y = np.where(on_side, -0.9, rng.uniform(-0.9, 0.9, n))
    return np.column_stack([x, y, rng.uniform(0.0, 1.4, n)]) + rng.normal(0.0, noise, (n, 3)) + [12.0, 5.0, 0.0]


def test_the_same_cloud_moved_is_found_exactly():
    source = l_shape(300)
    T = planar.to_transform(np.array([0.4, -0.2, np.deg2rad(1.0)]), source.mean(axis=0))
    result = registration.create("icp").register(source, se3.transform(T, source))
    np.testing.assert_allclose(result.T_target_source, T, atol=1e-6)
    assert result.status is Status.CONVERGED
    assert result.n_pairs == 300
    assert result.rmse == pytest.approx(0.0, abs=1e-6)


def test_a_shift_in_height_is_taken_from_the_centroids_and_kept():
    source = l_shape(200)
    result = registration.create("icp").register(source, source + [0.1, 0.0, 0.05])
    np.testing.assert_allclose(result.T_target_source[:3, 3], [0.1, 0.0, 0.05], atol=1e-6)
    assert result.T_target_source[2, 2] == 1.0


def test_two_samples_of_one_surface_agree_within_the_covariance():
    errors = []
    for seed in range(20):
        source, target = l_shape(400, seed), l_shape(400, seed + 100) + [0.3, 0.1, 0.0]
        result = registration.create("icp", max_distance=0.3).register(source, target)
        error = result.motion_about(result.source_centroid) - [0.3, 0.1, 0.0]
        errors.append(error[:2] @ np.linalg.solve(result.covariance[:2, :2], error[:2]))
    assert np.mean(errors) < 3.0  # 2 is honest; clean clouds leave it below


def test_a_prior_starts_the_search_where_the_centroids_would_mislead():
    whole = l_shape(600)
    half = whole[whole[:, 0] > 12.0]  # the rear is hidden in the second look
    truth = np.array([0.5, 0.0, 0.0])
    icp = registration.create("icp")
    misled = icp.register(whole, half + truth)
    led = icp.register(whole, half + truth, MotionPrior(np.array([0.45, 0.02, 0.0]), np.eye(3) * 0.01))
    center = whole.mean(axis=0)
    assert np.hypot(*(led.motion_about(center)[:2] - truth[:2])) < 0.02
    assert np.hypot(*(misled.motion_about(center)[:2] - truth[:2])) > 0.3


def test_few_points_give_the_centroids_shift_and_say_so():
    source = l_shape(50)
    result = registration.create("icp").register(source, source[:2])
    assert result.status is Status.TOO_FEW_POINTS
    np.testing.assert_allclose(result.T_target_source[:3, 3], source[:2].mean(axis=0) - source.mean(axis=0))
    assert result.covariance[0, 0] > 0.2**2
    assert np.isnan(result.rmse)


def test_clouds_that_nowhere_touch_have_no_overlap():
    ring = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, -3.0, 0.0]])
    result = registration.create("icp").register(ring, 0.5 * ring)
    assert result.status is Status.NO_OVERLAP


def test_iterations_that_run_out_are_no_convergence():
    source = l_shape(300)
    target = se3.transform(planar.to_transform(np.array([0.0, 0.0, 0.05]), source.mean(axis=0)), source)
    result = registration.create("icp", max_iterations=1).register(source, target)
    assert result.status is Status.NOT_CONVERGED
    assert result.n_iterations == 1


def test_less_overlap_is_less_sure():
    source = l_shape(400)
    whole = registration.create("icp").register(source, source + [0.1, 0.0, 0.0])
    part = registration.create("icp").register(source, source[source[:, 0] > 11.0] + [0.1, 0.0, 0.0])
    assert np.trace(part.covariance[:2, :2]) > 2.0 * np.trace(whole.covariance[:2, :2])


def test_an_empty_cloud_leaves_everything_open():
    result = registration.create("icp").register(l_shape(30), np.empty((0, 3)))
    np.testing.assert_array_equal(result.T_target_source, np.eye(4))
    assert result.covariance[0, 0] >= 3.0**2
    assert result.status is Status.TOO_FEW_POINTS


def test_the_number_of_priors_must_fit():
    icp = registration.create("icp")
    a, b = icp.prepare([l_shape(10), l_shape(10, 1)])
    with pytest.raises(ValueError, match="1 pairs but 2 priors"):
        icp.align([(a, b)], [None, None])


def test_a_list_of_lists_is_a_cloud_too_and_words_are_none():
    cloud = l_shape(20).tolist()
    assert registration.create("icp").register(cloud, cloud).status is Status.CONVERGED
    with pytest.raises(registration.errors.InvalidCloudError, match="array of numbers"):
        registration.create("icp").register([["a", "b", "c"]], cloud)
