"""What there is to see: actors that move, a background that does not, and the car with the sensor."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.errors import unknown_name
from registration.synthetic.bodies import Body
from registration.synthetic.meshes import Mesh
from registration.types import Transform
from tracker.errors import InputError
from tracker.kitti.calib import Calibration
from tracker.simulation.trajectories import EgoDrive, Motion

PERIOD = 0.1  # between two sweeps [s]
CLASSES = ("Car", "Van", "Truck", "Pedestrian", "Person", "Person_sitting", "Cyclist", "Tram", "Misc")  # KITTI's


@dataclass(frozen=True)
class Actor:
    """Something with a box and an identity.

    Attributes:
        track_id: unique in its scene.
        class_name: one of `CLASSES`.
        body: what it looks like.
        motion: where it is; the origin is on the ground below its centre.
    """

    track_id: int
    class_name: str
    body: Body
    motion: Motion

    def __post_init__(self) -> None:
        if self.class_name not in CLASSES:
            raise InputError(unknown_name("class of KITTI's", self.class_name, CLASSES))

    def mesh(self, t: float) -> Mesh:
        """Shape at time t, in the actor's own axes."""
        return self.body.mesh(self.motion.distance(t))

    def T_world_obj(self, t: float) -> Transform:  # noqa: N802 - names carry frames
        """Pose at time t; the origin is on the ground below the centre."""
        return self.motion.pose(t)

    def footprint(self, t: float) -> Float64[np.ndarray, "4 2"]:
        """Corners of the box on the ground at time t, in the world [m]."""
        length, width, _ = self.body.size
        return _rectangle(self.T_world_obj(t), length, width)


@dataclass(frozen=True)
class Scene:
    """A stretch of traffic, as a function of time.

    The world is east-north-up; its origin is the first position of the ego car's IMU, as in KITTI's GPS/IMU poses.

    Attributes:
        name: as the simulation's record says it.
        actors: what gets labels.
        background: what gets none: buildings, kerbs, trees; in the world.
        ground_z: height of the ground in the world [m].
        ego: motion of the IMU of the car with the sensor.
        calibration: where its sensors sit.
        n_frames: number of sweeps; frame k is at time k * `period`.
        ego_length: bumper to bumper [m].
        ego_width: [m].
        ego_center_x: middle of the ego car, ahead of its IMU [m].
        ego_center_y: and to the left of it [m].
        period: between two sweeps [s].
    """

    name: str
    actors: tuple[Actor, ...]
    background: Mesh
    ground_z: float
    ego: EgoDrive
    calibration: Calibration
    n_frames: int
    ego_length: float = 4.75
    ego_width: float = 1.82
    ego_center_x: float = 1.35
    ego_center_y: float = -0.31
    period: float = PERIOD

    def __post_init__(self) -> None:
        ids = [actor.track_id for actor in self.actors]
        if len(set(ids)) != len(ids):
            raise InputError(f"track ids must be unique in a scene, got {sorted(ids)}")
        if np.abs(self.T_world_imu(0.0)[:3, 3]).max() > 1e-6:
            raise InputError(
                "a scene's world starts at the IMU's first position, this one's IMU is elsewhere at time 0"
            )
        if self.n_frames < 1:
            raise InputError(f"a scene needs at least 1 frame, got {self.n_frames}")

    def T_world_imu(self, t: float) -> Transform:  # noqa: N802 - names carry frames
        """Pose of the ego car's IMU at time t."""
        return self.ego.pose(t)

    def T_world_lidar(self, t: float) -> Transform:  # noqa: N802 - names carry frames
        """Pose of the sensor at time t."""
        if self.calibration.T_lidar_imu is None:
            raise InputError("a scene needs to know where the IMU is: its calibration has no T_lidar_imu")
        return self.ego.pose(t) @ se3.invert(self.calibration.T_lidar_imu)

    def ego_footprint(self, t: float) -> Float64[np.ndarray, "4 2"]:
        """Corners of the ego car on the ground at time t, in the world [m]."""
        T_imu_center = se3.from_yaw(0.0, np.array([self.ego_center_x, self.ego_center_y, 0.0]))
        return _rectangle(self.T_world_imu(t) @ T_imu_center, self.ego_length, self.ego_width)


class SceneRecipe(Protocol):
    """What sets a scene: its random numbers are its own, apart from those of the sensor."""

    def __call__(self, seed: int = 0, n_frames: int = 100) -> Scene:
        """Set the scene.

        Args:
            seed: of the scene, 0 or more.
            n_frames: number of sweeps, 10 a second.

        Raises:
            InputError: fewer than 1 frame, or more than the scene is long: 300 unless it says otherwise.
        """


def _rectangle(T_world_obj: Transform, length: float, width: float) -> Float64[np.ndarray, "4 2"]:
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    corners = np.column_stack([0.5 * signs * [length, width], np.zeros(4)])
    return se3.transform(T_world_obj, corners)[:, :2]
