"""Planar algebra: motions, their centres, their covariances, and the closed-form alignment."""

import numpy as np
import pytest

from registration import planar, se3


def test_a_turn_about_the_object_moves_no_point_there_but_does_about_the_sensor():
    center = np.array([20.0, 0.0, 0.0])
    T = planar.to_transform(np.array([0.0, 0.0, np.deg2rad(1.0)]), center)
    np.testing.assert_allclose(planar.motion_about(T, center), [0.0, 0.0, np.deg2rad(1.0)], atol=1e-12)
    x, y, _ = planar.motion_about(T, np.zeros(3))
    assert np.hypot(x, y) == pytest.approx(2 * 20.0 * np.sin(np.deg2rad(0.5)))  # a chord of 20 m by 1 degree


def test_change_of_centre_is_the_papers_formula():
    t, c, new = np.array([0.3, -0.1]), np.array([1.0, 2.0]), np.array([-4.0, 7.0])
    yaw = 0.4
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    x, y, turned = planar.change_center(np.array([*t, yaw]), c, new)
    np.testing.assert_allclose([x, y], t + (R - np.eye(2)) @ (new - c))
    assert turned == yaw


def test_an_unsure_turn_makes_far_centres_unsure_across_the_line_of_sight():
    covariance = np.diag([0.01, 0.01, 0.1]) ** 2
    moved = planar.transport_covariance(covariance, 0.0, np.zeros(2), np.array([10.0, 0.0]))
    assert moved[0, 0] == pytest.approx(0.01**2)
    assert moved[1, 1] == pytest.approx(0.01**2 + (10.0 * 0.1) ** 2)


def test_transported_covariance_agrees_with_sampled_motions():
    rng = np.random.default_rng(0)
    covariance = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 9e-4, -3e-5], [2e-5, -3e-5, 1e-4]])
    mean = np.array([0.5, 0.2, 0.3])
    old, new = np.array([1.0, -2.0]), np.array([4.0, 3.0])
    samples = rng.multivariate_normal(mean, covariance, 40_000)
    moved = np.array([planar.change_center(sample, old, new) for sample in samples])
    expected = planar.transport_covariance(covariance, mean[2], old, new)
    np.testing.assert_allclose(np.cov(moved.T), expected, atol=2e-4 * 2)


def test_alignment_ignores_height():
    rng = np.random.default_rng(1)
    source = rng.normal(size=(30, 3))
    T = se3.from_yaw(0.7, np.array([1.0, -2.0, 0.0]))
    target = se3.transform(T, source)
    target[:, 2] += rng.normal(size=30)
    np.testing.assert_allclose(planar.align_pairs(source, target), T, atol=1e-12)


def test_alignment_agrees_with_scipys_procrustes_in_the_plane():
    scipy_rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    rng = np.random.default_rng(2)
    source, target = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    T = planar.align_pairs(source, target)
    flat = [np.column_stack([c[:, :2] - c[:, :2].mean(axis=0), np.zeros(20)]) for c in (source, target)]
    # the best 3-D turn of two flat clouds may be a flip; the best one about z is the planar answer
    matrix, _ = scipy_rotation.align_vectors(np.vstack([flat[1], [0, 0, 1e6]]), np.vstack([flat[0], [0, 0, 1e6]]))
    np.testing.assert_allclose(T[:3, :3], matrix.as_matrix(), atol=1e-6)


def test_one_pair_gives_its_shift_and_no_turn():
    T = planar.align_pairs(np.array([[1.0, 2.0, 0.0]]), np.array([[1.5, 1.0, 0.0]]))
    np.testing.assert_allclose(planar.motion_about(T, np.zeros(3)), [0.5, -1.0, 0.0])


def test_no_pair_is_an_error():
    with pytest.raises(ValueError, match="at least 1 pair of points, got 0"):
        planar.align_pairs(np.empty((0, 3)), np.empty((0, 3)))


def test_wrap_keeps_pi_and_turns_minus_pi_round():
    assert planar.wrap(np.pi) == pytest.approx(np.pi)
    assert planar.wrap(-np.pi) == pytest.approx(np.pi)
    assert planar.wrap(3.0 * np.pi / 2.0) == pytest.approx(-np.pi / 2.0)


def test_many_at_once_are_each_as_one_alone():
    rng = np.random.default_rng(0)
    angles, arms = np.array([*rng.uniform(-10.0, 10.0, 20), np.pi, -np.pi]), rng.normal(0.0, 3.0, (22, 2))
    np.testing.assert_allclose(planar.wrap_all(angles), [planar.wrap(angle) for angle in angles], atol=1e-12)
    rotated = [planar.rotation(angle) @ arm for angle, arm in zip(angles, arms, strict=True)]
    np.testing.assert_allclose(planar.rotate_all(arms, angles), rotated, atol=1e-12)
    roots = rng.normal(size=(22, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1)
    carried = [
        planar.transport_covariance(each, float(angle), np.zeros(2), arm)
        for each, angle, arm in zip(covariances, angles, arms, strict=True)
    ]
    np.testing.assert_allclose(planar.transport_covariances(covariances, angles, arms), carried, atol=1e-9)
