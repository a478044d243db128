"""The method `fused`: what its opinions do together, what it falls back on, and that its covariance can be believed."""

import subprocess
import sys

import numpy as np
import pytest

import registration
from registration import planar, se3
from registration.types import MotionPrior, Status
from tests.segments import car_cloud

pytest.importorskip("torch")
pytest.importorskip("small_gicp")

from registration.methods import fused as module  # noqa: E402 - it is there where its libraries are

PLACE = np.array([12.0, 5.0, -1.7])


@pytest.fixture(scope="module")
def method():
    return registration.create("fused")


def opinion(x, sigma, turn=0.0):
    return MotionPrior(np.array([x, 0.0, turn]), np.diag([sigma, sigma, 0.1]) ** 2)


def test_a_moved_and_turned_car_is_found_to_centimetres(method):
    source = car_cloud(400) + PLACE
    T = planar.to_transform(np.array([0.8, -0.3, 0.04]), source.mean(axis=0))
    result = method.register(source, se3.transform(T, source))
    np.testing.assert_allclose(result.motion_about(source.mean(axis=0)), [0.8, -0.3, 0.04], atol=0.02)
    assert result.status is Status.CONVERGED


def test_opinions_that_agree_are_weighed_by_their_covariances():
    found = module.combine(opinion(0.0, 0.1), opinion(0.06, 0.2), apart=1e-6)
    assert found.mean[0] == pytest.approx(0.06 * 0.01 / (0.01 + 0.04), rel=1e-3)
    assert found.covariance[0, 0] == pytest.approx(0.01 * 0.04 / (0.01 + 0.04), rel=1e-2)


def test_a_second_opinion_that_is_far_off_changes_nothing():
    first = opinion(0.0, 0.05)
    found = module.combine(first, opinion(1.5, 0.05), apart=0.3)
    np.testing.assert_allclose(found.mean, first.mean, atol=1e-9)
    np.testing.assert_allclose(found.covariance, first.covariance, atol=1e-9)


def test_a_second_opinion_at_a_doubtful_distance_makes_the_answer_unsure():
    first = opinion(0.0, 0.05)
    distances = np.arange(0.01, 0.6, 0.01)
    found = [module.combine(first, opinion(float(x), 0.05), apart=0.3) for x in distances]
    agree = np.array([2.0 * f.mean[0] / x for f, x in zip(found, distances, strict=True)])
    k = int(np.abs(agree - 0.5).argmin())  # both cases are about as likely as each other
    assert agree[0] > 0.95 > agree[k] > 0.2 > agree[-1]
    spread = agree[k] * (1.0 - agree[k]) * (0.5 * distances[k]) ** 2
    expected = agree[k] * 0.05**2 / 2 + (1.0 - agree[k]) * 0.05**2 + spread
    assert found[k].covariance[0, 0] == pytest.approx(expected, rel=1e-3)
    assert found[k].covariance[0, 0] > 2.0 * first.covariance[0, 0]


def test_turns_are_compared_the_short_way_round():
    found = module.combine(opinion(0.0, 0.1, turn=3.1), opinion(0.0, 0.1, turn=-3.1), apart=0.3)
    assert abs(planar.wrap(float(found.mean[2]) - np.pi)) < 0.05


@pytest.mark.parametrize("distance", [0.0, 1.0])
def test_the_product_of_densities_is_that_of_textbooks(distance):
    a, b = opinion(0.0, 0.3), opinion(distance, 0.4)
    product, log_density = module.multiply(a, b)
    assert product.mean[0] == pytest.approx(distance * 0.09 / 0.25, rel=1e-5)
    expected = -0.5 * distance**2 / 0.25 - np.log(2 * np.pi * 0.25) - 0.5 * np.log(2 * np.pi * 0.02)
    assert log_density == pytest.approx(expected, rel=1e-9)


def test_a_sure_prior_is_honoured_also_for_a_turn_that_no_method_would_find(method):
    source = car_cloud(300) + PLACE
    center = source.mean(axis=0)
    motion = np.array([0.5, 0.2, np.deg2rad(170.0)])
    target = se3.transform(planar.to_transform(motion, center), source)
    result = method.register(source, target, MotionPrior(motion, np.diag([0.05, 0.05, 0.02]) ** 2))
    off = result.motion_about(center) - motion
    assert np.hypot(*off[:2]) < 0.05
    assert abs(planar.wrap(float(off[2]))) < np.deg2rad(2.0)


@pytest.mark.parametrize("sd", [0.3, 1.0, 3.0, 10.0, 100.0])
def test_a_prior_that_hardly_knows_does_not_stand_in_the_way(method, sd):
    source, motion = car_cloud(300) + PLACE, np.array([0.5, 0.2, 0.05])
    center = source.mean(axis=0)
    target = se3.transform(planar.to_transform(motion, center), source)
    prior = MotionPrior(motion + [sd, 0.0, 0.0], np.diag([sd, sd, 0.1 * sd]) ** 2)
    result = method.register(source, target, prior)
    np.testing.assert_allclose(result.motion_about(center), motion, atol=0.02)
    assert np.sqrt(result.covariance[0, 0]) < 0.1


def test_a_prior_decides_what_few_points_leave_open(method):
    source = car_cloud(2) + PLACE
    prior = MotionPrior(np.array([1.2, -0.4, 0.0]), np.diag([0.03, 0.03, 0.01]) ** 2)
    result = method.register(source, source + [1.1, -0.3, 0.0], prior)
    assert result.status is Status.TOO_FEW_POINTS
    np.testing.assert_allclose(result.motion_about(source.mean(axis=0))[:2], prior.mean[:2], atol=0.03)
    np.testing.assert_allclose(np.diag(result.covariance)[:2], np.diag(prior.covariance)[:2], rtol=0.1)


def test_nothing_is_known_of_an_empty_cloud(method):
    cloud = car_cloud(100) + PLACE
    for source, target in ((cloud, cloud[:0]), (cloud[:0], cloud), (cloud[:0], cloud[:0])):
        result = method.register(source, target)
        assert result.status is Status.TOO_FEW_POINTS
        assert result.covariance[0, 0] >= 9.0
        np.testing.assert_array_equal(result.T_target_source, np.eye(4))


def test_thinned_clouds_still_answer_about_the_mean_of_all_points(method):
    source, target = car_cloud(3000, seed=1) + PLACE, car_cloud(3000, seed=2) + PLACE + [0.4, 0.1, 0.0]
    result = method.register(source, target)
    np.testing.assert_allclose(result.source_centroid, source.mean(axis=0), atol=1e-9)
    assert result.n_pairs <= method.max_points
    assert np.hypot(*(result.motion_about(result.source_centroid)[:2] - [0.4, 0.1])) < 0.03


def test_errors_are_within_what_the_covariance_says(method):
    errors = []
    for seed in range(40):
        n = 20 + 10 * (seed % 10)
        source, target = car_cloud(n, seed) + PLACE, car_cloud(n, seed + 100) + PLACE + [0.3, 0.1, 0.0]
        result = method.register(source, target)
        off = result.motion_about(result.source_centroid)[:2] - [0.3, 0.1]
        errors.append(off @ np.linalg.solve(result.covariance[:2, :2], off))
    assert np.mean(np.array(errors) < 5.991) >= 0.85  # 95 % of an infinite number
    assert np.mean(errors) > 0.05  # and it is no empty claim


def test_sensors_elsewhere_give_what_the_same_clouds_give_about_the_origin(method):
    source, target = car_cloud(150, seed=1) + PLACE, car_cloud(150, seed=2) + PLACE + [0.4, 0.1, 0.0]
    away = np.array([400.0, -250.0, 0.0])
    prepared = method.prepare([source + away, target + away], [away[:2], away[:2]])
    moved, here = method.align([tuple(prepared)])[0], method.register(source, target)
    center = source.mean(axis=0)
    np.testing.assert_allclose(moved.motion_about(center + away), here.motion_about(center), atol=2e-3)


def test_wrong_settings_and_numbers_of_priors_are_refused(method):
    for settings in ({"doubt": 0.0}, {"apart": 1.0}, {"max_points": 0}):
        with pytest.raises(ValueError, match=next(iter(settings))):
            registration.create("fused", **settings)
    pair = tuple(method.prepare([car_cloud(50), car_cloud(50)]))
    with pytest.raises(ValueError, match="1 pairs but 2 priors"):
        method.align([pair], [None, None])


def test_another_network_can_be_asked():
    source = car_cloud(200) + PLACE
    result = registration.create("fused", network="alignnet-persons").register(source, source + [0.2, 0.0, 0.0])
    assert result.motion_about(source.mean(axis=0))[0] == pytest.approx(0.2, abs=0.03)


def test_importing_the_package_does_not_load_what_the_method_needs():
    script = (
        "import sys, registration; print('fused' in registration.names(), sys.modules.keys() & {'torch', 'open3d'})"
    )
    found = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == "True set()"
