"""Tiny KITTI folders, written by plain code that shares nothing with the readers: what they are checked against.

Three objects: a car that drives away, a pedestrian who crosses, a van that stands far off.
"""

from dataclasses import dataclass
from math import asinh, atan2, cos, pi, radians, sin, tan
from pathlib import Path

import numpy as np

DAY, DRIVE = "2011_09_26", "2011_09_26_drive_0009_sync"
EARTH_RADIUS = 6378137.0  # KITTI's development kit [m]

# LiDAR (x forward, y left, z up) to camera (x right, y down, z forward): axes change names, the origin moves.
LIDAR_TO_CAM = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, -0.08], [1.0, 0.0, 0.0, -0.27]]
IMU_TO_LIDAR = [[1.0, 0.0, 0.0, -0.81], [0.0, 1.0, 0.0, 0.32], [0.0, 0.0, 1.0, -0.8]]
IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass(frozen=True)
class Thing:
    """One object in one frame: its box in LiDAR axes, and the points that the sensor sees of it."""

    track_id: int
    class_name: str
    center: tuple[float, float, float]
    yaw: float
    size: tuple[float, float, float]  # length, width, height
    n_points: int

    def points(self) -> np.ndarray:
        """Spread the points over the box, well inside it."""
        along = np.linspace(-0.4, 0.4, self.n_points)
        x, y, z = along * self.size[0], along[::-1] ** 3 * self.size[1], along * self.size[2]
        c, s = cos(self.yaw), sin(self.yaw)
        return np.column_stack([c * x - s * y, s * x + c * y, z]) + self.center


def things(frame: int) -> list[Thing]:
    """List the objects of a frame; the van comes at frame 2 and is seen by no beam at frame 3."""
    car = Thing(0, "Car", (10.0 + frame, 2.0, -0.9), 0.0, (4.0, 1.6, 1.5), 9 + frame)
    walker = Thing(3, "Pedestrian", (6.0, -3.0 + 0.25 * frame, -0.75), pi / 2, (0.8, 0.6, 1.75), 5)
    van = Thing(1, "Van", (15.0, -6.0, -0.5), -2.5, (5.0, 2.0, 2.25), 0 if frame == 3 else 7)
    return [car, walker] if frame < 2 else [van, car, walker]


def scan(frame: int) -> np.ndarray:
    """Give x, y, z, reflectance of a sweep: the objects' points between those of a wall 30 m away."""
    n = 12 + frame
    wall = np.column_stack([np.full(n, 30.0), np.linspace(-9.0, 9.0, n), np.full(n, -1.0)])
    points = np.concatenate([wall[::2], *(thing.points() for thing in things(frame)), wall[1::2]])
    return np.column_stack([points, np.full(len(points), 0.5)]).astype("<f4")


def wrapped(angle: float) -> float:
    """Bring an angle to (-pi, pi]."""
    return atan2(sin(angle), cos(angle))


def label_row(frame: int, thing: Thing) -> str:
    """Write one row of `label_02`: KITTI gives the bottom's centre in camera axes."""
    x, y, z = thing.center
    length, width, height = thing.size
    bottom = (-y, -z - 0.08 + height / 2, x - 0.27)
    numbers = [height, width, length, *bottom, wrapped(-thing.yaw - pi / 2)]
    columns = " ".join(f"{number:.9f}" for number in numbers)
    return f"{frame} {thing.track_id} {thing.class_name} 0 {thing.track_id % 3} -1.5 10.0 20.0 110.0 120.0 {columns}\n"


def dont_care_row(frame: int) -> str:
    return f"{frame} -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1\n"


def row_of(matrix) -> str:
    return " ".join(f"{float(value):.12e}" for row in matrix for value in row)


def calib_text(with_imu: bool = True) -> str:
    projections = "".join(f"P{camera}: {row_of(LIDAR_TO_CAM)}\n" for camera in range(4))
    imu = f"Tr_imu_to_velo: {row_of(IMU_TO_LIDAR)}\n" if with_imu else ""
    return f"{projections}R0_rect: {row_of(IDENTITY)}\nTr_velo_to_cam: {row_of(LIDAR_TO_CAM)}\n{imu}\n"


def write(path: Path, content: str | bytes) -> Path:
    """Write a file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def write_tracking(root: Path, name: str = "0000", n_frames: int = 5, missing: tuple[int, ...] = ()) -> Path:
    """Write labels, calibration and scans below `root/training`; gives that folder."""
    training = root / "training"
    rows = [row for k in range(n_frames) for row in [dont_care_row(k), *(label_row(k, thing) for thing in things(k))]]
    write(training / "label_02" / f"{name}.txt", "".join(rows))
    write(training / "calib" / f"{name}.txt", calib_text())
    for k in range(n_frames):
        if k not in missing:
            write(training / "velodyne" / name / f"{k:06d}.bin", scan(k).tobytes())
    return training


def stamp(frame: int) -> str:
    """Give the time of a sweep: 0.1 s and a frame-dependent millisecond apart."""
    return f"2011-09-26 13:02:{25 + frame // 10:02d}.{frame % 10}0{frame % 7}000000"


def seconds(frame: int) -> float:
    """Give the same time in seconds since midnight."""
    return 13 * 3600 + 2 * 60 + 25 + frame // 10 + (frame % 10) / 10 + (frame % 7) / 1000


def ego_state(frame: int) -> tuple[float, float, float, float, float, float]:
    """Give latitude, longitude [deg], altitude [m], roll, pitch, yaw [rad] of the GPS/IMU."""
    return 49.0 + 2e-6 * frame, 8.4 + 9e-6 * frame, 112.0 + 0.1 * frame, 0.01, -0.02 * frame, 0.3 + 0.05 * frame


def oxts_row(frame: int) -> str:
    """Write one GPS/IMU record of 30 columns."""
    place = " ".join(repr(number) for number in ego_state(frame))
    return f"{place} {' '.join(['0.25'] * 19)} 4 8 6 6 6\n"


def true_pose(frame: int) -> np.ndarray:
    """Compute T_world_lidar of `oxts_row` with the other textbook form of Mercator's projection."""
    lat0, lon0, alt0 = ego_state(0)[:3]
    lat, lon, alt, roll, pitch, yaw = ego_state(frame)
    reach = EARTH_RADIUS * cos(radians(lat0))
    east = reach * radians(lon - lon0)
    north = reach * (asinh(tan(radians(lat))) - asinh(tan(radians(lat0))))
    T_world_imu = np.eye(4)
    T_world_imu[:3, :3] = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    T_world_imu[:3, 3] = east, north, alt - alt0
    return T_world_imu @ np.linalg.inv(np.vstack([IMU_TO_LIDAR, [0.0, 0.0, 0.0, 1.0]]))


def turn(axis: int, angle: float) -> np.ndarray:
    """Turn about one axis, counter-clockwise seen from its tip."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = cos(angle)
    R[i, j], R[j, i] = -sin(angle), sin(angle)
    return R


def pose_rows(n_frames: int) -> str:
    """Write a pose file: each frame 2 m further and 0.1 rad turned."""
    return "".join(f"{row_of(np.column_stack([turn(2, 0.1 * k), [2.0 * k, 0.0, 0.0]]))}\n" for k in range(n_frames))


def tracklet_xml(n_frames: int) -> str:
    """Write the objects as KITTI's raw drives give them: boost's archive, boxes standing on their bottoms."""
    by_track: dict[int, list[tuple[int, Thing]]] = {}
    for k in range(n_frames):
        for thing in things(k):
            by_track.setdefault(thing.track_id, []).append((k, thing))
    items = "".join(_tracklet_item(steps) for steps in by_track.values())
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9">\n'
        '<tracklets class_id="0" tracking_level="0" version="0">\n'
        f"\t<count>{len(by_track)}</count>\n\t<item_version>1</item_version>\n{items}</tracklets>\n"
        "</boost_serialization>\n"
    )


def _tracklet_item(steps: list[tuple[int, Thing]]) -> str:
    first, thing = steps[0]
    length, width, height = thing.size
    poses = "".join(_pose_item(step) for _, step in steps)
    return (
        f'\t<item class_id="1" tracking_level="0" version="1">\n\t\t<objectType>{thing.class_name}</objectType>\n'
        f"\t\t<h>{height}</h>\n\t\t<w>{width}</w>\n\t\t<l>{length}</l>\n\t\t<first_frame>{first}</first_frame>\n"
        '\t\t<poses class_id="2" tracking_level="0" version="0">\n'
        f"\t\t\t<count>{len(steps)}</count>\n\t\t\t<item_version>2</item_version>\n{poses}\t\t</poses>\n"
        "\t\t<finished>1</finished>\n\t</item>\n"
    )


def _pose_item(thing: Thing) -> str:
    x, y, z = thing.center
    values = {
        "tx": x, "ty": y, "tz": z - thing.size[2] / 2, "rx": 0, "ry": 0, "rz": thing.yaw, "state": 2,
        "occlusion": thing.track_id % 3, "occlusion_kf": 1, "truncation": 0, "amt_occlusion": 0, "amt_occlusion_kf": 1,
        "amt_border_l": 0, "amt_border_r": 0, "amt_border_kf": 1,
    }  # fmt: skip
    lines = "".join(f"\t\t\t\t<{key}>{value}</{key}>\n" for key, value in values.items())
    return f'\t\t\t<item class_id="3" tracking_level="0" version="2">\n{lines}\t\t\t</item>\n'


def write_raw(root: Path, n_frames: int = 5, missing: tuple[int, ...] = ()) -> Path:
    """Write a raw drive and its day's calibration; missing scans are blank lines among the scans' stamps."""
    drive = root / DAY / DRIVE
    scans, imu = drive / "velodyne_points", drive / "oxts"
    for k in range(n_frames):
        write(imu / "data" / f"{k:010d}.txt", oxts_row(k))
        if k not in missing:
            write(scans / "data" / f"{k:010d}.bin", scan(k).tobytes())
    write(scans / "timestamps.txt", "".join("\n" if k in missing else f"{stamp(k)}\n" for k in range(n_frames)))
    write(imu / "timestamps.txt", "".join(f"{imu_stamp(k)}\n" for k in range(n_frames)))
    write(drive / "tracklet_labels.xml", tracklet_xml(n_frames))
    rotation, place = np.array(IMU_TO_LIDAR)[:, :3], np.array(IMU_TO_LIDAR)[:, 3:]
    text = f"calib_time: 25-May-2012 16:47:16\nR: {row_of(rotation)}\nT: {row_of(place)}\n"
    write(root / DAY / "calib_imu_to_velo.txt", text)
    return drive


def imu_stamp(frame: int) -> str:
    """Give the time of a GPS/IMU record: a minute later than the scan's, so that the two cannot be mistaken."""
    return stamp(frame).replace("13:02:", "13:03:")
