"""How real simulated segments are: what is measured of a segment, and how two folders are compared."""

import numpy as np
import pytest

from evaluation.realism import AZIMUTH_STEP, Look, Side, look_at, table, write
from evaluation.realism_plots import draw


def ring(n, elevation, range_m=20.0, keep=None, noise=0.0, seed=0):
    """Look at a round wall: one ring of n returns, at the sensor's azimuth steps."""
    azimuth = 0.3 + AZIMUTH_STEP * np.arange(n)
    reach = range_m + noise * np.random.default_rng(seed).standard_normal(n)
    directions = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(n, np.sin(elevation)),
        ]
    )
    points = reach[:, None] * directions
    return points if keep is None else points[keep]


def test_rings_are_told_apart_by_their_azimuths():
    points = np.concatenate([ring(40, elevation) for elevation in (-0.01, -0.02, -0.03)])
    look = look_at(points, 20.0)
    assert (look.n_points, look.n_rings, look.missing) == (120, 3, 0.0)
    assert look.roughness < 1e-5  # the ring is round


def test_a_missing_return_is_a_hole_and_a_wide_gap_is_not():
    keep = np.ones(50, dtype=bool)
    keep[[10, 20, 21]] = False
    assert look_at(ring(50, 0.0, keep=keep), 20.0).missing == pytest.approx(3 / 49)
    keep[25:40] = False  # a window
    assert look_at(ring(50, 0.0, keep=keep), 20.0).missing == pytest.approx(3 / 33)


def test_roughness_is_the_noise_of_a_range_and_edges_do_not_count():
    smooth = ring(4000, 0.0, noise=0.02)
    assert look_at(smooth, 20.0).roughness == pytest.approx(0.02, rel=0.1)
    stepped = np.concatenate([smooth[:2000], ring(4000, 0.0, range_m=30.0, noise=0.02)[2000:]])
    assert look_at(stepped, 20.0).roughness == pytest.approx(0.02, rel=0.1)


def test_a_single_point_has_no_roughness():
    look = look_at(np.array([[5.0, 1.0, 0.0]]), 5.1)
    assert (look.n_points, look.n_rings, look.missing) == (1, 1, 0.0)
    assert np.isnan(look.roughness)


def test_a_ring_across_the_rear_is_one():
    turned = ring(40, 0.0) @ np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    back = np.arctan2(turned[:, 1], turned[:, 0])
    c, s = np.cos(np.pi - back[20]), np.sin(np.pi - back[20])
    across = turned @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    assert look_at(across, 20.0).n_rings == 1


def side(n_points, error):
    looks = {(1, k): Look(5.0 + 10.0 * k, n_points, 10, 0.1, 0.01) for k in range(3)}
    return Side(looks, {name: dict.fromkeys(looks, error) for name in ("icp", "adh-3d")})


def test_the_table_has_medians_of_both_and_their_ratio(tmp_path):
    rows = table(side(100, 0.2), side(120, 0.1))
    found = {(tuple(row["range_m"]), row["quantity"]): row for row in rows}
    near = found[(0.0, 10.0), "points"]
    assert (near["n"], near["real"], near["simulated"], near["ratio"]) == (1, 100.0, 120.0, pytest.approx(1.2))
    assert found[(0.0, 80.0), "adh-3d error [m/s]"]["ratio"] == pytest.approx(0.5)
    assert found[(0.0, 80.0), "points"]["n"] == 3
    assert found[(40.0, 80.0), "points"]["ratio"] is None
    assert write(rows, tmp_path, tmp_path, "0000", tmp_path).read_text().count('"quantity"') == len(rows)


def test_the_picture_is_drawn(tmp_path):
    assert draw(side(100, 0.2), side(120, 0.1), tmp_path).stat().st_size > 20_000
