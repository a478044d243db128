"""Cars of the real sequence 0000 beside the same boxes ray-cast: points, noise, and what registration makes of them."""

import pytest

from evaluation.realism import compare_folders, table
from tracker.simulation import LabelPlay, simulate_labels

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def rows(kitti_root, tmp_path_factory):
    out = tmp_path_factory.mktemp("realism")
    simulate_labels(kitti_root, out / "simulated", ("0000",), LabelPlay(seed=0))
    sides = compare_folders(kitti_root, out / "simulated", "0000", ("Car", "Van"), out / "tracklets")
    return {(tuple(row["range_m"]), row["quantity"]): row for row in table(*sides)}


@pytest.mark.parametrize("bin_m", [(0.0, 10.0), (10.0, 20.0), (20.0, 40.0), (40.0, 80.0)])
def test_segments_have_as_many_points(rows, bin_m):
    assert 0.8 <= rows[bin_m, "points"]["ratio"] <= 1.2


@pytest.mark.parametrize("quantity", ["icp error [m/s]", "adh-3d error [m/s]"])
def test_registration_errs_as_much(rows, quantity):
    """Labels of the real side jitter, and so does its truth: the simulation stays a little below."""
    assert 0.7 <= rows[(0.0, 80.0), quantity]["ratio"] <= 1.3


def test_rings_are_as_rough(rows):
    assert 0.8 <= rows[(0.0, 80.0), "roughness [m]"]["ratio"] <= 1.2
