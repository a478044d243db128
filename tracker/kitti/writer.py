"""Rows and files of a KITTI tracking folder, written: the inverse of the readers beside it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.types import Point, Points, Transform
from tracker.files import write_whole
from tracker.kitti.calib import Calibration
from tracker.types import Box

IMAGE_WIDTH, IMAGE_HEIGHT = 1242, 375  # [px]
EARTH_RADIUS = 6378137.0  # pykitti's [m]
ORIGIN_LAT, ORIGIN_LON, ORIGIN_ALT = 50.85, 6.35, 98.0  # where simulated drives start [deg, deg, m]
GRAVITY = 9.81  # [m/s^2]

_FOCAL, _CX, _CY = 720.0, 610.0, 174.0  # of the rectified cameras [px]
_BASELINES = (0.0, 0.54, -0.06, 0.47)  # of cameras 0 to 3, to the right of camera 0 [m]


@dataclass(frozen=True, slots=True)
class EgoState:
    """What a GPS/IMU measures at one moment.

    Attributes:
        T_world_imu: pose; world is east-north-up with its origin at the first IMU position.
        velocity_world: [m/s].
        acceleration_world: without gravity [m/s^2].
        rate_imu: turn rates about the IMU's axes [rad/s].
    """

    T_world_imu: Transform
    velocity_world: Point
    acceleration_world: Point
    rate_imu: Point


def euler_rotation(roll: float, pitch: float, yaw: float) -> Float64[np.ndarray, "3 3"]:
    """Compose Rz(yaw) Ry(pitch) Rx(roll), as GPS/IMU records do [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    Rx = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    Ry = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    Rz = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return Rz @ Ry @ Rx


def euler_angles(R: Float64[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Give roll, pitch, yaw of `euler_rotation` [rad]; |pitch| < pi/2."""
    roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    return float(roll), float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))), float(yaw)


# Camera axes (x right, y down, z forward) in LiDAR axes (x forward, y left, z up).
_R_CAM_LIDAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_R_RECT = euler_rotation(0.0045, -0.0070, -0.0095)  # unrectified to rectified camera 0

# A car of our own: sensors where KITTI's are, give or take, and mounted a little crooked like KITTI's.
SIMULATED_CALIBRATION = Calibration(
    T_cam_lidar=se3.pose(
        _R_RECT @ euler_rotation(-0.0105, 0.0080, 0.0030) @ _R_CAM_LIDAR, np.array([-0.005, -0.072, -0.291])
    ),
    T_lidar_imu=se3.pose(euler_rotation(0.0072, -0.0031, -0.0094), np.array([-0.83, 0.31, -0.80])),
)


def format_calib(calibration: Calibration) -> str:
    """Write `calib/NNNN.txt`: cameras of our own, and the given places of the sensors."""
    T_rect = se3.pose(_R_RECT, np.zeros(3))
    entries = {f"P{camera}": _projection(camera) for camera in range(len(_BASELINES))}
    entries["R0_rect"] = _R_RECT
    entries["Tr_velo_to_cam"] = (se3.invert(T_rect) @ calibration.T_cam_lidar)[:3]
    if calibration.T_lidar_imu is not None:
        entries["Tr_imu_to_velo"] = calibration.T_lidar_imu[:3]
    rows = (f"{key}: {' '.join(f'{value:.12e}' for value in M.ravel())}\n" for key, M in entries.items())
    return "".join(rows)


def _projection(camera: int) -> Float64[np.ndarray, "3 4"]:
    """Give the 3x4 matrix from rectified camera 0 to the pixels of a camera."""
    K = np.array([[_FOCAL, 0.0, _CX], [0.0, _FOCAL, _CY], [0.0, 0.0, 1.0]])
    return np.column_stack([K, [-_FOCAL * _BASELINES[camera], 0.0, 0.0]])


def format_label(
    box: Box, frame: int, calibration: Calibration, projection: Float64[np.ndarray, "3 4"] | None = None
) -> str:
    """Write a box as a row of `label_02/NNNN.txt`.

    KITTI's boxes stand upright in the camera's axes: the row keeps centre, size and heading and loses the lean.
    A box that leaves the image is truncated (1), one outside it wholly so (2), and has no image box (-1).

    Args:
        box: what is written.
        frame: its number.
        calibration: where the sensors sit.
        projection: from rectified camera 0 to the pixels of camera 2; None for that of our own cameras.
    """
    R_cam_obj = calibration.T_cam_lidar[:3, :3] @ box.T_lidar_obj[:3, :3]
    center_cam = se3.transform(calibration.T_cam_lidar, box.center_lidar[None])[0]
    rotation_y = float(np.arctan2(-R_cam_obj[2, 0], R_cam_obj[0, 0]))
    alpha = _wrapped(rotation_y - float(np.arctan2(center_cam[0], center_cam[2])))
    length, width, height = box.size
    bottom_cam = center_cam + [0.0, 0.5 * height, 0.0]
    corners_cam = se3.transform(calibration.T_cam_lidar, box.corners_lidar)
    truncation, image_box = _image_box(corners_cam, _projection(2) if projection is None else projection)
    numbers = [alpha, *image_box, height, width, length, *bottom_cam, rotation_y]
    head = f"{frame} {box.track_id} {box.class_name} {truncation} {box.occlusion}"
    return f"{head} {' '.join(f'{number:.6f}' for number in numbers)}\n"


def _image_box(corners_cam: Points, projection: Float64[np.ndarray, "3 4"]) -> tuple[int, Float64[np.ndarray, "4"]]:
    """Find the upright box around eight corners in the image of camera 2 [px], and how truncated it is."""
    if corners_cam[:, 2].min() < 0.1:
        return 2, np.full(4, -1.0)
    pixels = np.column_stack([corners_cam, np.ones(8)]) @ projection.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    limit = np.array([IMAGE_WIDTH - 1.0, IMAGE_HEIGHT - 1.0])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    if (high < 0.0).any() or (low > limit).any():
        return 2, np.full(4, -1.0)
    is_cut = bool((low < 0.0).any() or (high > limit).any())
    return int(is_cut), np.concatenate([np.clip(low, 0.0, limit), np.clip(high, 0.0, limit)])


def _wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def format_oxts(state: EgoState) -> str:
    """Write a GPS/IMU record of 30 columns, in the order of KITTI's dataformat.

    Latitude and longitude invert pykitti's Mercator projection, whose scale is that of the first record: this
    holds for drives whose first IMU position is the world's origin.
    """
    x, y, z = state.T_world_imu[:3, 3]
    reach = EARTH_RADIUS * np.cos(np.deg2rad(ORIGIN_LAT))
    north = np.log(np.tan(np.deg2rad(90.0 + ORIGIN_LAT) / 2.0)) + y / reach
    place = [2.0 * np.rad2deg(np.arctan(np.exp(north))) - 90.0, ORIGIN_LON + np.rad2deg(x / reach), ORIGIN_ALT + z]
    R_world_imu = state.T_world_imu[:3, :3]
    angles = euler_angles(R_world_imu)
    R_world_heading = euler_rotation(0.0, 0.0, angles[2])
    east, north_speed, _ = velocity = state.velocity_world
    force = state.acceleration_world + [0.0, 0.0, GRAVITY]  # what an accelerometer feels
    numbers = [
        *place, *angles, north_speed, east, *(velocity @ R_world_heading),
        *(force @ R_world_imu), *(force @ R_world_heading),
        *state.rate_imu, *(R_world_imu @ state.rate_imu @ R_world_heading),
    ]  # fmt: skip
    # Accuracies of position and velocity [m, m/s]; navigation status, satellites and three modes: all well.
    return f"{' '.join(repr(float(number)) for number in numbers)} 0.05 0.02 4 8 6 6 6\n"


def format_time(nanoseconds: int) -> str:
    """Write a time of day as a row of `times/NNNN.txt`; nanoseconds count from a day and hour we made up."""
    seconds, fraction = divmod(nanoseconds, 1_000_000_000)
    minutes, second = divmod(seconds, 60)
    hours, minute = divmod(minutes, 60)
    return f"2026-05-12 {9 + hours:02d}:{minute:02d}:{second:02d}.{fraction:09d}\n"


def write_scan(path: Path, points_lidar: Points, intensity: Float64[np.ndarray, " n"]) -> None:
    """Write a sweep as float32 x, y, z, reflectance."""
    columns = np.column_stack([points_lidar, intensity]).astype("<f4")
    write_whole(path, columns.tobytes())
