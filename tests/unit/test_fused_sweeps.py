"""The fused estimator and raw sweeps: what moves until the beams pass, when each look was, and where sweeps end."""

from dataclasses import replace

import numpy as np
import pytest

from registration import se3
from tests.looks import encoded, kept, passed_at
from tests.segments import car_cloud, segment
from tests.windows import Window
from tracker.ego_motion.sweep import point_times
from tracker.estimators import create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings, track_kernels
from tracker.estimators.fused.sensor import Sensor
from tracker.estimators.fused.steps import read
from tracker.types import Sweep


def test_what_an_object_moved_while_the_beams_passed_it_is_undone():
    cloud, center, velocity = car_cloud(400) + [3.0, 3.0, 0.0], np.array([3.0, 3.0]), np.array([-10.0, 1.0])
    azimuth = np.arctan2(cloud[:, 1], cloud[:, 0]) - np.arctan2(*center[::-1])
    lags = np.random.default_rng(3).choice([-2e-3, 2e-3], len(cloud))  # of two lasers that fire together
    seen = cloud.copy()
    # clockwise: what is left was seen before
    seen[:, :2] += (-azimuth / (2.0 * np.pi) * 0.1 + lags)[:, None] * velocity
    assert np.abs(seen - cloud).max() > 0.05
    bent = kept(seen, encoded(seen), lags)
    assert bent.time == pytest.approx(0.1 + bent.delay)
    cloud[:, :2] += (bent.delay - passed_at(bent.sensor, center[None])) * velocity
    straight = bent.straightened(velocity)
    np.testing.assert_allclose(straight.points, cloud, atol=0.02)  # the bend moves the points' azimuths a little
    assert straight.straightened(velocity) is straight


def test_a_close_car_that_is_bent_by_the_sweep_has_its_true_velocity():
    """Passing at 3 m and 8 m/s, its ends are seen up to 24 ms apart, and its bend changes from scan to scan."""
    found = {}
    for is_swept in (False, True):
        estimator, errors = create_estimator("fused"), []
        for k in range(9):
            center, velocity = np.array([7.0 - 0.8 * k, 3.0]), np.array([-8.0, 0.0])
            cloud = car_cloud(1500, seed=k) + [*center, 0.0]
            azimuth = np.arctan2(cloud[:, 1], cloud[:, 0]) - np.arctan2(*center[::-1])
            cloud[:, :2] += (-azimuth / (2.0 * np.pi) * 0.1)[:, None] * velocity
            one = replace(segment(cloud, k), is_swept=is_swept)
            answer = estimator.step({one.track_id: one}, one.timestamp, None)[one.track_id]
            errors.append(abs(answer.velocity[0] + 8.0))
        found[is_swept] = np.mean(errors[4:])
    assert found[True] < 0.5 * found[False]


def test_a_car_that_stands_is_known_to_in_raw_sweeps_of_a_sensor_that_drives_past():
    """At 15 m/s, 4 m beside it: until the beams meet the car the sensor drives on, ever farther from scan to scan."""
    found = {}
    for is_swept in (False, True):
        estimator = FusedEstimator(settings=FusedSettings(knows_parked=False))
        for k in range(9):
            T_world_lidar = se3.from_yaw(0.0, np.array([1.5 * k, 0.0, 0.0]))
            cloud = car_cloud(800, seed=k) + [14.0, 4.0, 0.0] - T_world_lidar[:3, 3]
            seen = cloud.copy()
            for _ in range(4):
                seen[:, 0] = cloud[:, 0] + 15.0 * 0.1 / (2.0 * np.pi) * np.arctan2(seen[:, 1], seen[:, 0])
            one = replace(segment(seen, k), is_swept=is_swept)
            answer = estimator.step({one.track_id: one}, one.timestamp, T_world_lidar)[one.track_id]
        found[is_swept] = np.hypot(*answer.velocity)
        assert found[False] > 0.3
    assert found[True] < 0.1


def passing(velocity, sensor_velocity, k, sweep=None):
    """Give frame k of a car that passes 4 m beside the sensor; each of its points is seen when the beams pass it.

    And how long after the time of the frame they met its centre.
    """
    cloud, t = car_cloud(1500, seed=k), 0.1 * k
    delays, late = np.zeros(len(cloud)), 0.0
    for _ in range(6):
        seen = cloud + [40.0, 4.0, 0.0]
        seen[:, :2] += np.outer(t + delays, velocity - sensor_velocity)
        delays = -np.arctan2(seen[:, 1], seen[:, 0]) / (2.0 * np.pi) * 0.1
        x, y = np.array([40.0, 4.0]) + (t + late) * (velocity - sensor_velocity)
        late = -np.arctan2(y, x) / (2.0 * np.pi) * 0.1
    look_time = float(point_times(seen, Sweep(np.zeros(6))).mean()) if sweep else 0.0
    one = replace(segment(seen, k), is_swept=True, sweep=sweep, timestamp=t + look_time, seen_after=look_time)
    return one, late


@pytest.mark.parametrize("in_world", [False, True])
def test_what_passes_fast_is_told_by_the_time_between_frames_or_between_looks(in_world):
    """At 30 m/s and 4 m, looks are a tenth less than a frame apart, so labels move by a tenth less."""
    velocity, sensor_velocity = np.array([-15.0, 0.0]), np.array([15.0, 0.0])
    true = velocity if in_world else velocity - sensor_velocity
    for sweep in (None, Sweep(np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0]), to_frame_time=in_world)):
        estimator, before, seeming = create_estimator("fused"), None, []
        for k in range(18):
            one, late = passing(velocity, sensor_velocity, k, sweep)
            T_world_lidar = se3.from_yaw(0.0, np.array([1.5 * k, 0.0, 0.0])) if in_world else None
            answer = estimator.step({one.track_id: one}, 0.1 * k, T_world_lidar)[one.track_id]
            if k > 6:
                by_clock = 1.0 if sweep else 1.0 + (late - before) / 0.1
                np.testing.assert_allclose(answer.velocity, by_clock * true, atol=0.25)
                seeming.append(by_clock)
            before = late
        assert sweep is not None or min(seeming) < 0.92


def test_an_object_right_behind_is_not_known_by_the_time_between_frames():
    """It drifts across the direction in which sweeps end: seen late in one, early in the next, it moves for 0 ms."""
    estimator, found = create_estimator("fused"), []
    for k in range(12):
        cloud = car_cloud(400, seed=k) + [-20.0, 3.3 - 0.6 * k, 0.0]
        one = replace(segment(cloud, k), is_swept=True)
        found.append(estimator.step({one.track_id: one}, 0.1 * k, None)[one.track_id])
    sd = np.array([np.sqrt(answer.covariance[1, 1]) for answer in found[2:]])
    assert sd.max() > 3.0  # where it crosses
    assert np.median(sd) < 0.5
    assert all(np.abs(answer.velocity[1]) < 12.0 for answer in found)


def test_where_the_centre_may_have_crossed_the_end_of_sweeps_the_velocity_is_unsure_too():
    """Where it is, is known to 0.25 m: a step that ends 0.2 m before may have crossed, one that ends 3 m before not.

    What crosses the line of sight in front is passed by the beams in order.
    """
    unsure = {}
    for name, x, last in (("near", -20.0, 0.2), ("far", -20.0, 3.0), ("front", 20.0, 0.0)):
        estimator = create_estimator("fused")
        for k in range(12):
            cloud = car_cloud(400, seed=k) + [x, last + 0.6 * (11 - k), 0.0]
            one = replace(segment(cloud, k), is_swept=True)
            answer = estimator.step({one.track_id: one}, 0.1 * k, None)[one.track_id]
        unsure[name] = np.sqrt(np.diag(answer.covariance))
    assert unsure["near"][1] > 1.0
    assert max(unsure["far"].max(), unsure["front"].max()) < 0.5


def test_what_straddles_the_end_of_a_sweep_is_put_together_and_believed_less():
    """A car follows 10 m behind and falls back by 2 m/s: its halves are seen 100 ms apart."""
    cloud, center, velocity = car_cloud(400) + [-10.0, 0.0, 0.0], np.array([-10.0, 0.0]), np.array([-2.0, 0.0])
    sensor = Sensor(np.zeros(2), 0.0)
    seen = cloud.copy()
    seen[:, :2] += (passed_at(sensor, cloud[:, :2]) - passed_at(sensor, center[None]))[:, None] * velocity
    assert np.abs(seen - cloud).max() == pytest.approx(0.2, abs=0.01)
    behind = kept(seen, encoded(seen), np.zeros(len(seen)))
    assert behind.is_torn
    cloud[:, :2] += (behind.delay - passed_at(sensor, center[None])) * velocity
    np.testing.assert_allclose(behind.straightened(velocity).points, cloud, atol=0.01)
    assert not kept(-seen, encoded(-seen), np.zeros(len(seen))).is_torn
    sure = []
    for place in (10.0, -10.0):
        estimator = create_estimator("fused")
        for k in range(6):
            one = replace(segment(car_cloud(400, seed=k) + [place, 0.0, 0.0], k), is_swept=True)
            answer = estimator.step({one.track_id: one}, one.timestamp, None)[one.track_id]
        sure.append(np.trace(answer.covariance))
    assert sure[1] > 1.3 * sure[0]


def test_shapes_are_believed_less_along_the_way_where_nobody_knows_when_lasers_fire():
    """In raw sweeps of an unknown sensor; the direction across the way is known as well as ever."""
    found = {}
    for share in (0.0, 0.008):
        estimator = FusedEstimator(settings=FusedSettings(shape_moved=0.0, untimed_moved=share))
        for k in range(8):
            one = replace(segment(car_cloud(400, seed=k) + [20.0 - 1.5 * k, 4.0, 0.0], k), is_swept=True)
            answer = estimator.step({one.track_id: one}, one.timestamp, None)[one.track_id]
        found[share] = np.sqrt(np.diag(answer.covariance))
    assert found[0.008][0] > 1.3 * found[0.0][0]
    assert found[0.008][1] < 1.1 * found[0.0][1]


def test_places_tell_of_velocities_at_any_rate_of_frames():
    """Twenty times a second, the time between two looks is short because that between frames is."""
    estimator = create_estimator("fused")
    for k in range(6):
        one = segment(car_cloud(60, seed=k) + [15.0 + 0.3 * k, 4.0, 0.0], k, dt=0.05)
        estimator.step({one.track_id: one}, one.timestamp, None)
    known, place = estimator._known, Window(estimator._known.places, estimator._tracks[7].row)
    state = place.frames.state, known.turns.rows.frames.state, known.centers
    centers = [track_kernels.center_at(*state, place.row, j) for j in range(len(place))]
    found = read(known, place.at, 1.0).velocities
    np.testing.assert_allclose(found, np.diff(centers, axis=0) / 0.05, atol=1e-9)
    rates = 0.5 * (place.state[1:, 1] + place.state[:-1, 1])
    assert np.abs(found - rates).max() > 1e-4
