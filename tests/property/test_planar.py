"""Whatever the motion and the cloud: frames round-trip, motions form a group, alignment finds the truth."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from registration import planar, se3

lengths = st.floats(-50.0, 50.0)
yaws = st.floats(-3.1, 3.1)
motions = st.builds(lambda x, y, yaw: np.array([x, y, yaw]), lengths, lengths, yaws)
centers = arrays(np.float64, 2, elements=lengths)
covariances = arrays(np.float64, (3, 3), elements=st.floats(-1.0, 1.0)).map(lambda a: a @ a.T)


@st.composite
def clouds(draw):
    """Ordinary, flat, collinear, duplicate and tiny clouds."""
    n = draw(st.integers(1, 25))
    cloud = draw(arrays(np.float64, (n, 3), elements=st.floats(-5.0, 5.0)))
    kind = draw(st.sampled_from(["full", "flat", "line", "same"]))
    if kind == "flat":
        cloud[:, 1] = 0.0
    elif kind == "line":
        cloud = np.outer(cloud[:, 0], [1.0, 0.5, 0.2])
    elif kind == "same":
        cloud[:] = cloud[0]
    return cloud


@given(motion=motions)
def test_a_motion_and_its_inverse_cancel(motion):
    np.testing.assert_allclose(planar.compose(planar.invert(motion), motion), np.zeros(3), atol=1e-9)


@given(a=motions, b=motions)
def test_composing_motions_is_multiplying_their_matrices(a, b):
    T = planar.to_transform(b, np.zeros(3)) @ planar.to_transform(a, np.zeros(3))
    composed = planar.to_transform(planar.compose(b, a), np.zeros(3))
    np.testing.assert_allclose(composed, T, atol=1e-9)


@given(motion=motions, old=centers, new=centers)
def test_a_motion_is_the_same_rigid_motion_about_any_centre(motion, old, new):
    moved = planar.change_center(motion, old, new)
    expected = planar.to_transform(motion, np.array([*old, 0.0]))
    np.testing.assert_allclose(planar.to_transform(moved, np.array([*new, 0.0])), expected, atol=1e-9)
    np.testing.assert_allclose(planar.change_center(moved, new, old), motion, atol=1e-9)


@given(motion=motions, center=centers)
def test_matrix_and_triple_round_trip(motion, center):
    point = np.array([*center, 1.0])
    T = planar.to_transform(motion, point)
    np.testing.assert_allclose(planar.motion_about(T, point), motion, atol=1e-9)
    np.testing.assert_allclose(se3.invert(T) @ T, np.eye(4), atol=1e-9)


@given(covariance=covariances, yaw=yaws, old=centers, new=centers)
def test_covariance_goes_to_another_centre_and_comes_back(covariance, yaw, old, new):
    there = planar.transport_covariance(covariance, yaw, old, new)
    assert np.linalg.eigvalsh(there).min() > -1e-6 * max(1.0, np.trace(there))
    # The Jacobian depends on the offset only, so going back undoes it exactly.
    back = planar.transport_covariance(there, yaw, new, old)
    np.testing.assert_allclose(back, covariance, atol=1e-8 * max(1.0, np.trace(there)))


@given(cloud=clouds(), motion=motions)
def test_a_known_motion_is_recovered_even_from_degenerate_clouds(cloud, motion):
    T_true = planar.to_transform(motion, np.zeros(3))
    T = planar.align_pairs(cloud, se3.transform(T_true, cloud))
    # Coincident points leave the turn free: what must hold for every cloud is where its points go.
    if np.ptp(cloud[:, :2], axis=0).max() == 0.0:
        assert se3.yaw(T) == 0.0
    np.testing.assert_allclose(se3.transform(T, cloud)[:, :2], se3.transform(T_true, cloud)[:, :2], atol=1e-7)


@given(angle=st.floats(-1000.0, 1000.0))
def test_wrapping_keeps_the_direction_and_the_interval(angle):
    wrapped = planar.wrap(angle)
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)
