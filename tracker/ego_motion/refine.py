"""Poses refined online: each scan registered to a local map of the static scene, from a first guess of any origin."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from registration import se3
from registration.synthetic.lidar import pose_after
from registration.types import Points, Transform
from tracker.ego_motion.contract import EgoEstimator, EgoPose, PlanarCovariance, RecordedPoses
from tracker.ego_motion.scan_to_map import Fit, LocalMap, RefineSettings, fit, thin_out
from tracker.ego_motion.static_scene import static_points
from tracker.ego_motion.sweep import moved_to_frame_time, twist_of_step
from tracker.types import UNKNOWN_STEP, Frame, StepCovariance, Twist

_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and yaw of (x, y, z, rotation vector)


class Refiner:
    """Register each scan's static points to a map of the last ones, starting from what another estimator says.

    The prior may jump by centimetres (GPS/IMU records that jitter against the scans), drift, or be missing: then the
    last step is repeated, as it is where odometry has lost its way.  The heading is drawn back to that of recorded
    poses slowly enough to be no motion.  A scan with nothing static in it gets the prior's step, flagged, with a
    covariance that says that nothing is known; one with nothing that holds the pose in some direction is flagged too;
    after one that does not fit the map at all, a new map begins.
    """

    def __init__(self, prior: EgoEstimator | None, settings: RefineSettings | None = None) -> None:
        """Start without a map; `prior` None expects each step to repeat the last."""
        self._prior, self._settings = prior, settings or RefineSettings()
        self._keyframes: list[tuple[Points, Transform]] = []  # points in the map's world, pose
        self._map: LocalMap | None = None
        self._first: tuple[Frame, Points] | None = None  # the scan in a map of one, as it came
        self._T_map: Transform = np.eye(4)  # T_world_lidar in the map's world, which drifts
        self._last: EgoPose | None = None
        self._believed: Transform | None = None  # the prior's last pose
        self._time = 0.0
        self._twist: Twist = np.zeros(6)

    def update(self, frame: Frame) -> EgoPose:
        """Take the next scan; its boxes are those of all objects that may move.

        Raises:
            MissingLibraryError: small_gicp cannot be imported.
        """
        believed = None if self._prior is None else self._prior.update(frame)
        points = static_points(frame, self._settings.scene)
        if self._last is None:
            start = np.eye(4) if believed is None else believed.T_world_lidar
            pose = EgoPose(start, is_flagged=not self._begin_map(frame, points, start))
        else:
            pose = self._follow(frame, points, believed)
        self._last, self._time = pose, frame.timestamp
        self._believed = None if believed is None else believed.T_world_lidar
        return pose

    def _begin_map(self, frame: Frame, points: Points, T_map: Transform) -> bool:
        """Start a map with one scan; tell whether there is enough of it."""
        self._T_map, self._map, self._keyframes, self._first = T_map, None, [], None
        if len(points) < self._settings.min_pairs:
            return False
        self._first = (frame, points)
        self._add_keyframe(self._prepared(frame, points), T_map)
        return True

    def _add_keyframe(self, points_lidar: Points, T_map: Transform) -> None:
        self._keyframes.append((se3.transform(T_map, points_lidar), T_map))
        self._keyframes = self._keyframes[-self._settings.n_keyframes :]
        together = np.concatenate([points for points, _ in self._keyframes])
        self._map = LocalMap.of(together, T_map[:3, 3].copy(), self._settings)

    def _prepared(self, frame: Frame, points: Points) -> Points:
        """Bring points to the frame's instant by the motion found last, where the frame says how the sensor turns."""
        if frame.sweep is not None:
            points = moved_to_frame_time(points, replace(frame.sweep, twist_lidar=self._twist))
        return thin_out(points, self._settings)

    def _follow(self, frame: Frame, points: Points, believed: EgoPose | None) -> EgoPose:
        dt = frame.timestamp - self._time
        step = self._expected_step(believed, dt)
        step = self._best_start(frame, points, step, dt)
        found = self._fit_twice(frame, points, step, dt)
        if found is None or found.n_pairs < self._settings.min_pairs:
            return self._guess(frame, points, step)
        step = se3.invert(self._T_map) @ found.T_world_lidar
        self._T_map = found.T_world_lidar
        self._twist, self._first = twist_of_step(step, dt), None
        T_world_lidar = self._drawn_back(self._last_pose @ step, believed, dt)
        # The covariance comes in the axes of the map's world, which may have turned away from the output's by little.
        covariance = found.covariance[_PLANAR]
        pose = EgoPose(T_world_lidar, covariance, is_flagged=not self._is_held(found))
        if self._is_far_from_keyframe():
            self._add_keyframe(self._prepared(frame, points), self._T_map)
        return replace(pose, step_covariance=self._step_covariance(pose))

    @property
    def _last_pose(self) -> Transform:
        return np.eye(4) if self._last is None else self._last.T_world_lidar

    def _expected_step(self, believed: EgoPose | None, dt: float) -> Transform:
        if believed is None or believed.is_flagged or self._believed is None:
            return pose_after(self._twist, dt)
        return se3.invert(self._believed) @ believed.T_world_lidar

    def _best_start(self, frame: Frame, points: Points, step: Transform, dt: float) -> Transform:
        """Choose where to start from: records are believed; of anything else, the step that fits best is taken."""
        starts = self._starts(step, dt)
        best = None
        for start in starts if len(starts) > 1 and len(points) >= self._settings.min_pairs else []:
            self._twist = twist_of_step(start, dt)
            found = self._fit_twice(frame, points, start, dt)
            if found is not None and (best is None or found.support > best.support):
                best = found
        if best is not None:
            step = se3.invert(self._T_map) @ best.T_world_lidar
        if self._first is not None or best is not None:
            self._twist = twist_of_step(step, dt)
        return step

    def _starts(self, step: Transform, dt: float) -> list[Transform]:
        """List the steps that may be: the expected one; the last one again, where odometry says another; after a
        first scan, all that a car may drive.
        """
        if isinstance(self._prior, RecordedPoses):
            return [step]
        if self._first is not None:
            speeds = self._settings.start_speeds
            return [step, *(pose_after(np.array([v, 0.0, 0.0, 0.0, 0.0, 0.0]), dt) for v in speeds)]
        again = pose_after(self._twist, dt)
        is_other = np.linalg.norm(again[:3, 3] - step[:3, 3]) > self._settings.doubt
        return [step, again] if is_other else [step]

    def _fit_twice(self, frame: Frame, points: Points, step: Transform, dt: float) -> Fit | None:
        """Register a scan; where points are moved to one instant, again by the motion that came out.

        None where there are no points or no map; a fit of too few pairs is one of a scan that the map does not show.
        """
        if len(points) < self._settings.min_pairs or self._map is None:
            return None
        found = None
        for _ in range(1 if frame.sweep is None else 2):
            found = fit(self._map, self._prepared(frame, points), self._T_map @ step, self._settings)
            if found.n_pairs < self._settings.min_pairs:
                return found
            step = se3.invert(self._T_map) @ found.T_world_lidar
            self._twist = twist_of_step(step, dt)
            if self._first is not None and frame.sweep is not None:
                self._keyframes = []
                self._add_keyframe(self._prepared(*self._first), self._T_map)
        return found

    def _is_held(self, found: Fit) -> bool:
        return bool(np.linalg.eigvalsh(found.covariance[:2, :2])[-1] < self._settings.lost**2)

    def _guess(self, frame: Frame, points: Points, step: Transform) -> EgoPose:
        """Go on as expected; where there are points, and they are not in the map, they start a new one."""
        self._T_map = self._T_map @ step
        self._twist = twist_of_step(step, frame.timestamp - self._time)
        if len(points) >= self._settings.min_pairs:
            self._begin_map(frame, points, self._T_map)
        return EgoPose(self._last_pose @ step, step_covariance=UNKNOWN_STEP.copy(), is_flagged=True)

    def _is_far_from_keyframe(self) -> bool:
        away = se3.invert(self._keyframes[-1][1]) @ self._T_map
        turn = float(np.linalg.norm(Rotation.from_matrix(away[:3, :3]).as_rotvec()))
        shift = float(np.linalg.norm(away[:3, 3]))
        return shift > self._settings.keyframe_distance or turn > self._settings.keyframe_turn

    def _drawn_back(self, T_world_lidar: Transform, believed: EgoPose | None, dt: float) -> Transform:
        """Turn the sensor about itself towards the prior's rotation, a little: maps drift, GPS/IMU headings do not."""
        if believed is None or not isinstance(self._prior, RecordedPoses):
            return T_world_lidar
        off = Rotation.from_matrix(believed.T_world_lidar[:3, :3] @ T_world_lidar[:3, :3].T).as_rotvec()
        R = Rotation.from_rotvec(dt / self._settings.drift_time * off).as_matrix() @ T_world_lidar[:3, :3]
        return se3.pose(se3.nearest_rotation(R), T_world_lidar[:3, 3])

    def _step_covariance(self, pose: EgoPose) -> StepCovariance:
        """Add up the covariances of a step's two ends, which the map makes independent of each other.

        A scan that began a map is that map: it has no error of its own, unless it was empty and its pose a guess.
        """
        last = self._last
        if last is None or pose.covariance is None or (last.covariance is None and last.is_flagged):
            return UNKNOWN_STEP.copy()
        if last.covariance is None:
            return pose.covariance
        shift = pose.T_world_lidar[:2, 3] - last.T_world_lidar[:2, 3]
        return pose.covariance + carried_to(last.covariance, shift)


def carried_to(covariance: PlanarCovariance, arm: np.ndarray) -> PlanarCovariance:
    """Carry a covariance of (x, y, yaw) about one point to another that is `arm` (x, y) away [m]."""
    J = np.eye(3)
    J[:2, 2] = -arm[1], arm[0]
    return J @ covariance @ J.T
