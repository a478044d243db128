"""LiDAR odometry: KISS-ICP on the static scene, online, for drives that come without poses."""

import importlib
import importlib.util
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from registration import se3
from registration.errors import MissingLibraryError
from registration.synthetic.lidar import pose_after
from registration.types import Points, Transform
from tracker.ego_motion.contract import EgoPose
from tracker.ego_motion.static_scene import START_SPEEDS, SceneSettings, static_points
from tracker.ego_motion.sweep import moved_to_frame_time, twist_of_step
from tracker.types import Frame, Twist

N_TRIED = 5000  # points at least that a start is judged by
CLEARLY = 0.02  # a start is better if this share of the points more fits the map
CLOSE = 0.2  # points nearer than this to the map fit it [m]
BEAM_ANGLE = np.deg2rad(0.205)  # that KITTI's scans are raised by to correct the calibration of its sensor [rad]


@dataclass(frozen=True)
class OdometrySettings:
    """How KISS-ICP runs; its own defaults for a sensor of 100 m."""

    scene: SceneSettings = field(default_factory=SceneSettings)
    max_range: float = 100.0  # [m]
    voxel_size: float = 1.0  # of its map [m]
    max_points_per_voxel: int = 20
    max_iterations: int = 500
    start_speeds: tuple[float, ...] = START_SPEEDS  # that a drive may start with [m/s]
    min_points: int = 200  # fewer static points make no scan
    correct_beam_angles: bool = False  # raise each point by 0.205 degrees, as evaluations on KITTI do


def has_kiss_icp() -> bool:
    """Tell whether KISS-ICP is installed."""
    return importlib.util.find_spec("kiss_icp") is not None


def raised(points_lidar: Points, angle: float = float(BEAM_ANGLE)) -> Points:
    """Turn each point about the sensor, upwards by an angle [rad].

    Source: Deschaud, "IMLS-SLAM", ICRA 2018, section V: the 0.205 degrees by which KITTI's sensor is off.
    """
    horizontal = np.hypot(points_lidar[:, 0], points_lidar[:, 1])
    c, s = np.cos(angle), np.sin(angle)
    stretch = c - s * points_lidar[:, 2] / np.maximum(horizontal, 1e-9)
    return np.column_stack([points_lidar[:, :2] * stretch[:, None], s * horizontal + c * points_lidar[:, 2]])


class LidarOdometry:
    """Register each scan to a local map of those before it; the world is the first scan's LiDAR frame.

    The boxes of objects are taken out of the scans.  Where a frame says how the sensor turns (`Frame.sweep`), points
    are moved to the frame's instant by the motion found so far; the first scan once the second has told it.  Of the
    speeds that a car may start with, the one whose second scan fits best is taken.  Scans with too few points get a
    guess at constant velocity, flagged.  Memory is bounded by the map, which reaches as far as the sensor.  One thread,
    so that the same scans give the same bits.

    Source: Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", RA-L 8(2), 2023; the package `kiss-icp`.
    """

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        """Load KISS-ICP.

        Raises:
            MissingLibraryError: it cannot be imported.
        """
        self._settings = settings or OdometrySettings()
        self._kiss = _new_kiss(self._settings)
        self._first: tuple[Frame, Points] | None = None
        self._time: float | None = None
        self._twist: Twist = np.zeros(6)

    def update(self, frame: Frame) -> EgoPose:
        """Take the next scan; its boxes are those of all objects that may move."""
        dt = 0.0 if self._time is None else frame.timestamp - self._time
        points = static_points(frame, self._settings.scene)
        if self._settings.correct_beam_angles:
            points = raised(points)
        self._kiss.last_delta = pose_after(self._twist, dt)
        if len(points) < self._settings.min_points:
            self._kiss.last_pose = self._kiss.last_pose @ self._kiss.last_delta
            self._time = None if self._is_empty else frame.timestamp
            return EgoPose(self._kiss.last_pose.copy(), is_flagged=True)
        if self._is_empty:
            self._first = (frame, points)
        elif self._first is not None:
            self._start_again(frame, points, dt)
        self._register(frame, points, dt)
        return EgoPose(self._kiss.last_pose.copy())

    @property
    def _is_empty(self) -> bool:
        return bool(self._kiss.local_map.empty())

    def _register(self, frame: Frame, points: Points, dt: float) -> None:
        before = self._kiss.last_pose.copy()
        if frame.sweep is not None:
            points = moved_to_frame_time(points, replace(frame.sweep, twist_lidar=self._twist))
        self._kiss.register_frame(points, np.empty(0))
        self._kiss.last_pose[:3, :3] = se3.nearest_rotation(self._kiss.last_pose[:3, :3])
        if dt > 0.0:
            self._twist = twist_of_step(se3.invert(before) @ self._kiss.last_pose, dt)
        self._time = frame.timestamp

    def _start_again(self, frame: Frame, points: Points, dt: float) -> None:
        """Find the motion between the first two scans, and put the first one into the map as that motion says."""
        first, self._first = self._first, None
        if first is None:
            return
        pose, time = self._kiss.last_pose.copy(), self._time
        best = (-1.0, self._twist)
        for speed in self._settings.start_speeds:
            start = np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
            self._begin(first, pose, start, dt)
            on_map = self._kiss.local_map.point_cloud()
            self._register(frame, points, dt)
            seen = se3.transform(self._kiss.last_pose, points[:: 1 + len(points) // N_TRIED])
            share = float((cKDTree(on_map).query(seen, distance_upper_bound=CLOSE)[0] < CLOSE).mean())
            if share > best[0] + CLEARLY:
                best = (share, start if frame.sweep is None else self._twist)
        self._begin(first, pose, best[1], dt)
        self._time = time

    def _begin(self, first: tuple[Frame, Points], pose: Transform, twist: Twist, dt: float) -> None:
        """Start a map of one scan, seen at a pose by a sensor with this motion."""
        self._kiss, self._twist = _new_kiss(self._settings), twist
        self._kiss.last_pose = pose.copy()
        self._register(*first, 0.0)
        self._kiss.last_pose, self._kiss.last_delta = pose.copy(), pose_after(twist, dt)


def _new_kiss(settings: OdometrySettings) -> Any:
    try:
        kiss_icp = importlib.import_module("kiss_icp.kiss_icp")
        configs = importlib.import_module("kiss_icp.config.config")
        parser = importlib.import_module("kiss_icp.config.parser")
    except ImportError as error:
        raise MissingLibraryError(
            f"LiDAR odometry needs kiss-icp, which cannot be imported ({error}). "
            "Install it with: pip install 'regmot[odometry]'"
        ) from error
    scene = settings.scene
    return kiss_icp.KissICP(
        parser.KISSConfig(
            data=configs.DataConfig(max_range=settings.max_range, min_range=scene.min_range, deskew=False),
            mapping=configs.MappingConfig(
                voxel_size=settings.voxel_size, max_points_per_voxel=settings.max_points_per_voxel
            ),
            registration=configs.RegistrationConfig(max_num_iterations=settings.max_iterations, max_num_threads=1),
        )
    )
