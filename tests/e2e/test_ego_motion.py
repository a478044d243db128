"""Ego poses from the command line: estimated, refined, named in every result; and sweeps taken apart in time."""

import csv
import json

import numpy as np
import pytest

from evaluation.compare import CompareConfig, compare
from registration import se3
from tests.command_line import regmot
from tests.ego_world import PERIOD, Drive, clockwise_times, street
from tests.kitti_folder import Thing, calib_text, label_row, row_of, write

pytest.importorskip("kiss_icp")
N = 8
JITTER = 0.09  # 6 ms at 15 m/s, nearly [m]


def parked_cars():
    """Give the outlines of cars along both sides: (centre, points of three of their sides and roofs)."""
    rng = np.random.default_rng(0)
    cars = []
    for x in (8.0, 15.0, 22.0, 29.0):
        for y in (-5.5, 5.5):
            sides = rng.uniform([-2.0, -0.8, -0.7], [2.0, 0.8, 0.7], (900, 3))
            face = rng.integers(0, 3, len(sides))
            sides[face == 0, 1] = -0.8 * np.sign(y)
            sides[face == 1, 0] = np.where(rng.uniform(size=(face == 1).sum()) < 0.5, -2.0, 2.0)
            sides[face == 2, 2] = 0.7
            cars.append((np.array([x, y, -1.0]), sides))
    return cars


def write_street(root, drive, pose_jitter=0.0):
    """Write a street with parked cars as a sensor sees it from its way; poses may jitter."""
    training, world, cars = root / "training", street(seed=2, density=2.0), parked_cars()
    rng, labels, rows = np.random.default_rng(6), [], []
    for k in range(N):
        clouds = [drive.points(k, world), *(drive.points(k, center + points) for center, points in cars)]
        points = np.concatenate(clouds)
        columns = np.column_stack([points, np.zeros(len(points))]).astype("<f4")
        write(training / "velodyne" / "0000" / f"{k:06d}.bin", columns.tobytes())
        for track_id, (center, _) in enumerate(cars):
            time = np.array([PERIOD * k])
            for _ in range(4 * drive.rolling):
                time = PERIOD * k + clockwise_times(drive.look(center[None], time))
            place = drive.look(center[None], time)[0]
            thing = Thing(track_id, "Car", tuple(place), -drive.yaw_rate * float(time[0]), (4.6, 2.2, 1.7), 0)
            labels.append(label_row(k, thing))
        shift = np.array([pose_jitter * rng.standard_normal(), 0.0, 0.0])
        rows.append(f"{row_of((drive.pose(PERIOD * k) @ se3.from_yaw(0.0, shift))[:3])}\n")
    write(training / "label_02" / "0000.txt", "".join(labels))
    write(training / "calib" / "0000.txt", calib_text())
    write(training / "poses" / "0000.txt", "".join(rows))
    return root


@pytest.fixture(scope="module")
def jittery(tmp_path_factory):
    return write_street(tmp_path_factory.mktemp("jittery"), Drive(speed=15.0, yaw_rate=0.05), JITTER)


def errors_of(root, cache, **settings):
    """Give RMSE [m/s], and the mean velocity along the way on the right less that on the left."""
    config = CompareConfig(estimators=("adh-3d",), smoothing=("causal",), truth="smoothed", **settings)
    scored = compare(root, config, cache).scored[0]
    side = np.where(scored.track_id % 2, -1.0, 1.0)  # a sweep pulls the two sides opposite ways
    return float(np.sqrt((scored.velocity**2).sum(axis=1).mean())), float((side * scored.velocity[:, 0]).mean())


def test_refining_takes_the_jitter_of_the_records_out_of_parked_cars(jittery, tmp_path):
    calm = write_street(tmp_path / "calm", Drive(speed=15.0, yaw_rate=0.05))
    exact, _ = errors_of(calm, tmp_path / "a")
    rough, _ = errors_of(jittery, tmp_path / "b", ego="poses")
    refined, _ = errors_of(jittery, tmp_path / "c", ego="refined")
    assert rough > 3.0 * exact
    assert refined < 1.2 * exact


def test_deskewing_takes_the_sweep_out_of_parked_cars(tmp_path):
    root = write_street(tmp_path, Drive(speed=15.0, yaw_rate=0.05, rolling=True))
    _, as_they_are = errors_of(root, tmp_path / "a")
    _, at_one_instant = errors_of(root, tmp_path / "b", deskew=True)
    assert abs(as_they_are) > 0.15
    assert abs(at_one_instant) < 0.3 * abs(as_they_are)


def test_every_result_names_its_poses(jittery, tmp_path):
    given = ["--estimator", "centroid-kf", "--ego", "refined", "--deskew", "--out", "tracks"]
    regmot("track", jittery, *given, cwd=tmp_path)
    about = json.loads((tmp_path / "tracks" / "tracks.json").read_text())
    assert about["ego"] == {"0000": {"poses": "refined from poses", "flagged": []}}
    assert (about["config"]["ego"], about["config"]["deskew"]) == ("refined", True)
    with (tmp_path / "tracks" / "0000.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 8 * N
    assert len(list((tmp_path / "tracks" / "ego-motion").glob("*.npz"))) == 1

    given = ["--estimators", "centroid-kf", "--smoothing", "causal", "--ego", "refined-smooth:odometry", "--out", "out"]
    printed = regmot("compare", jittery, *given, cwd=tmp_path)
    assert "ego poses: refined and smoothed from odometry" in printed.stderr
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (found["ego"], found["deskew"]) == ("refined and smoothed from odometry", False)
    assert found["data"]["details"][0]["flagged_poses"] == []


def test_an_unknown_mode_is_one_line(jittery, tmp_path):
    found = regmot("track", jittery, "--ego", "gps", cwd=tmp_path, code=1)
    assert found.stderr.startswith("regmot: unknown ego poses 'gps'; expected one of auto")
    assert len(found.stderr.strip().splitlines()) == 1
