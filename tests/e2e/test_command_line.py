"""The command line on a small simulated street: every command, its files, its exit codes."""

import csv
import json
import os
import shutil

import numpy as np
import pytest

from tests.command_line import regmot, regmot_process
from tests.kitti_folder import write_raw


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """Eight sweeps of the street, simulated once."""
    folder = tmp_path_factory.mktemp("street")
    regmot_process("simulate", "root", "--frames", 8, "--seed", 3, cwd=folder)
    return folder / "root"


@pytest.fixture(scope="module")
def compared(street, tmp_path_factory):
    """The comparison of the small street, made once; gives its folder and what was printed."""
    out = tmp_path_factory.mktemp("compared")
    return out, regmot_process("compare", street, "--out", out / "tables", cwd=out)


def test_simulate_writes_a_kitti_folder(street):
    names = sorted(path.name for path in (street / "training").iterdir())
    assert names == ["calib", "label_02", "oxts", "times", "truth", "velodyne"]
    assert len(list((street / "training" / "velodyne" / "0000").glob("*.bin"))) == 8


def test_compare_prints_a_row_an_estimator_smoothing_and_range(compared):
    _, printed = compared
    for estimator in ("centroid-kf", "icp"):
        for smoothing in ("causal", "window", "rts"):
            lines = [line for line in printed.stdout.splitlines() if estimator in line and smoothing in line]
            # each range in the table of errors; what a live user sees in that of use too, there with both classes
            more = 3 + 2 if smoothing == "causal" else 0
            assert len(lines) == 3 + more, (estimator, smoothing)
    assert "truth: exact" in printed.stderr
    assert "ego poses: oxts" in printed.stderr


def test_results_json_keeps_its_contract(compared):
    out, _ = compared
    found = json.loads((out / "tables" / "results.json").read_text())
    assert found["format"] == 1
    assert found["truth"] == "exact"
    assert found["data"]["sequences"] == ["0000"]
    assert found["data"]["classes"] == ["Car", "Van"]
    assert found["estimates"] == "estimates.csv"
    expected = {
        "estimator", "smoothing", "frame", "range_m", "n", "rmse_velocity", "rmse_speed", "median_velocity_error",
        "abstained", "ms_per_transform", "nees", "coverage_95", "p99_velocity_error", "n_parked", "false_motion",
        "n_tracks", "lost_tracks", "n_delays", "delay_s",
    }  # fmt: skip
    assert all(expected <= row.keys() for row in found["rows"])
    by_class = [row for row in found["classes"] if row["range_m"] == 80]
    assert {row["class_name"] for row in by_class} == {"Car", "Van"}
    assert all(0.0 <= row["coverage_95"] <= 1.0 < row["n"] for row in by_class)
    assert {row["n"] for row in found["rows"] if row["range_m"] == 80} == {found["rows"][0]["n"]}


def test_estimates_csv_redoes_the_table(compared):
    out, _ = compared
    found = json.loads((out / "tables" / "results.json").read_text())
    with (out / "tables" / "estimates.csv").open() as file:
        estimates = list(csv.DictReader(file))
    for row in found["rows"]:
        mine = [
            e
            for e in estimates
            if (e["estimator"], e["smoothing"]) == (row["estimator"], row["smoothing"])
            and float(e["range_m"]) < row["range_m"]
        ]
        assert len(mine) == row["n"]
        errors = [[float(e["vx"]) - float(e["vx_true"]), float(e["vy"]) - float(e["vy_true"])] for e in mine]
        if mine:
            assert np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) == pytest.approx(row["rmse_velocity"], abs=1e-4)
            assert sum(e["status"] != "converged" for e in mine) == row["abstained"]


def test_compare_draws_its_pictures(compared):
    out, printed = compared
    for name in ("error_against_range", "speed_0000", "birds_eye_0000"):
        path = out / "tables" / f"{name}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert str(path) in printed.stderr


def test_a_second_run_reuses_the_cut_segments_and_gives_the_same_figures(street, compared):
    out, _ = compared
    parts = {path: path.stat().st_mtime_ns for path in (out / "tables").rglob("part-*.npz")}
    before = json.loads((out / "tables" / "results.json").read_text())
    regmot_process("compare", street, "--out", out / "tables", cwd=out)
    after = json.loads((out / "tables" / "results.json").read_text())
    assert parts
    assert parts == {path: path.stat().st_mtime_ns for path in (out / "tables").rglob("part-*.npz")}
    for a, b in zip(before["rows"], after["rows"], strict=True):
        assert {**a, "ms_per_transform": 0} == {**b, "ms_per_transform": 0}


def test_registration_beats_the_centroid_filter_near_by(compared):
    out, _ = compared
    rows = json.loads((out / "tables" / "results.json").read_text())["rows"]
    median = {
        row["estimator"]: row["median_velocity_error"]
        for row in rows
        if row["smoothing"] == "causal" and row["range_m"] == 20
    }
    assert median["icp"] < 0.6 * median["centroid-kf"]


def test_the_sensor_frame_and_a_split_can_be_asked_for(street, tmp_path):
    options = ["--frame", "sensor", "--estimators", "centroid-kf", "--smoothing", "causal", "--split", "sequence-train"]
    regmot("compare", street, *options, "--truth", "labels", "--out", tmp_path / "out", cwd=tmp_path)
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {row["frame"] for row in found["rows"]} == {"sensor"}
    assert found["truth"] == "labels"
    assert found["data"]["split"] == "sequence-train"


def test_track_writes_a_csv_of_velocities(street, tmp_path):
    regmot("track", street, "--estimator", "centroid-kf", "--classes", "Car,Van,Pedestrian", cwd=tmp_path)
    with (tmp_path / "tracks" / "0000.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["class_name"] for row in rows} == {"Car", "Van", "Pedestrian"}
    assert {row["status"] for row in rows if row["age"] == "1"} == {"new-track"}
    last = [row for row in rows if row["frame"] == "7" and row["status"] == "converged"]
    assert all(abs(float(row["speed"]) - np.hypot(float(row["vx"]), float(row["vy"]))) < 1e-4 for row in last)


def test_register_writes_the_registration_table(street, tmp_path):
    printed = regmot("register", street, "--out", tmp_path / "out", cwd=tmp_path)
    rows = json.loads((tmp_path / "out" / "registration.json").read_text())["rows"]
    assert [row["method"] for row in rows] == ["centroid"] * 3 + ["icp"] * 3
    assert rows[4]["share_10cm_5deg"] > rows[1]["share_10cm_5deg"]
    assert "10 cm/5 deg" in printed.stdout


def test_demo_ends_with_a_table_and_pictures(tmp_path):
    printed = regmot_process("demo", "--frames", 4, "--out", "demo", cwd=tmp_path)
    for name in ("centroid-kf", "adh-3d", "icp", "alignnet"):
        lines = [line for line in printed.stdout.splitlines() if line.startswith(f"│ {name} ")]
        assert len([line for line in lines if "window" in line or "rts" in line]) == 2 * 3
        assert len([line for line in lines if "causal" in line]) > 3, "errors, and how far they can be relied on"
    for line in printed.stderr.splitlines():
        if line.startswith("picture: "):
            assert (tmp_path / line.removeprefix("picture: ")).is_file()
    assert len(list((tmp_path / "demo").glob("*.png"))) == 3


def test_benchmark_shows_both_contestants(tmp_path):
    options = ["--methods", "centroid,icp,adh-3d", "--estimators", "none", "--no-growth"]
    regmot_process("benchmark", *options, "--out", "timings.json", cwd=tmp_path)
    timings = json.loads((tmp_path / "timings.json").read_text())["timings"]
    whats = [timing["what"] for timing in timings]
    assert whats == [f"{name}: a transform" for name in ("centroid", "icp", "adh-3d")]
    assert all(timing["ours_ms"] > 0.0 and timing["peer_ms"] > 0.0 for timing in timings)


def test_benchmark_times_estimators_beside_open3d_on_the_data_given(street, tmp_path):
    options = ["--methods", "centroid", "--estimators", "adh-3d,centroid-kf", "--no-growth"]
    printed = regmot_process("benchmark", street, *options, "--out", "timings.json", cwd=tmp_path)
    found = json.loads((tmp_path / "timings.json").read_text())
    rows = found["estimators"]["rows"]
    assert [row["what"] for row in rows] == ["adh-3d", "centroid-kf", "Open3D point-to-point ICP"]
    assert {row["n_frames"] for row in rows} == {8 - 5}
    assert all(row["what"] in printed.stdout for row in rows)
    assert found["root"] == str(street)


@pytest.mark.parametrize(
    "command", ["demo", "simulate", "compare", "track", "pairs", "register", "methods", "splits", "benchmark"]
)
def test_every_command_helps_with_an_example_to_paste(command, tmp_path):
    assert f"Example: regmot {command}" in regmot(command, "--help", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare", "nowhere"], "nowhere: no such folder"),
        (["compare", "STREET", "--estimators", "icq"], "no estimator 'icq'. Did you mean 'icp'?"),
        (["compare", "STREET", "--sequence", "0007"], "no sequence '0007'"),
        (
            ["compare", "STREET", "--smoothing", "median"],
            "unknown smoothing 'median'; expected one of causal",
        ),
        (["compare", "STREET", "--frame", "moon"], "unknown frame 'moon'; expected one of world, sensor"),
        (["compare", "STREET", "--truth", "guess"], "unknown truth 'guess'"),
        (["compare", "STREET", "--window", "-1"], "window must be 0 or more frames, got -1"),
        (["compare", "STREET", "--range", "-5"], "ranges must be positive"),
        (["compare", "STREET", "--classes", "Tram"], "no Tram in the labels; they hold Car, Pedestrian, Van"),
        (["track", "STREET", "--estimator", "icq"], "no estimator 'icq'"),
        (["register", "STREET", "--methods", "icq"], "no registration method 'icq'"),
        (["compare", "STREET", "--estimators", "icp,icp"], "estimators has icp twice"),
        (["compare", "STREET", "--sequence", "0000", "--sequence", "0000"], "sequences has 0000 twice"),
        (["compare", "STREET", "--range", "inf"], "ranges must be positive and finite [m], got inf"),
        (["track", "STREET", "--classes", "car"], "no car in the labels"),
        (["register", "STREET", "--methods", ""], "methods is empty"),
        (["benchmark", "STREET", "--estimators", "icq"], "no estimator 'icq'"),
        (["benchmark", "STREET", "--classes", "Tram"], "no Tram in the labels; they hold Car, Pedestrian, Van"),
        (["simulate", "new", "--scene", "moon"], "no scene 'moon'"),
        (["simulate", "STREET/training"], "holds something that no simulation has written"),
    ],
)
def test_our_errors_are_one_line_and_exit_code_1(street, arguments, message, tmp_path):
    found = regmot(*(a.replace("STREET", str(street)) for a in arguments), cwd=tmp_path, code=1)
    *_, last = found.stderr.strip().splitlines()
    assert last.startswith("regmot: ")
    assert message in last
    assert not list(tmp_path.rglob("results.json")) + list(tmp_path.rglob("simulation.json"))  # nothing half-written


@pytest.mark.parametrize(
    ("arguments", "code", "last"),
    [
        (["compare", "nowhere"], 1, "regmot: nowhere: no such folder"),
        (["compare", "x", "--window", "wide"], 2, ""),
        (["compare", "--help"], 0, ""),
    ],
)
def test_a_process_ends_with_the_same_codes_and_without_a_traceback(arguments, code, last, tmp_path):
    found = regmot_process(*arguments, cwd=tmp_path, code=code)
    assert "Traceback" not in found.stderr
    assert last in found.stderr
    assert list(tmp_path.iterdir()) == []


def test_brackets_in_a_path_are_no_markup(street, tmp_path):
    options = ["--estimators", "centroid-kf", "--smoothing", "causal", "--out", "o[red] [/b]"]
    found = regmot("compare", street, *options, cwd=tmp_path)
    assert "o[red] [/b]/results.json" in found.stderr
    assert (tmp_path / "o[red] [/b]" / "results.json").is_file()


def test_ranges_without_a_step_give_a_table_of_dashes_and_no_picture_of_nothing(street, tmp_path):
    regmot("compare", street, "--estimators", "centroid-kf", "--range", "0.5", "--out", "out", cwd=tmp_path)
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert {row["n"] for row in rows} == {0}
    assert {row["rmse_velocity"] for row in rows} == {None}
    assert not (tmp_path / "out" / "error_against_range.png").exists()


@pytest.mark.parametrize("arguments", [["compare"], ["compare", "x", "--window", "wide"], ["nonsense"]])
def test_wrong_usage_is_exit_code_2(arguments, tmp_path):
    regmot(*arguments, cwd=tmp_path, code=2)


def test_a_scan_cut_off_mid_point_ends_the_run_with_its_name(street, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(street, copy)
    scan = copy / "training" / "velodyne" / "0000" / "000005.bin"
    os.truncate(scan, scan.stat().st_size - 7)
    found = regmot("compare", copy, "--out", tmp_path / "out", cwd=tmp_path, code=1)
    assert "000005.bin: expected a multiple of 16 bytes" in found.stderr
    assert not (tmp_path / "out" / "results.json").exists()
    regmot("track", copy, "--out", tmp_path / "tracks", cwd=tmp_path, code=1)
    assert list((tmp_path / "tracks").iterdir()) == []
    regmot("pairs", "kitti-tracklets-cars", "--root", copy, "--out", tmp_path / "set", cwd=tmp_path, code=1)
    assert not list(tmp_path.glob("set*"))


def test_a_missing_scan_is_reported_and_skipped(street, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(street, copy)
    (copy / "training" / "velodyne" / "0000" / "000004.bin").unlink()
    options = ["--estimators", "centroid-kf", "--smoothing", "causal", "--out", tmp_path / "out"]
    found = regmot("compare", copy, *options, cwd=tmp_path)
    assert "frames whose scan is missing, skipped: 1" in found.stderr
    with (tmp_path / "out" / "estimates.csv").open() as file:
        frames = {int(row["frame"]) for row in csv.DictReader(file)}
    assert frames == {1, 2, 3, 6, 7}  # neither the missing frame nor the step after it


def test_pairs_are_written_and_registered_from_disk(street, tmp_path):
    regmot("pairs", "kitti-tracklets-cars", "--root", street, "--out", "set", cwd=tmp_path)
    about = json.loads((tmp_path / "set" / "about.json").read_text())
    assert about["simulation"]["0000"]["seed"] >= 0  # nobody takes these scans for real ones
    printed = regmot("register", "set", "--part", "train", "--methods", "icp", cwd=tmp_path)
    rows = json.loads((tmp_path / "out" / "registration.json").read_text())["rows"]
    assert rows[0]["n"] == len(list((tmp_path / "set" / "meta").iterdir()))
    assert "icp" in printed.stdout
    again = regmot("pairs", "kitti-tracklets-cars", "--root", street, "--out", "set", cwd=tmp_path, code=1)
    assert "holds something already" in again.stderr


def test_a_raw_drive_runs_end_to_end_and_skips_its_missing_scans(tmp_path):
    day = write_raw(tmp_path / "raw", n_frames=9, missing=(4,)).parent
    options = ["--estimators", "centroid-kf", "--smoothing", "causal", "--truth", "labels", "--out", tmp_path / "out"]
    found = regmot("compare", day, *options, cwd=tmp_path)
    assert "ego poses: oxts" in found.stderr
    assert "frames whose scan is missing, skipped: 1" in found.stderr
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert rows[0]["n"] > 0
    regmot("track", day, "--classes", "Car,Van,Pedestrian", "--out", tmp_path / "tracks", cwd=tmp_path)
    assert len(list((tmp_path / "tracks").glob("*_sync.csv"))) == 1
