"""The simulator from the command line: labels played again, pair sets, and how real it all is."""

import json

import pytest

from registration.pair_set import PairSet
from tests.command_line import regmot
from tests.kitti_folder import write_tracking


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Three frames of the tiny folder's labels, ray-cast."""
    folder = tmp_path_factory.mktemp("played")
    write_tracking(folder / "labelled", n_frames=3)
    regmot("simulate", "root", "--from-labels", "labelled", "--seed", 2, "--jobs", 1, cwd=folder)
    return folder


def test_labels_become_scans_with_exact_truth(played):
    names = sorted(path.name for path in (played / "root" / "training").iterdir())
    assert names == ["calib", "label_02", "times", "truth", "velodyne"]
    found = regmot(
        "compare", "root", "--frame", "sensor", "--truth", "exact", "--estimators", "centroid-kf,adh-3d",
        "--out", "out",
        cwd=played,
    )  # fmt: skip
    assert "truth: exact" in found.stderr
    rows = json.loads((played / "out" / "results.json").read_text())["rows"]
    assert {row["estimator"] for row in rows} == {"centroid-kf", "adh-3d"}


def test_there_is_no_world_where_only_labels_were(played):
    found = regmot("compare", "root", "--out", "world", cwd=played, code=1)
    assert "sensor frame" in found.stderr
    assert not (played / "world" / "results.json").exists()


def test_two_simulations_are_compared_as_a_real_one_would_be(played):
    regmot("simulate", "other", "--from-labels", "labelled", "--seed", 3, "--jobs", 1, cwd=played)
    regmot("realism", "root", "--simulated", "other", "--out", "realism", cwd=played)
    rows = json.loads((played / "realism" / "realism.json").read_text())["rows"]
    points = [row for row in rows if row["quantity"] == "points" and row["n"]]
    assert points
    assert all(0.7 < row["ratio"] < 1.4 for row in points)
    assert (played / "realism" / "realism.png").is_file()


@pytest.mark.parametrize("name", ["synth-cars", "kitti-like-cars"])
def test_a_generated_set_of_pairs_is_registered(name, tmp_path):
    regmot("pairs", name, "--out", "set", "--counts", "2,1,2", "--jobs", 1, "--seed", 5, cwd=tmp_path)
    assert [len(PairSet(tmp_path / "set").ids(part)) for part in ("train", "val", "test")] == [2, 1, 2]
    regmot("register", "set", "--methods", "centroid,icp", "--out", "out", cwd=tmp_path)
    rows = json.loads((tmp_path / "out" / "registration.json").read_text())["rows"]
    assert {row["n"] for row in rows if row["range_m"] == 80} <= {1, 2}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pairs", "synth-cars", "--out", "set", "--meshes", "none"], "none"),
        (["pairs", "kitti-tracklets-cars", "--out", "set"], "--root"),
        (["simulate", "new", "--from-labels", "nowhere"], "nowhere"),
        (["simulate", "new", "--beams", "hdl"], "hdl"),
    ],
)
def test_what_cannot_be_made_leaves_nothing(arguments, message, tmp_path):
    found = regmot(*arguments, cwd=tmp_path, code=2 if message == "--root" else 1)
    assert message in found.stderr
    assert not any(tmp_path.iterdir())
