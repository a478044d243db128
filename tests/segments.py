"""Small segments and tracks for tests: an L of points that moves as it is told."""

import numpy as np

from registration import se3
from tracker.types import EstimateStatus, Segment, Tracklet, VelocityEstimate


def car_cloud(n=200, seed=0, noise=0.01):
    """Sample the long side and the rear of a car about its centre, z above the ground."""
    rng = np.random.default_rng(seed)
    on_side = rng.random(n) < 0.7
    x = np.where(on_side, rng.uniform(-2.0, 2.0, n), -2.0)
    y = np.where(on_side, -0.9, rng.uniform(-0.9, 0.9, n))
    return np.column_stack([x, y, rng.uniform(0.0, 1.4, n)]) + rng.normal(0.0, noise, (n, 3))


def segment(points, frame, dt=0.1, track_id=7, class_name="Car", ground=-1.7):
    return Segment(track_id, class_name, frame, frame * dt, np.asarray(points, dtype=np.float64), ground)


def moving_tracklet(velocity, n_frames=6, start=(12.0, 5.0), dt=0.1, cloud=None, yaw_rate=0.0, ego_velocity=None):
    """Let one and the same cloud move with a constant velocity [m/s] in the world.

    With `ego_velocity` the sensor moves too and the tracklet has poses; without, it stands at the world's origin
    and the tracklet has none.
    """
    cloud = car_cloud() if cloud is None else cloud
    segments, poses = [], []
    for k in range(n_frames):
        t = k * dt
        place = np.array([*start, -1.7]) + np.array([*velocity, 0.0]) * t
        world = se3.transform(se3.from_yaw(yaw_rate * t, place), cloud)
        ego = np.zeros(3) if ego_velocity is None else np.array([*ego_velocity, 0.0]) * t
        T_world_lidar = se3.from_yaw(0.0 if ego_velocity is None else 0.05 * k, ego)
        segments.append(segment(se3.transform(se3.invert(T_world_lidar), world), k, dt))
        poses.append(None if ego_velocity is None else T_world_lidar)
    return Tracklet(7, "Car", tuple(segments), tuple(poses))


def steps(estimator, tracklet):
    """Feed a tracklet frame by frame; give the estimates."""
    return [
        estimator.step({tracklet.track_id: s}, s.timestamp, T)[tracklet.track_id]
        for s, T in zip(tracklet.segments, tracklet.T_world_lidar, strict=True)
    ]


def estimate(frame, velocity, variance=1.0, dt=0.1, status=EstimateStatus.CONVERGED, time=None):
    return VelocityEstimate(
        track_id=7,
        frame=frame,
        timestamp=frame * dt if time is None else time,
        frame_name="world",
        position=np.zeros(2),
        velocity=np.asarray(velocity, dtype=np.float64),
        covariance=variance * np.eye(2),
        yaw_rate=0.0,
        range_m=10.0,
        n_points=100,
        status=status,
    )
