"""Labels played again: smooth motions, the ground under them, what hides them, and the folders that come out."""

import logging
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from evaluation.truth import true_velocities
from registration import se3
from registration.synthetic.lidar import HDL_64E, BeamModel, PlacedMesh, pose_after, scan
from registration.synthetic.meshes import Material, box_mesh
from tests import kitti_folder
from tracker.boxes import points_in_boxes
from tracker.errors import DataError, InputError, MissingDataError
from tracker.kitti import open_sequence
from tracker.kitti.truth import SENSOR_COLUMNS, read_truth
from tracker.simulation import LabelPlay, Recording, simulate_labels
from tracker.simulation.folder import time_passed
from tracker.simulation.jitter import BoxJitter, jittered
from tracker.simulation.occluders import azimuths, draw_hiding, occluders
from tracker.simulation.smoothed_tracks import smoothed_tracks, without_flips
from tracker.simulation.uneven_ground import fit_plane, ground_height, ground_mesh
from tracker.tracklets import cut
from tracker.types import Box

COARSE = BeamModel("coarse", HDL_64E.elevations, float(np.deg2rad(0.5)))
PLAY = LabelPlay(recording=Recording(COARSE, rolling_shutter=True))
TIMES = 0.1 * np.arange(40)


def box_at(x, y, yaw=0.0, bottom=-1.7, track_id=0, size=(4.0, 1.8, 1.5), **codes):
    size = np.array(size)
    return Box(track_id, "Car", se3.from_yaw(yaw, np.array([x, y, bottom + 0.5 * size[2]])), size, **codes)


def drive(n=20, noise=0.0, speed=8.0, seed=0):
    """Let a labelled car go round a bend."""
    rng = np.random.default_rng(seed)
    turn = 0.4 * TIMES[:n]
    x, y = speed / 0.4 * np.sin(turn) + 5.0, speed / 0.4 * (1.0 - np.cos(turn)) + 2.0
    x, y = x + noise * rng.normal(size=n), y + noise * rng.normal(size=n)
    return [[box_at(*at, occlusion=0)] for at in zip(x, y, turn, strict=True)]


# --- smooth motions


def test_smoothing_takes_away_most_of_the_jitter_and_leaves_the_motion():
    (true,), (noisy,) = smoothed_tracks(drive(40), TIMES), smoothed_tracks(drive(40, noise=0.05), TIMES)
    labels = np.array([boxes[0].center_lidar for boxes in drive(40, noise=0.05)])
    exact = np.array([boxes[0].center_lidar for boxes in drive(40)])
    np.testing.assert_allclose(true.stretches[0].centers_lidar, exact, atol=0.005)
    before, after = (labels - exact)[4:-4, :2], (noisy.stretches[0].centers_lidar - exact)[4:-4, :2]
    # The filter's weights have squares that sum to 0.255.
    assert after.std() == pytest.approx(np.sqrt(0.255) * before.std(), rel=0.3)


def test_the_twist_leads_from_one_pose_to_the_next():
    (track,) = smoothed_tracks(drive(), TIMES)
    stretch = track.stretches[0]
    moved = pose_after(stretch.twist(1.0), 0.02) @ stretch.pose(1.0)
    np.testing.assert_allclose(moved, stretch.pose(1.02), atol=1e-3)
    step = stretch.pose(1.02)[:3, 3] - stretch.pose(1.0)[:3, 3]
    assert np.linalg.norm(step) == pytest.approx(0.16, rel=0.02)


def test_what_passes_by_is_smooth_over_the_times_at_which_the_beams_met_it():
    """At 30 m/s and 4 m, looks are a tenth less than a frame apart."""
    velocity, frames, met = np.array([-30.0, 0.0]), [], []
    for k in range(15):
        late = 0.0
        for _ in range(6):
            x, y = np.array([25.0, 4.0]) + (TIMES[k] + late) * velocity
            late = time_passed(COARSE, np.array([x, y, 0.0]))
        frames.append([box_at(x, y, occlusion=0)])
        met.append(TIMES[k] + late)
    steps = np.diff([boxes[0].center_lidar[0] for boxes in frames])
    assert steps.min() < -2.95
    assert steps.max() > -2.75
    (track,) = smoothed_tracks(frames, TIMES, partial(time_passed, COARSE))
    stretch = track.stretches[0]
    np.testing.assert_allclose(stretch.times, met, atol=1e-3)
    np.testing.assert_allclose(stretch.centers_lidar[:, 0], [boxes[0].center_lidar[0] for boxes in frames], atol=0.02)
    for t in stretch.times:
        np.testing.assert_allclose(stretch.twist(t)[:2], velocity, atol=0.3)


def test_what_crosses_the_end_of_a_sweep_is_smooth_over_the_times_of_frames():
    frames = [[box_at(-10.0, 0.5 * k - 3.0, occlusion=0)] for k in range(12)]
    (track,) = smoothed_tracks(frames, TIMES, partial(time_passed, COARSE))
    np.testing.assert_array_equal(track.stretches[0].times, TIMES[:12])


def test_a_gap_makes_two_stretches_and_short_ones_are_left_as_they_are():
    frames = drive(12)
    frames[2] = frames[5] = []
    (track,) = smoothed_tracks(frames, TIMES)
    assert [(part.first, len(part.times)) for part in track.stretches] == [(0, 2), (3, 2), (6, 6)]
    np.testing.assert_array_equal(track.stretches[1].centers_lidar[0], frames[3][0].center_lidar)
    assert track.stretch(2) is None
    assert track.stretch(4) is track.stretches[1]


def test_a_single_label_stands_still():
    (track,) = smoothed_tracks([drive(1)[0]], TIMES)
    np.testing.assert_allclose(track.stretches[0].twist(0.0), 0.0)
    np.testing.assert_allclose(track.stretches[0].pose(5.0), drive(1)[0][0].T_lidar_obj)


def test_headings_that_point_backwards_for_a_while_are_turned_round():
    yaws = np.linspace(2.8, 3.6, 9)
    labels = yaws.copy()
    labels[[2, 3, 7]] += np.pi
    np.testing.assert_allclose(without_flips(np.angle(np.exp(1j * labels))), yaws, atol=1e-12)


def test_legs_go_no_faster_than_people_do():
    (track,) = smoothed_tracks(drive(11), TIMES)
    assert track.stretches[0].ways("Pedestrian")[-1] == pytest.approx(1.6)  # in 1 s, though the ego makes it 8 m
    assert track.stretches[0].ways("Car")[-1] == 0.0


# --- ground


def test_under_a_box_the_ground_is_at_its_bottom_and_far_away_on_the_plane():
    boxes = (box_at(10.0, 3.0, bottom=-1.5, track_id=1), box_at(30.0, -8.0, 1.0, bottom=-1.9, track_id=2))
    under = np.array([[10.0, 3.0], [11.9, 3.8], [30.0, -8.0]])
    np.testing.assert_allclose(ground_height(under, boxes, 1.73), [-1.5, -1.5, -1.9], atol=0.03)  # the plane leans
    assert ground_height(np.array([[0.0, -60.0]]), (), 1.73) == pytest.approx(-1.73)


def test_one_wrong_bottom_does_not_tilt_the_plane():
    x = np.linspace(5.0, 50.0, 10)
    bottoms = np.column_stack([x, np.zeros(10), -1.73 + 0.02 * x])
    bottoms[8, 2] += 3.0
    np.testing.assert_allclose(fit_plane(bottoms, 1.73), [0.02, 0.0, -1.73], atol=0.01)


def test_the_ground_cuts_through_nothing_that_stands_on_it():
    boxes = (box_at(8.0, 2.0, 0.4, -1.6, 1), box_at(8.5, 4.6, 0.4, -1.8, 2), box_at(20.0, 2.0, 2.0, -1.5, 3))
    ground = PlacedMesh(ground_mesh(boxes, 1.73), np.eye(4))
    bodies = [PlacedMesh(box_mesh(b.size, Material.METAL), b.T_lidar_obj @ down(b)) for b in boxes]
    sweep = scan(bodies, COARSE, np.random.default_rng(0), ground)
    low = sweep.points_lidar[sweep.object_index < 0]
    rows = points_in_boxes(low, [replace(b, size=b.size - [0.1, 0.1, 0.0]) for b in boxes])
    assert len(low) > 300
    for box, row in zip(boxes, rows, strict=True):
        assert (low[row][:, 2] < box.ground_z_lidar + 0.12).all()


def down(box):
    return se3.from_yaw(0.0, np.array([0.0, 0.0, -0.5 * box.size[2]]))


# --- occluders


@pytest.mark.parametrize("side", [1, -1])
def test_a_panel_hides_the_share_of_an_object_that_is_asked_for(side):
    box = box_at(20.0, 6.0, 0.3)
    ((mesh, T_lidar_panel),) = occluders(box, [box], (0.5, side))
    body = PlacedMesh(box_mesh(box.size, Material.PAINT_LIGHT), box.T_lidar_obj @ down(box))

    def seen(*more):
        sweep = scan([body, *more], replace(COARSE, azimuth_step=0.002), np.random.default_rng(0))
        return sweep.points_lidar[sweep.object_index == 0]

    all_points, rest = seen(), seen(PlacedMesh(mesh, T_lidar_panel))
    bearings = np.arctan2(rest[:, 1], rest[:, 0]) - np.arctan2(6.0, 20.0)
    low, high = azimuths(box, float(np.arctan2(6.0, 20.0)))
    assert 0.35 < len(rest) / len(all_points) < 0.65
    assert np.ptp(bearings) == pytest.approx(0.5 * (high - low), rel=0.1)
    assert side * np.mean(bearings) < 0.0, "what is left is on the other side"


def test_no_panel_where_others_hide_enough_or_nothing_is_hidden():
    box, before = box_at(20.0, 0.0), box_at(10.0, 0.0, 1.57, track_id=1)
    assert occluders(box, [box, before], (0.6, 1)) == []
    assert occluders(box, [box], (0.0, 1)) == []
    assert occluders(box_at(2.5, 0.0), [], (0.6, 1)) == [], "no room"


def test_a_track_is_hidden_as_its_labels_say_and_always_from_one_side():
    frames = [[box_at(10.0, 0.0, occlusion=2 if 10 <= k < 30 else 0)] for k in range(40)]
    (track,) = smoothed_tracks(frames, TIMES)
    hiding = draw_hiding(track, np.random.default_rng(0))
    assert hiding.at(2)[0] == 0.0
    assert hiding.at(20)[0] == pytest.approx(0.6, abs=0.101)
    steps = np.abs(np.diff([hiding.at(k)[0] for k in range(40)]))
    assert steps.max() < 0.3, "it comes and goes smoothly"
    assert hiding.at(99) == (0.0, hiding.side)


# --- jitter


def test_labels_jitter_as_much_as_asked_and_a_while_in_one_direction():
    jitter, box = BoxJitter(), box_at(10.0, 5.0, 0.7)
    labels = [jittered(replace(box, track_id=i), k, jitter, (5,)) for i in range(30) for k in range(100)]
    off = np.array([se3.transform(se3.invert(box.T_lidar_obj), b.center_lidar[None])[0] for b in labels])
    np.testing.assert_allclose(off.std(axis=0), [jitter.along, jitter.across, jitter.up], rtol=0.2)
    steps = np.diff(off.reshape(30, 100, 3), axis=1)
    np.testing.assert_allclose(steps.std(axis=(0, 1)), off.std(axis=0) * np.sqrt(2 * (1 - 0.92)), rtol=0.2)
    assert np.std([b.yaw_lidar for b in labels]) == pytest.approx(jitter.yaw, rel=0.2)
    sizes = np.array([b.size for b in labels]).reshape(30, 100, 3)
    assert np.ptp(sizes, axis=1).max() == 0.0, "a track keeps its size"
    assert (sizes[:, 0] - box.size).std() == pytest.approx(jitter.size, rel=0.3)


def test_jitter_does_not_depend_on_the_order_of_frames():
    box = box_at(10.0, 5.0)
    late = jittered(box, 200, BoxJitter(), (0,))
    early = jittered(box, 3, BoxJitter(), (0,))
    np.testing.assert_array_equal(late.T_lidar_obj, jittered(box, 200, BoxJitter(), (0,)).T_lidar_obj)
    assert not np.array_equal(early.T_lidar_obj, late.T_lidar_obj)


def test_a_jitter_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="0 <= correlation < 1"):
        BoxJitter(correlation=1.0)


# --- folders


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Give labels and calibration of three objects; no scans."""
    root = tmp_path_factory.mktemp("kitti")
    kitti_folder.write_tracking(root, n_frames=6, missing=tuple(range(6)))
    return root


@pytest.fixture(scope="module")
def played(root, tmp_path_factory):
    return simulate_labels(root, tmp_path_factory.mktemp("played") / "out", play=PLAY)


def files_below(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_folder_has_scans_labels_and_truth_and_no_ego_motion(root, played):
    pieces = sorted(path.name for path in (played / "training").iterdir())
    assert pieces == ["calib", "label_02", "times", "truth", "velodyne"]
    source = (root / "training/calib/0000.txt").read_bytes()
    assert (played / "training/calib/0000.txt").read_bytes() == source
    sequence = open_sequence(played, "0000")
    assert (len(sequence), sequence.ego, sequence.missing_scans()) == (6, "none", [])
    np.testing.assert_allclose(np.diff(sequence.timestamps), 0.1, atol=1e-9)


def test_the_same_objects_are_at_the_same_places_with_points_on_them(root, played):
    labels, again = open_sequence(root, "0000"), open_sequence(played, "0000")
    for k in range(6):
        frame = again.frame(k)
        boxes = {box.track_id: box for box in frame.boxes}
        assert set(boxes) == {box.track_id for box in labels.boxes_of(k)}
        for box in labels.boxes_of(k):
            np.testing.assert_allclose(boxes[box.track_id].center_lidar, box.center_lidar, atol=0.03)
            np.testing.assert_allclose(boxes[box.track_id].size, box.size, atol=1e-5)
            assert boxes[box.track_id].occlusion == box.occlusion
        segments = cut(frame).segments
        assert min(len(segment.points_lidar) for segment in segments.values()) >= 5


def test_truth_is_that_of_the_labelled_boxes_in_the_sensors_axes(played):
    path = played / "training/truth/0000.csv"
    assert path.read_text().startswith(",".join(SENSOR_COLUMNS) + "\n")
    truth, sequence = read_truth(path), open_sequence(played, "0000")
    boxes = {(box.track_id, k): box for k in range(6) for box in sequence.boxes_of(k)}
    assert set(truth) == set(boxes)
    for key, box in boxes.items():
        assert truth[key].center_world is None
        np.testing.assert_allclose(truth[key].center_lidar, box.center_lidar, atol=1e-4)


def test_exact_velocities_are_there_for_the_sensor_and_not_for_the_world(played):
    sequence = open_sequence(played, "0000")
    frames = [cut(sequence.frame(k, with_points=False)) for k in range(6)]
    exact = read_truth(sequence.truth_path)
    steps = true_velocities(frames, "sensor", "exact", exact)
    np.testing.assert_allclose(steps[0, 3].velocity, [10.0, 0.0], atol=0.01)  # 1 m a frame
    with_poses = [replace(frame, T_world_lidar=np.eye(4)) for frame in frames]
    with pytest.raises(MissingDataError, match="knows no world"):
        true_velocities(with_poses, "world", "exact", exact)


def test_the_same_seed_plays_the_same_whatever_the_number_of_processes(root, played, tmp_path):
    assert files_below(simulate_labels(root, tmp_path / "again", play=PLAY, n_jobs=2)) == files_below(played)
    other = files_below(simulate_labels(root, tmp_path / "other", play=replace(PLAY, seed=1)))
    differing = {path.parent.name for path, content in other.items() if content != files_below(played)[path]}
    assert differing == {"", "0000"}, "the record and the scans"


def test_jittered_labels_leave_scans_and_truth_as_they_are(root, played, tmp_path):
    play = replace(PLAY, recording=replace(PLAY.recording, box_jitter=BoxJitter()))
    other, exact = files_below(simulate_labels(root, tmp_path / "out", play=play)), files_below(played)
    differing = {str(path) for path, content in other.items() if content != exact[path]}
    assert differing == {"simulation.json", "training/label_02/0000.txt"}


def test_the_rolling_shutter_draws_points_of_moving_things_out(root, tmp_path):
    frozen = replace(PLAY, n_frames=1, recording=replace(PLAY.recording, rolling_shutter=False))
    rolling = replace(PLAY, n_frames=1)
    scans = [
        open_sequence(simulate_labels(root, tmp_path / str(i), play=play), "0000").frame(0).points_lidar
        for i, play in enumerate((frozen, rolling))
    ]
    assert abs(len(scans[0]) - len(scans[1])) < 0.1 * len(scans[0])
    assert not np.array_equal(scans[0], scans[1])


def test_unknown_classes_are_left_out_and_told(root, tmp_path, caplog):
    copy = tmp_path / "root"
    kitti_folder.write_tracking(copy, n_frames=2, missing=(0, 1))
    path = copy / "training/label_02/0000.txt"
    path.write_text(path.read_text().replace("Pedestrian", "Unicorn"))
    with caplog.at_level(logging.WARNING):
        out = simulate_labels(copy, tmp_path / "out", play=PLAY)
    assert "unknown classes: Unicorn" in caplog.text
    assert {box.class_name for box in open_sequence(out, "0000").boxes_of(0)} == {"Car"}


def test_times_of_the_source_are_kept(root, tmp_path):
    copy = tmp_path / "root"
    kitti_folder.write_tracking(copy, n_frames=3, missing=(0, 1, 2))
    stamps = "".join(f"{kitti_folder.stamp(k)}\n" for k in range(3))
    kitti_folder.write(copy / "training/times/0000.txt", stamps)
    out = simulate_labels(copy, tmp_path / "out", play=replace(PLAY, n_frames=2))
    assert (out / "training/times/0000.txt").read_text() == "".join(stamps.splitlines(keepends=True)[:2])
    assert len(open_sequence(out, "0000")) == 2


def test_what_cannot_be_played_is_refused_before_anything_is_written(root, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(MissingDataError, match="expected a KITTI tracking folder with label_02"):
        simulate_labels(tmp_path, out)
    with pytest.raises(InputError, match=r"no sequence '0001'.*Available: 0000"):
        simulate_labels(root, out, ["0001"])
    with pytest.raises(InputError, match="at least 1 frame"):
        LabelPlay(n_frames=0)
    with pytest.raises(InputError, match="seed >= 0"):
        LabelPlay(seed=-1)
    bad = tmp_path / "bad"
    kitti_folder.write_tracking(bad, n_frames=1, missing=(0,))
    path = bad / "training/label_02/0000.txt"
    path.write_text(path.read_text() + "1 0 Car 0 0\n")
    with pytest.raises(DataError, match=r"label_02/0000\.txt:4: expected 17 columns"):
        simulate_labels(bad, out)
    path.write_text(kitti_folder.dont_care_row(0))
    with pytest.raises(DataError, match=r"0000\.txt: expected labels of objects"):
        simulate_labels(bad, out)
    path.unlink()
    with pytest.raises(MissingDataError, match="expected a label file"):
        simulate_labels(bad, out)
    assert not out.exists()
    with pytest.raises(DataError, match="no simulation has written"):
        simulate_labels(root, root)
