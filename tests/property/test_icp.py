"""ICP on whatever clouds: never an exception, never a leap, and a batch is its pairs one by one, in any order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import registration
from registration import planar, se3
from registration.types import MotionPrior, Status

METHODS = ("icp", "plane-icp")
REACH = 3.0  # of a motion beyond its start [m]: objects are smaller, so a longer one is a leap


@st.composite
def clouds(draw, place=(20.0, -7.0, 0.5)):
    """Any cloud of an object's size: a box's sides, a ring, a line, few points, one point many times, none."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.sampled_from([0, 1, 2, 3, 4, 6, 10, 30, 120]))
    shape = draw(st.sampled_from(["solid", "sides", "ring", "line", "wall", "floor", "same", "upright"]))
    points = rng.uniform([-2.2, -0.9, 0.0], [2.2, 0.9, 1.5], (n, 3))
    if shape == "sides":
        is_side = rng.random(n) < 0.6
        points[is_side, 1] = -0.9
        points[~is_side, 0] = -2.2
    flat = {"ring": [(2, 0.7), (1, -0.9)], "line": [(1, 0.0), (2, 0.0)], "wall": [(1, -0.9)], "floor": [(2, 0.0)]}
    flat |= {"same": [(0, 1.0), (1, 1.0), (2, 1.0)], "upright": [(0, 0.3), (1, 0.3)]}
    for axis, value in flat.get(shape, []):
        points[:, axis] = value
    noise = draw(st.sampled_from([0.0, 0.02]))
    turn = se3.from_yaw(draw(st.floats(-3.1, 3.1)), np.array(place))
    return se3.transform(turn, points + rng.normal(0.0, noise, (n, 3)) if noise else points)


pairs = st.tuples(clouds(), clouds() | clouds(place=(21.0, -6.0, 0.4)))


def check(result, source, target, start=None):
    T, covariance = result.T_target_source, result.covariance
    assert np.isfinite(T).all()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert T[2, 2] == 1.0
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    if len(source) and len(target):
        expected = target.mean(axis=0) - source.mean(axis=0) if start is None else start
        moved = result.motion_about(source.mean(axis=0))
        assert np.hypot(*(moved[:2] - expected[:2])) < REACH
    else:
        assert result.status is Status.TOO_FEW_POINTS


def same(a, b):
    np.testing.assert_array_equal(a.T_target_source, b.T_target_source)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    assert (a.status, a.n_pairs, a.n_iterations) == (b.status, b.n_pairs, b.n_iterations)


@pytest.mark.parametrize("name", METHODS)
@given(pair=pairs)
def test_any_pair_of_clouds_gives_a_planar_motion_without_a_leap(name, pair):
    result = registration.create(name).register(*pair)
    check(result, *pair)


@pytest.mark.parametrize("name", METHODS)
@given(pair=pairs, x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0), yaw=st.floats(-0.3, 0.3), sd=st.floats(0.0, 1.0))
def test_nor_does_any_prior_cause_one(name, pair, x, y, yaw, sd):
    mean = np.array([x, y, yaw])
    result = registration.create(name).register(*pair, MotionPrior(mean, sd**2 * np.eye(3)))
    check(result, *pair, start=mean)


@pytest.mark.parametrize("name", [*METHODS, "adh-3d"])
@pytest.mark.parametrize("threads", [1, 2])
@given(batch=st.lists(pairs, max_size=5), seed=st.integers(0, 1000))
def test_a_batch_is_its_pairs_one_by_one_in_any_order(name, threads, batch, seed):
    method = registration.create(name, threads=threads)
    prepared = [tuple(method.prepare(pair)) for pair in batch]
    together = method.align(prepared)
    assert len(together) == len(batch)
    for pair, result in zip(batch, together, strict=True):
        same(result, method.register(*pair))
    order = np.random.default_rng(seed).permutation(len(batch))
    shuffled = method.align([prepared[k] for k in order])
    for k, result in zip(order, shuffled, strict=True):
        same(result, together[k])


@pytest.mark.parametrize("name", METHODS)
@given(cloud=clouds(), x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), yaw=st.floats(-0.02, 0.02))
def test_a_moved_copy_is_found_within_the_covariance(name, cloud, x, y, yaw):
    true = np.array([x, y, yaw])
    center = cloud.mean(axis=0) if len(cloud) else np.zeros(3)
    T = planar.to_transform(true, center)
    result = registration.create(name).register(cloud, se3.transform(T, cloud))
    if result.status is Status.CONVERGED:
        error = result.motion_about(center)[:2] - true[:2]
        assert error @ np.linalg.solve(result.covariance[:2, :2], error) < 9.21  # 99 % of two degrees of freedom


@pytest.mark.parametrize("name", METHODS)
@given(pair=pairs, east=st.sampled_from([0.0, 4e5]), north=st.sampled_from([0.0, -5e6]))
def test_kilometres_from_the_origin_nothing_is_lost(name, pair, east, north):
    far = np.array([east, north, 100.0])
    method = registration.create(name)
    near, away = method.register(*pair), method.register(*(cloud + far for cloud in pair))
    if Status.CONVERGED is near.status is away.status and len(pair[0]) > 5:
        center = pair[0].mean(axis=0)
        off = near.motion_about(center) - away.motion_about(center + far)
        assert np.abs(off).max() < 5e-3
