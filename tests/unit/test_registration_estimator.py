"""Velocity by registration: frames, reference point, empty segments, gaps, and each segment prepared once."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from registration import se3
from registration.methods.icp import PointToPointICP
from tests.segments import car_cloud, moving_tracklet, segment, steps
from tracker.errors import InputError, UnknownEstimatorError
from tracker.estimators import create_estimator, estimator_names
from tracker.estimators.contract import Estimator
from tracker.estimators.registration import RegistrationEstimator
from tracker.types import EstimateStatus


@pytest.mark.parametrize("name", estimator_names())
def test_every_estimator_keeps_the_protocol(name):
    assert isinstance(create_estimator(name), Estimator)


def test_an_unknown_estimator_lists_what_there_is():
    with pytest.raises(UnknownEstimatorError, match=r"no estimator 'centriod-kf'. Did you mean 'centroid-kf'\?"):
        create_estimator("centriod-kf")


def test_the_first_look_knows_no_velocity_and_says_so():
    first = steps(create_estimator("icp"), moving_tracklet((3.0, 0.0)))[0]
    assert first.status is EstimateStatus.NEW_TRACK
    assert first.abstained
    assert first.covariance[0, 0] == 30.0**2


def test_relative_velocity_comes_without_poses_and_ground_velocity_with_them():
    tracklet = moving_tracklet((3.0, 1.0), ego_velocity=(10.0, 0.0))
    for estimate in steps(create_estimator("icp"), tracklet)[1:]:
        np.testing.assert_allclose(estimate.velocity, [3.0, 1.0], atol=1e-4)
        assert estimate.frame_name == "world"
    parked = moving_tracklet((0.0, 0.0), ego_velocity=(10.0, 0.0), n_frames=2)
    estimator = create_estimator("icp")
    relative = [estimator.step({7: s}, s.timestamp, None)[7] for s in parked.segments][-1]
    # The ego drives 1 m on and turns by 0.05 rad: seen from it, the middle of the first cloud moves like this.
    points = parked.segments[0].points_lidar
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    T_world_l0, T_world_l1 = parked.T_world_lidar
    moved = se3.transform(se3.invert(T_world_l1) @ T_world_l0, middle[None])[0]
    assert relative.frame_name == "sensor"
    np.testing.assert_allclose(relative.velocity, (moved - middle)[:2] / 0.1, atol=1e-3)
    assert relative.velocity[0] < -7.0


def test_velocity_refers_to_the_middle_of_the_bounding_box_not_to_the_centroid():
    # A cloud that turns about the middle of its bounding box does not move, however its points are spread.
    dense = np.repeat([[2.0, 0.9, 0.5]], 40, axis=0) + np.random.default_rng(0).normal(0, 1e-3, (40, 3))
    corners = np.array([[2.0, 0.9, 0.2], [-2.0, 0.9, 0.3], [-2.0, -0.9, 0.4], [2.0, -0.9, 0.2]])
    cloud = np.vstack([dense, corners, corners + [0, 0, 1.0]])
    cloud = cloud - 0.5 * (cloud.min(axis=0) + cloud.max(axis=0)) * [1, 1, 0]
    tracklet = moving_tracklet((0.0, 0.0), n_frames=2, cloud=cloud, yaw_rate=0.3)
    last = steps(create_estimator("icp"), tracklet)[-1]
    assert np.hypot(*last.velocity) < 0.01
    assert last.yaw_rate == pytest.approx(0.3, abs=1e-3)


def test_real_time_steps_divide_the_displacement():
    for dt in (0.05, 0.1033, 0.2):
        last = steps(create_estimator("icp"), moving_tracklet((1.0, 0.5), n_frames=2, dt=dt))[-1]
        np.testing.assert_allclose(last.velocity, [1.0, 0.5], atol=1e-4)


def test_no_points_hold_the_last_velocity_with_growing_doubt():
    estimator = create_estimator("icp")
    known = steps(estimator, moving_tracklet((3.0, 0.0), n_frames=3))[-1]
    held = estimator.step({7: segment(np.empty((0, 3)), 3)}, 0.3, None)[7]
    again = estimator.step({7: segment(np.empty((0, 3)), 4)}, 0.4, None)[7]
    assert held.status is EstimateStatus.NO_POINTS
    np.testing.assert_array_equal(held.velocity, known.velocity)
    assert known.covariance[0, 0] < held.covariance[0, 0] < again.covariance[0, 0]
    back = estimator.step({7: moving_tracklet((3.0, 0.0), n_frames=6).segments[5]}, 0.5, None)[7]
    np.testing.assert_allclose(back.velocity, [3.0, 0.0], atol=1e-4)  # over 0.3 s


def test_a_look_that_comes_next_to_no_time_after_the_last_tells_of_no_velocity():
    """What crosses the end of a sweep is seen at 0.249 and again at 0.251 s, hardly moved, and then 0.1 s later."""
    estimator, tracklet = create_estimator("icp"), moving_tracklet((3.0, 0.0), n_frames=5, dt=0.1)
    lates, found = (0.049, 0.049, 0.049, -0.049, -0.049), []
    for k, (one, late) in enumerate(zip(tracklet.segments, lates, strict=True)):
        points = one.points_lidar + [3.0 * late + (0.01 if k == 3 else 0.0), 0.0, 0.0]
        timed = replace(one, points_lidar=points, timestamp=one.timestamp + late, seen_after=late)
        found.append(estimator.step({7: timed}, one.timestamp, None)[7])
    assert found[3].status is EstimateStatus.NO_POINTS
    for estimate in found[1:]:
        np.testing.assert_allclose(estimate.velocity, [3.0, 0.0], atol=1e-3)


def test_a_track_that_was_away_starts_anew():
    estimator = create_estimator("icp")
    tracklet = moving_tracklet((3.0, 0.0), n_frames=6)
    steps(estimator, tracklet)
    estimator.step({}, 0.6, None)
    assert estimator.step({7: tracklet.segments[0]}, 0.7, None)[7].status is EstimateStatus.NEW_TRACK


def test_losing_the_poses_starts_all_tracks_anew():
    estimator = create_estimator("icp")
    tracklet = moving_tracklet((3.0, 0.0), n_frames=3, ego_velocity=(10.0, 0.0))
    steps(estimator, tracklet)
    assert estimator.step({7: tracklet.segments[2]}, 0.3, None)[7].status is EstimateStatus.NEW_TRACK


def test_one_point_abstains_with_a_fallback():
    estimator = create_estimator("icp")
    cloud = car_cloud()[:1]
    last = steps(estimator, moving_tracklet((3.0, 0.0), n_frames=2, cloud=cloud))[-1]
    assert last.status is EstimateStatus.TOO_FEW_POINTS
    np.testing.assert_allclose(last.velocity, [3.0, 0.0])
    assert last.covariance[0, 0] > 5.0**2


@dataclass(frozen=True)
class CountingICP(PointToPointICP):
    prepared = []

    def prepare_cloud(self, points):
        self.prepared.append(len(points))
        return super().prepare_cloud(points)


def test_each_segment_is_prepared_once_though_it_is_aligned_twice():
    CountingICP.prepared.clear()
    steps(RegistrationEstimator(CountingICP()), moving_tracklet((3.0, 0.0), n_frames=6))
    assert len(CountingICP.prepared) == 6


def test_objects_of_a_frame_do_not_influence_each_other():
    a, b = moving_tracklet((3.0, 0.0)), moving_tracklet((-6.0, 2.0), start=(30.0, -8.0), cloud=car_cloud(seed=5))
    together = create_estimator("icp")
    alone = steps(create_estimator("icp"), b)
    for k, (s, t) in enumerate(zip(a.segments, b.segments, strict=True)):
        both = together.step({1: s, 2: t}, s.timestamp, None)
        np.testing.assert_array_equal(both[2].velocity, alone[k].velocity)


@pytest.mark.parametrize("name", estimator_names())
def test_smoothing_a_tracklet_is_smoothing_its_steps_and_leaves_live_tracks_alone(name):
    estimator = create_estimator(name)
    live, other = moving_tracklet((3.0, 0.0)), moving_tracklet((-2.0, 1.0), cloud=car_cloud(seed=3))
    expected = steps(create_estimator(name), live)
    steps(estimator, live)
    offline = estimator.smooth(other)
    causal = steps(create_estimator(name), other)
    for a, b in zip(offline, estimator.smoothed(causal), strict=True):
        np.testing.assert_array_equal(a.velocity, b.velocity)
    again = estimator.step({7: live.segments[-1]}, 0.6, None)[7]
    assert again.status is not EstimateStatus.NEW_TRACK
    assert len(expected) == len(offline)


def test_a_track_whose_first_box_is_empty_starts_with_its_first_points():
    estimator = create_estimator("icp")
    cloud = car_cloud() + [10.0, 0.0, 0.0]
    estimator.step({7: segment(np.empty((0, 3)), 0)}, 0.0, None)
    first = estimator.step({7: segment(cloud, 1)}, 0.1, None)[7]
    assert first.status is EstimateStatus.NEW_TRACK
    np.testing.assert_allclose(first.position, 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))[:2])


@pytest.mark.parametrize("name", ["centroid-kf", "icp"])
def test_nan_points_and_time_that_stands_still_are_errors_for_every_estimator(name):
    estimator = create_estimator(name)
    cloud = car_cloud()
    estimator.step({7: segment(cloud, 1)}, 0.1, None)
    with pytest.raises(InputError, match=r"track 7, frame 2: expected finite points"):
        estimator.step({7: segment(np.where(cloud > 1.3, np.nan, cloud), 2)}, 0.2, None)
    with pytest.raises(InputError, match=r"track 7, frame 2: expected a time after 0.1 s, got 0.1 s"):
        estimator.step({7: segment(cloud, 2)}, 0.1, None)
