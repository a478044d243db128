"""The real sequence 0000 against the released C++ programs and the reference figures that lie beside the data."""

import csv

import numpy as np
import pytest

from evaluation import report
from evaluation.compare import CompareConfig, compare
from evaluation.register import RegisterConfig, register_pairs
from tracker.estimators import create_estimator
from tracker.kitti import open_sequence
from tracker.store import cut_sequence
from tracker.tracklets import of_classes

pytestmark = pytest.mark.real
CLASSES = ("Car", "Van")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("tracklets")


@pytest.mark.parametrize("frame", ["sensor", "world"])
def test_the_centroid_filter_equals_the_released_program_in_every_row(frame, kitti_root, reference, cache):
    path = reference / f"cpp_kf_{frame}_0000.csv"
    with path.open() as file:
        golden = {(int(row["track_id"]), int(row["frame"])): row for row in csv.DictReader(file)}
    estimator = create_estimator("centroid-kf")
    differences = []
    store = cut_sequence(open_sequence(kitti_root, "0000", clock="nominal"), cache / "nominal")
    for step in store.frames():
        pose = step.T_world_lidar if frame == "world" else None
        estimates = estimator.step(of_classes(step.segments, CLASSES), step.timestamp, pose)
        for track_id, estimate in estimates.items():
            if (row := golden.pop((track_id, step.index), None)) is not None:
                assert estimate.n_points == int(row["n_points"])
                differences.append(estimate.velocity - [float(row["vx"]), float(row["vy"])])
    assert len(differences) == 522
    assert not golden
    assert np.abs(differences).max() <= 1e-3


def test_icp_reaches_its_reference_row_on_the_521_pairs(kitti_root, cache):
    rows = register_pairs(kitti_root, RegisterConfig(sequences=("0000",)), cache)
    icp = {row["range_m"]: row for row in rows if row["method"] == "icp"}
    assert [icp[range_m]["n"] for range_m in (80, 20, 5)] == [521, 243, 9]
    assert icp[20]["rmse_t"] <= 0.05
    assert icp[20]["share_2cm_1deg"] >= 0.38


def test_the_centroid_filters_errors_are_those_of_the_reference_table(kitti_root, cache):
    config = CompareConfig(
        sequences=("0000",), estimators=("centroid-kf",), smoothing=("causal",), truth="smoothed", clock="nominal"
    )
    comparison = compare(kitti_root, config, cache / "nominal")
    rows = {row["range_m"]: row for row in report.rows(comparison)}
    assert rows[80]["n"] == 521
    assert rows[80]["rmse_velocity"] == pytest.approx(0.88, rel=0.05)
    assert rows[20]["rmse_velocity"] == pytest.approx(0.64, rel=0.05)
    assert comparison.sequences[0].n_tracks == 12
    assert comparison.sequences[0].n_parked == 10  # all but tracks 0 and 4


def test_icp_with_both_its_smoothings_beats_the_centroid_filter_and_its_covariance_holds(kitti_root, cache):
    comparison = compare(kitti_root, CompareConfig(sequences=("0000",)), cache)
    rows = {(r["estimator"], r["smoothing"], r["range_m"]): r for r in report.rows(comparison)}
    for range_m in (80, 20):
        for smoothing in ("window", "rts"):
            icp, kf = (rows[name, smoothing, range_m]["rmse_velocity"] for name in ("icp", "centroid-kf"))
            assert icp < kf
        # A covariance made on simulated streets must not be overconfident on real scans.
        assert rows["icp", "causal", range_m]["nees"] < 2.6
        assert rows["icp", "causal", range_m]["coverage_95"] > 0.92
