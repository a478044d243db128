"""Trajectories, the street scene, and the KITTI folders that simulations write."""

import csv
import dataclasses
import json
import re
from collections import defaultdict
from itertools import combinations

import numpy as np
import pytest
from pykitti.utils import load_oxts_packets_and_poses

from registration import se3
from registration.synthetic.bodies import RigidBody, WalkingBody
from registration.synthetic.cars import SEDAN, car
from registration.synthetic.lidar import HDL_64E, BeamModel
from registration.synthetic.meshes import Material, box_mesh
from tracker.boxes import points_in_boxes
from tracker.errors import DataError, InputError
from tracker.kitti import open_sequence, writer
from tracker.kitti.calib import read_projection, read_tracking_calib
from tracker.kitti.labels import read_labels
from tracker.kitti.truth import COLUMNS
from tracker.simulation import create_scene, simulate
from tracker.simulation.folder import Recording, ego_state, simulate_frame
from tracker.simulation.jitter import BoxJitter
from tracker.simulation.scenes import Actor, Scene
from tracker.simulation.street import street_scene
from tracker.simulation.trajectories import Drive, EgoDrive, Speed, SpeedChange, Standing, curve_from_curvature
from tracker.types import Box

COARSE = BeamModel("coarse", HDL_64E.elevations[::4], float(np.deg2rad(0.7)))
AS_COARSE = Recording(COARSE)
GROUND_Z = -0.93
STREET = street_scene(0)


def small_scene(n_frames: int = 3) -> Scene:
    """Set a scene of a braking ego car on a bend, a car ahead, one behind it, and a person."""
    start = -20.0 * np.array([np.cos(0.5), np.sin(0.5)])
    curve = curve_from_curvature(start, 0.5, [(20.0, 0.0), (1.0, 0.02), (60.0, 0.02)], s_start=-20.0)
    body = RigidBody(car(SEDAN, Material.PAINT_LIGHT))
    ego = EgoDrive(Drive(curve, Speed(8.0, (SpeedChange(-0.5, 2.0, -3.0),)), 0.0, 0.0))
    here = se3.from_yaw(-2.9, np.array([-9.0, 4.0, GROUND_Z]))
    actors = (
        Actor(3, "Car", body, Drive(curve, Speed(7.0), 12.0, GROUND_Z, SEDAN.rear_axle_x)),
        Actor(7, "Car", body, Standing(here)),
        Actor(9, "Pedestrian", WalkingBody(), Drive(curve.beside(lambda s: 5.0 + 0.0 * s), Speed(1.4), 8.0, GROUND_Z)),
    )
    background = box_mesh(np.array([1.0, 60.0, 5.0]), Material.MASONRY)
    wall = background.moved(se3.from_yaw(0.5, np.array([40.0, 20.0, GROUND_Z])))
    return Scene("small", actors, wall, GROUND_Z, ego, writer.SIMULATED_CALIBRATION, n_frames)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate(small_scene(), tmp_path_factory.mktemp("kitti") / "out", recording=AS_COARSE)


def read_truth(folder):
    with (folder / "training/truth/0000.csv").open() as file:
        rows = list(csv.DictReader(file))
    numbers = {key: {(int(row["frame"]), int(row["track_id"])): float(row[key]) for row in rows} for key in rows[0]
               if key != "class_name"}  # fmt: skip
    return {at: {key: column[at] for key, column in numbers.items()} for at in numbers["frame"]}


# --- trajectories


def test_a_change_of_speed_ends_at_the_new_speed_and_its_acceleration_is_continuous():
    speed = Speed(5.0, (SpeedChange(1.0, 2.0, 3.0), SpeedChange(4.0, 1.0, -2.0)))
    assert [speed.speed(t) for t in (0.0, 1.0, 3.0, 4.0, 5.0, 50.0)] == pytest.approx([5, 5, 8, 8, 6, 6])
    # Half a change before and half after its middle: the way is that of the mean speed.
    assert speed.distance(3.0) == pytest.approx(5.0 * 1.0 + (5.0 + 8.0) / 2 * 2.0)
    accelerations = np.array([speed.acceleration(t) for t in np.arange(0.0, 6.0, 0.01)])
    assert accelerations.max() == pytest.approx(3.0 / (2.0 - 0.8))
    assert np.abs(np.diff(accelerations)).max() < 0.01 * 2.0 / 0.5 / 0.5 * 1.01


def test_a_speed_below_zero_is_refused():
    with pytest.raises(InputError, match="never be negative"):
        Speed(5.0, (SpeedChange(0.0, 2.0, -5.1),))


def test_a_curve_of_constant_curvature_is_a_circle():
    radius = 20.0
    curve = curve_from_curvature(np.zeros(2), 0.0, [(1e-3, 1 / radius), (np.pi * radius, 1 / radius)])
    half_way = 1e-3 + 0.5 * np.pi * radius
    np.testing.assert_allclose(curve.position(half_way), [radius, radius], atol=2e-3)
    assert curve.yaw(half_way) == pytest.approx(0.5 * np.pi, abs=1e-4)
    assert curve.curvature(half_way) == pytest.approx(1 / radius, rel=1e-4)
    beside = curve.beside(lambda s: np.full(len(s), 5.0))
    assert beside.curvature(half_way * 0.75) == pytest.approx(1 / (radius - 5.0), rel=1e-3)


def test_a_curve_goes_straight_on_beyond_its_ends_and_can_be_run_through_backwards():
    curve = curve_from_curvature(np.zeros(2), 0.3, [(10.0, 0.05)])
    end, direction = curve.position(10.0), curve.yaw(10.0)
    np.testing.assert_allclose(curve.position(13.0), end + 3.0 * np.array([np.cos(direction), np.sin(direction)]))
    assert curve.curvature(13.0) == 0.0
    backwards = curve.reversed()
    np.testing.assert_allclose(backwards.position(-4.0), curve.position(4.0), atol=1e-9)
    assert np.cos(backwards.yaw(-4.0) - curve.yaw(4.0)) == pytest.approx(-1.0)


def test_a_cars_rear_axle_follows_the_curve_and_its_nose_swings_out():
    curve = curve_from_curvature(np.zeros(2), 0.0, [(1.0, 0.05), (60.0, 0.05)])
    drive = Drive(curve, Speed(5.0), 0.0, 0.0, axle_x=-1.3)
    T_world_obj = drive.pose(4.0)
    axle = se3.transform(T_world_obj, np.array([[-1.3, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(axle[:2], curve.position(20.0), atol=1e-9)
    to_center = np.linalg.norm(T_world_obj[:2, 3] - [0.5, 20.0])
    assert to_center > 20.0


def test_a_braking_car_dips_its_nose_and_leans_out_of_a_bend():
    scene = small_scene()
    roll, pitch, _ = writer.euler_angles(scene.T_world_imu(0.5)[:3, :3])
    assert pitch > 0.003
    assert roll > 0.002


# --- the street scene


def separation(a: np.ndarray, b: np.ndarray) -> float:
    """Widest gap between two rectangles along the normals of their sides; negative when they overlap."""
    gaps = []
    for corner, side in ((p[i], p[i + 1] - p[i]) for p in (a, b) for i in (0, 1)):
        normal = np.array([-side[1], side[0]]) / np.linalg.norm(side)
        in_a, in_b = (a - corner) @ normal, (b - corner) @ normal
        gaps.append(max(in_a.min() - in_b.max(), in_b.min() - in_a.max()))
    return max(gaps)


@pytest.mark.parametrize(("seed", "n_frames", "every"), [(0, 100, 1), (1, 160, 5)])
def test_nobody_drives_through_anybody_else_or_the_ego_car(seed, n_frames, every):
    scene = street_scene(seed, n_frames)
    for frame in range(0, n_frames, every):
        t = frame * scene.period
        rectangles = [scene.ego_footprint(t), *(actor.footprint(t) for actor in scene.actors)]
        centers = np.array([rectangle.mean(axis=0) for rectangle in rectangles])
        apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
        for i, j in combinations(range(len(rectangles)), 2):
            if apart[i, j] < 6.0:
                assert separation(rectangles[i], rectangles[j]) > 0.2, f"frame {frame}: {i - 1} and {j - 1}"


def test_the_street_has_everything_that_a_street_needs():
    poses = np.array([[actor.T_world_obj(t) for t in np.arange(0.0, 10.0, 0.1)] for actor in STREET.actors])
    sensor = np.array([STREET.T_world_lidar(t) for t in np.arange(0.0, 10.0, 0.1)])
    range_m = np.linalg.norm(poses[..., :2, 3] - sensor[:, :2, 3], axis=-1)
    way = np.linalg.norm(poses[:, -1, :2, 3] - poses[:, 0, :2, 3], axis=-1)
    yaw = np.unwrap(np.arctan2(poses[..., 1, 0], poses[..., 0, 0]), axis=1)
    classes = np.array([actor.class_name for actor in STREET.actors])
    moving = (way > 1.0) & (classes != "Pedestrian")
    assert set(classes) == {"Car", "Van", "Pedestrian"}
    assert (~moving & (classes == "Car")).sum() >= 10
    assert (range_m[~moving] < 5.0).sum() >= 30
    assert (range_m[moving] < 5.0).sum() >= 30
    assert range_m[range_m < 80.0].max() > 75.0
    assert 2.5 < range_m.min() < 4.0
    assert np.ptp(yaw[moving], axis=1).max() > 1.4, "a car turns"
    turned = np.abs(np.cos(yaw[moving, 0] - yaw[moving, -1]))
    across = np.abs(np.sin(yaw[moving, 0] - np.arctan2(sensor[0, 1, 0], sensor[0, 0, 0])))
    assert ((across > 0.8) & (turned > 0.99)).any(), "a car crosses"


def test_all_motions_are_those_of_cars_and_persons():
    step, times = 0.01, np.arange(0.0, 10.0, 0.05)
    for motion in [STREET.ego.drive, *(actor.motion for actor in STREET.actors)]:
        before, now, after = (np.array([motion.pose(t + dt)[:2, 3] for t in times]) for dt in (-step, 0.0, step))
        acceleration = np.linalg.norm(after - 2.0 * now + before, axis=1) / step**2
        speed = np.linalg.norm(after - before, axis=1) / (2.0 * step)
        assert acceleration.max() < 4.0
        assert speed.max() < 14.0
        jerk = np.abs(np.diff([motion.distance(t) for t in np.arange(0.0, 10.0, 0.1)], n=3)) / 0.1**3
        assert jerk.max() < 5.0
        yaw = np.array([se3.yaw(motion.pose(t)) for t in times])
        slow = speed < 0.05
        sideways = -np.sin(yaw) * (after - before)[:, 0] + np.cos(yaw) * (after - before)[:, 1]
        assert (np.abs(sideways / (2.0 * step))[~slow] < 0.2 * speed[~slow]).all(), "cars do not slide"


def test_the_seed_changes_the_cars_but_not_who_meets_whom():
    scene, again, other = (street_scene(seed, n_frames=10) for seed in (0, 0, 5))
    for actor, same in zip(scene.actors, again.actors, strict=True):
        np.testing.assert_array_equal(actor.T_world_obj(3.0), same.T_world_obj(3.0))
        np.testing.assert_array_equal(actor.mesh(3.0).vertices, same.mesh(3.0).vertices)
    assert not np.array_equal(scene.actors[0].body.size, other.actors[0].body.size)
    assert [a.class_name for a in scene.actors[:7]] == [a.class_name for a in other.actors[:7]]


def test_scenes_have_names():
    assert create_scene("street", n_frames=3).n_frames == 3
    with pytest.raises(InputError, match=r"no scene 'stret'. Did you mean 'street'\?"):
        create_scene("stret")


@pytest.mark.parametrize("n_frames", [0, 601])
def test_the_street_is_only_so_long(n_frames):
    with pytest.raises(InputError, match=f"1 to 600 frames, got {n_frames}"):
        street_scene(0, n_frames)


def test_a_scene_refuses_two_actors_of_one_name():
    scene = small_scene()
    with pytest.raises(InputError, match=r"unique in a scene, got \[3, 3\]"):
        dataclasses.replace(scene, actors=(scene.actors[0], scene.actors[0]))


def test_a_scene_refuses_a_world_that_starts_elsewhere():
    scene = small_scene()
    elsewhere = dataclasses.replace(scene.ego, drive=dataclasses.replace(scene.ego.drive, s_start=1.0))
    with pytest.raises(InputError, match="IMU is elsewhere at time 0"):
        dataclasses.replace(scene, ego=elsewhere)


# --- what a KITTI reader finds


def test_our_reader_opens_the_folder_and_finds_all_that_kitti_has(folder):
    sequence = open_sequence(folder, "0000")
    assert len(sequence) == 3
    np.testing.assert_allclose(np.diff(sequence.timestamps), 0.1, atol=1e-9)
    frame = sequence.frame(1)
    assert {box.track_id for box in frame.boxes} == {3, 7, 9}
    assert len(frame.points_lidar) > 2000
    swept = simulate_frame(small_scene(), 1, beam_model=COARSE).sweep
    np.testing.assert_allclose(frame.points_lidar, swept.points_lidar, atol=1e-5)


def test_pykitti_gives_the_exact_poses_back(folder):
    records = load_oxts_packets_and_poses([folder / "training/oxts/0000.txt"])
    expected = [small_scene().T_world_imu(0.1 * frame) for frame in range(3)]
    np.testing.assert_allclose([record.T_w_imu for record in records], expected, atol=1e-7)
    np.testing.assert_allclose(records[0].T_w_imu[:3, 3], 0.0, atol=1e-12)


def test_gps_records_hold_the_motion_in_all_its_axes(folder):
    scene, t = small_scene(), 0.2
    packet = load_oxts_packets_and_poses([folder / "training/oxts/0000.txt"])[2].packet
    velocity = (scene.T_world_imu(t + 1e-4) - scene.T_world_imu(t - 1e-4))[:3, 3] / 2e-4
    np.testing.assert_allclose([packet.ve, packet.vn, packet.vu], velocity, atol=1e-5)
    heading = np.array([np.cos(packet.yaw), np.sin(packet.yaw)])
    assert packet.vf == pytest.approx(velocity[:2] @ heading, abs=1e-5)
    assert packet.af == pytest.approx(scene.ego.drive.speed.acceleration(t), abs=0.05)
    assert packet.al == pytest.approx(packet.vf * packet.wu, abs=0.15)  # the pull of the bend
    assert packet.az == pytest.approx(9.81, abs=0.6)  # the springs
    assert packet.wu == pytest.approx(scene.ego.drive.curve.curvature(1.5) * packet.vf, rel=0.05)


def test_the_calibration_survives_writing_and_reading(folder):
    read = read_tracking_calib(folder / "training/calib/0000.txt")
    np.testing.assert_allclose(read.T_cam_lidar, writer.SIMULATED_CALIBRATION.T_cam_lidar, atol=1e-11)
    np.testing.assert_allclose(read.T_lidar_imu, writer.SIMULATED_CALIBRATION.T_lidar_imu, atol=1e-11)


@pytest.mark.parametrize("yaw", [-3.1, -1.6, -0.4, 0.0, 0.9, 1.6, 3.1])
def test_a_box_survives_kittis_camera_axes(tmp_path, yaw):
    size = np.array([4.0, 1.7, 1.5])
    box = Box(5, "Car", se3.from_yaw(yaw, np.array([15.0, -3.0, -0.9])), size, occlusion=0)
    calibration = writer.SIMULATED_CALIBRATION
    writer.write_whole(tmp_path / "labels.txt", writer.format_label(box, 4, calibration))
    (label,) = read_labels(tmp_path / "labels.txt")
    read = label.to_box(se3.invert(calibration.T_cam_lidar))
    assert (label.frame, read.track_id, read.class_name, read.occlusion) == (4, 5, "Car", 0)
    np.testing.assert_allclose(read.center_lidar, box.center_lidar, atol=1e-5)
    np.testing.assert_allclose(read.size, size)
    assert abs(np.angle(np.exp(1j * (read.yaw_lidar - yaw)))) < 1e-3


def test_image_boxes_tell_what_the_camera_sees():
    def columns(x, y):
        box = Box(0, "Car", se3.from_yaw(0.3, np.array([x, y, -0.9])), np.array([4.0, 1.7, 1.5]))
        words = writer.format_label(box, 0, writer.SIMULATED_CALIBRATION).split()
        return len(words), int(words[3]), [float(word) for word in words[6:10]]

    n_columns, truncation, (left, top, right, bottom) = columns(20.0, 0.0)
    assert (n_columns, truncation) == (17, 0)
    assert 400 < left < 610 < right < 800
    assert 100 < top < bottom < 300
    assert columns(7.0, 5.5)[1] == 1
    assert columns(-20.0, 0.0)[1:] == (2, [-1.0] * 4)
    assert columns(5.0, 30.0)[1:] == (2, [-1.0] * 4)


def test_times_are_written_as_kitti_writes_them():
    assert writer.format_time(0) == "2026-05-12 09:00:00.000000000\n"
    assert writer.format_time(3_725_000_000_007) == "2026-05-12 10:02:05.000000007\n"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{9}\n", writer.format_time(123456789))


# --- labels and truth


def test_labels_hold_nearly_all_points_of_their_objects():
    inside, total = defaultdict(int), defaultdict(int)
    for frame in (0, 33, 66):
        simulated = simulate_frame(STREET, frame, beam_model=COARSE)
        upright = []  # as a label file keeps them
        for box in simulated.boxes:
            upright.append(dataclasses.replace(box, T_lidar_obj=se3.from_yaw(box.yaw_lidar, box.center_lidar)))
        for box, rows in zip(simulated.boxes, points_in_boxes(simulated.sweep.points_lidar, upright), strict=True):
            own = simulated.sweep.object_index == [a.track_id for a in STREET.actors].index(box.track_id)
            inside[box.class_name] += int(own[rows].sum())
            total[box.class_name] += int(own.sum())
    assert min(total.values()) > 20
    for class_name, n_points in total.items():
        assert inside[class_name] >= 0.97 * n_points, class_name


def test_only_what_is_seen_and_near_gets_a_label():
    scene = small_scene()
    far = Standing(se3.from_yaw(0.0, np.array([-85.0, 0.0, GROUND_Z])))
    hidden = Standing(se3.from_yaw(0.5, np.array([50.0, 24.0, GROUND_Z])))
    body = scene.actors[0].body
    scene = dataclasses.replace(
        scene, actors=(*scene.actors, Actor(20, "Car", body, far), Actor(21, "Car", body, hidden))
    )
    fine = dataclasses.replace(HDL_64E, azimuth_step=np.deg2rad(0.4))
    simulated = simulate_frame(scene, 0, beam_model=fine)
    assert (simulated.sweep.object_index == 3).any(), "the far car is seen"
    assert not (simulated.sweep.object_index == 4).any(), "the one behind the wall is not"
    assert [box.track_id for box in simulated.boxes] == [3, 7, 9]


def test_truth_and_labels_tell_of_the_same_boxes(folder):
    truth, sequence = read_truth(folder), open_sequence(folder, "0000")
    labelled = {(frame, box.track_id): box for frame in range(3) for box in sequence.frame(frame, False).boxes}
    assert set(truth) == set(labelled)
    for at, box in labelled.items():
        row = truth[at]
        np.testing.assert_allclose(box.center_lidar, [row["x_lidar"], row["y_lidar"], row["z_lidar"]], atol=1e-3)
        assert abs(np.angle(np.exp(1j * (box.yaw_lidar - row["yaw_lidar"])))) < 1e-3
        center_world = se3.transform(sequence.frame(at[0], False).T_world_lidar, box.center_lidar[None])[0]
        np.testing.assert_allclose(center_world, [row["x_world"], row["y_world"], row["z_world"]], atol=1e-3)


def test_truth_is_the_trajectory_to_the_last_digit(folder):
    truth, scene = read_truth(folder), small_scene()
    for (frame, track_id), row in truth.items():
        actor = next(actor for actor in scene.actors if actor.track_id == track_id)
        T_world_obj = actor.T_world_obj(0.1 * frame)
        np.testing.assert_allclose([row["x_world"], row["y_world"]], T_world_obj[:2, 3], atol=1e-12)
        assert row["yaw_world"] == pytest.approx(se3.yaw(T_world_obj), abs=1e-12)
        half_height = row["z_world"] - GROUND_Z
        assert half_height == pytest.approx(0.5 * (actor.body.size[2] + 0.05), abs=1e-12)
    assert (folder / "training/truth/0000.csv").read_text().startswith(",".join(COLUMNS) + "\n")


def test_a_label_keeps_its_size_while_the_person_walks(folder):
    sizes = {tuple(b.size) for k in range(3) for b in open_sequence(folder, "0000").frame(k, False).boxes
             if b.class_name == "Pedestrian"}  # fmt: skip
    assert len(sizes) == 1


def test_the_ego_state_is_the_derivative_of_the_pose():
    scene, t, dt = small_scene(), 0.15, 0.01
    state, later = ego_state(scene, t), ego_state(scene, t + dt)
    step = (later.T_world_imu - state.T_world_imu)[:3, 3]
    np.testing.assert_allclose(step / dt, state.velocity_world + 0.5 * dt * state.acceleration_world, atol=2e-3)


# --- folders


def files_below(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_same_seed_writes_the_same_bytes_and_another_seed_other_scans(folder, tmp_path):
    again = simulate(small_scene(), tmp_path / "again", recording=AS_COARSE)
    other = simulate(small_scene(), tmp_path / "other", seed=1, recording=AS_COARSE)
    assert files_below(folder) == files_below(again)
    differing = {path.parts[1] for path, content in files_below(other).items()
                 if len(path.parts) > 1 and content != files_below(folder)[path]}  # fmt: skip
    assert differing == {"velodyne"}


def test_a_frame_does_not_depend_on_those_before_it():
    alone = simulate_frame(small_scene(), 2, seed=4, beam_model=COARSE).sweep
    simulate_frame(small_scene(), 1, seed=4, beam_model=COARSE)
    after = simulate_frame(small_scene(), 2, seed=4, beam_model=COARSE).sweep
    assert alone.points_lidar.tobytes() == after.points_lidar.tobytes()


def test_each_frame_has_noise_of_its_own():
    frozen = dataclasses.replace(small_scene(), period=0.0)
    first, second = (simulate_frame(frozen, frame, beam_model=COARSE).sweep for frame in (0, 1))
    assert abs(len(first.points_lidar) - len(second.points_lidar)) < 300
    assert first.points_lidar[:100].tobytes() != second.points_lidar[:100].tobytes()


def test_a_second_sequence_joins_the_first_and_a_new_run_replaces_the_old(folder, tmp_path):
    out = simulate(small_scene(), tmp_path / "out", recording=AS_COARSE)
    simulate(small_scene(2), out, sequence="0001", recording=AS_COARSE)
    simulate(small_scene(1), out, sequence="0000", recording=AS_COARSE)
    assert len(list((out / "training/velodyne/0000").iterdir())) == 1
    assert len(open_sequence(out, "0000")) == 1
    assert len(open_sequence(out, "0001")) == 2
    record = json.loads((out / "simulation.json").read_text())
    assert {name: entry["n_frames"] for name, entry in record["sequences"].items()} == {"0000": 1, "0001": 2}
    assert not list(out.rglob("*unfinished*"))


def test_an_interrupted_run_leaves_nothing_that_looks_like_a_sequence(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(small_scene(), tmp_path / "out", progress=stop, recording=AS_COARSE)
    assert not (tmp_path / "out/training").exists()
    simulate(small_scene(1), tmp_path / "out", recording=AS_COARSE)
    assert len(open_sequence(tmp_path / "out", "0000")) == 1


def test_progress_is_told_after_each_frame(tmp_path):
    told = []
    simulate(small_scene(2), tmp_path / "out", progress=lambda *counts: told.append(counts), recording=AS_COARSE)
    assert told == [(1, 2), (2, 2)]


def test_somebody_elses_folder_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(DataError, match="no simulation has written"):
        simulate(small_scene(1), tmp_path, recording=AS_COARSE)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_foreign_record_and_a_strange_name_are_refused(tmp_path):
    (tmp_path / "simulation.json").write_text('{"format": 99}')
    with pytest.raises(DataError, match="record of format 1"):
        simulate(small_scene(1), tmp_path, recording=AS_COARSE)
    with pytest.raises(InputError, match="letters and digits"):
        simulate(small_scene(1), tmp_path / "out", sequence="../0000", recording=AS_COARSE)


# --- how a scene is recorded


def test_with_a_rolling_shutter_labels_and_truth_are_where_the_beams_meet_things():
    scene = small_scene()
    simulated = simulate_frame(scene, 1, beam_model=COARSE, rolling_shutter=True)
    boxes = {box.track_id: box for box in simulated.boxes}
    met = dict(zip(boxes, simulated.box_times, strict=True))
    ahead, behind = boxes[3], boxes[7]
    assert met[3] == pytest.approx(0.1, abs=0.003)
    x, y, _ = behind.center_lidar
    # Clockwise from ahead: what is behind to the left comes before the head points forward.
    assert met[7] == pytest.approx(0.1 - 0.1 * np.arctan2(y, x) / (2 * np.pi), abs=1e-4)
    rows = points_in_boxes(simulated.sweep.points_lidar, [ahead, behind])
    for index, row in zip((0, 1), rows, strict=True):
        own = simulated.sweep.object_index == index
        assert own[row].sum() >= 0.95 * own.sum() > 5


def test_a_rolling_shutter_is_recorded_with_exact_world_truth(tmp_path):
    out = simulate(small_scene(2), tmp_path / "out", recording=Recording(COARSE, rolling_shutter=True))
    rows, scene = read_truth(out), small_scene(2)
    standing = scene.actors[1].T_world_obj(0.0)
    for frame in range(2):
        np.testing.assert_allclose([rows[frame, 7]["x_world"], rows[frame, 7]["y_world"]], standing[:2, 3], atol=1e-9)
    assert json.loads((out / "simulation.json").read_text())["sequences"]["0000"]["rolling_shutter"] is True


def test_jittered_labels_leave_scans_and_truth_as_they_are(folder, tmp_path):
    out = simulate(small_scene(), tmp_path / "out", recording=Recording(COARSE, box_jitter=BoxJitter()))
    exact = files_below(folder)
    differing = {str(path) for path, content in files_below(out).items() if content != exact[path]}
    assert differing == {"simulation.json", "training/label_02/0000.txt"}


def test_another_scene_of_the_same_name_does_not_go_on_with_what_one_left(tmp_path):
    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(small_scene(), tmp_path / "out", progress=stop, recording=AS_COARSE)
    scene = small_scene()
    fewer = dataclasses.replace(scene, actors=scene.actors[:2])
    told = []
    simulate(fewer, tmp_path / "out", progress=lambda *counts: told.append(counts), recording=AS_COARSE)
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert {box.track_id for box in open_sequence(tmp_path / "out", "0000").boxes_of(1)} == {3, 7}


def test_a_seed_below_zero_is_refused(tmp_path):
    with pytest.raises(InputError, match="seed >= 0"):
        simulate(small_scene(1), tmp_path / "out", seed=-1, recording=AS_COARSE)


def test_image_boxes_follow_the_camera_that_is_given(tmp_path):
    box = Box(0, "Car", se3.from_yaw(0.3, np.array([20.0, 0.0, -0.9])), np.array([4.0, 1.7, 1.5]))

    def width(focal):
        P = np.array([[focal, 0.0, 600.0, 0.0], [0.0, focal, 180.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
        words = writer.format_label(box, 0, writer.SIMULATED_CALIBRATION, P).split()
        return float(words[8]) - float(words[6])

    assert width(800.0) == pytest.approx(2.0 * width(400.0), rel=1e-6)
    path = tmp_path / "calib.txt"
    path.write_text(writer.format_calib(writer.SIMULATED_CALIBRATION))
    assert read_projection(path)[0, 0] == 720.0
    path.write_text("R0_rect: 1 0 0 0 1 0 0 0 1\n")
    assert read_projection(path) is None
