"""What comes back: mixed echoes at edges, and noise that grows with range and slant."""

import dataclasses

import numpy as np
import pytest

from registration import se3
from registration.synthetic.lidar import HDL_64E, VLP_32C, BeamModel, PlacedMesh, fire, scan
from registration.synthetic.lidar.casting import Hits, cast
from registration.synthetic.lidar.echoes import edges, range_deviation, return_probability
from registration.synthetic.meshes import Material, box_mesh, merge

LINES = BeamModel("lines", HDL_64E.elevations, np.deg2rad(0.18), range_noise=0.0, misfire=0.0)
WIDE = dataclasses.replace(LINES, divergence=2e-3)


N_SWEEPS = 8  # that start anywhere within an azimuth step


def step(depth: float, material: Material = Material.MASONRY):
    """Place a wall 10 m ahead to the right, and another one `depth` behind it that goes on to the left."""
    near, far = (box_mesh(np.array([0.2, 8.0, 4.0]), paint) for paint in (material, Material.MASONRY))
    places = ((10.1, -4.0), (10.1 + depth, 2.0))
    return [
        PlacedMesh(mesh, se3.from_yaw(0.0, np.array([x, y, -2.0])))
        for mesh, (x, y) in zip((near, far), places, strict=True)
    ]


def depths(model: BeamModel, placed, seed: int = 0):
    """Scan, and give x and owner of the returns around the step: the walls are planes of constant x."""
    sweeps = [scan(placed, model, np.random.default_rng([seed, k])) for k in range(N_SWEEPS)]
    points, index = (np.concatenate([getattr(s, name) for s in sweeps]) for name in ("points_lidar", "object_index"))
    ahead = np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.1
    return points[ahead, 0], index[ahead]


def between(x, depth, margin=2e-3):
    return (x > 10.0 + margin) & (x < 10.0 + depth - margin)


def test_mixed_points_lie_between_two_near_surfaces():
    x, _ = depths(WIDE, step(0.4))
    n_mixed = between(x, 0.4).sum()
    # The walls fill 45 rings; the ring of samples crosses the edge from 2 * 0.75 mrad of a column's 3.1 mrad.
    assert n_mixed / (45 * N_SWEEPS) == pytest.approx(2 * 0.75 / 3.14, abs=0.25)
    assert x.min() > 10.0 - 1e-3
    assert x.max() < 10.4 + 1e-3


def test_surfaces_farther_apart_than_an_echo_give_one_or_the_other():
    x, index = depths(WIDE, step(3.0))
    assert not between(x, 3.0).any()
    assert set(index) == {0, 1}
    # The stronger echo wins: a dark edge before a bright wall loses beams that a bright edge keeps.
    bright, dark = (
        (depths(WIDE, step(3.0, paint))[1] == 0).sum() for paint in (Material.PAINT_LIGHT, Material.PAINT_DARK)
    )
    assert bright > dark


def test_beams_without_divergence_mix_nothing():
    x, _ = depths(LINES, step(0.4))
    assert len(x) > 1000
    assert not between(x, 0.4).any()


def test_a_narrower_beam_mixes_less():
    counts = [
        between(depths(dataclasses.replace(WIDE, divergence=angle), step(0.4))[0], 0.4).sum() for angle in (5e-4, 2e-3)
    ]
    assert counts[0] < counts[1]


def test_a_post_before_the_sky_looks_wider_but_not_from_the_side_of_its_range():
    post = [
        PlacedMesh(box_mesh(np.array([0.3, 0.3, 4.0]), Material.MASONRY), se3.from_yaw(0.0, np.array([15.0, 0, -2])))
    ]
    thin, wide = (scan(post, model, np.random.default_rng(0)) for model in (LINES, WIDE))
    assert 1.02 * len(thin.points_lidar) < len(wide.points_lidar) < 1.5 * len(thin.points_lidar)
    beyond = np.abs(wide.points_lidar[:, 1]) - 0.15
    assert 0.0 < beyond.max() < 1e-3 * 15.2
    assert np.abs(wide.points_lidar[:, 0] - 15.0).max() < 0.16


def test_planes_have_no_edges_however_slanted_and_steps_do():
    ground = [
        PlacedMesh(box_mesh(np.array([400.0, 400.0, 1.0]), Material.ASPHALT), se3.from_yaw(0.0, np.array([0, 0, -2.7])))
    ]
    for model in (WIDE, HDL_64E, VLP_32C):
        rays = fire(model)
        flat = edges(cast(ground, rays).range_m, model).reshape(model.n_beams, -1)
        horizon = np.abs(model.elevations) < np.deg2rad(1.05)
        assert not flat[~horizon].any()
        stepped = edges(cast([*ground, *step(1.0)], rays).range_m, model).reshape(model.n_beams, -1)
        azimuth = np.arctan2(rays.directions[:, 1], rays.directions[:, 0]).reshape(model.n_beams, -1)
        at_step = np.abs(azimuth) < 0.6 * model.azimuth_step
        on_walls = np.abs(np.tan(model.elevations)) * 10.0 < 1.4
        assert stepped[at_step & on_walls[:, None]].mean() > 0.8


def test_mixing_leaves_planes_where_they_are():
    wall = [
        PlacedMesh(box_mesh(np.array([0.2, 30.0, 8.0]), Material.MASONRY), se3.from_yaw(0.6, np.array([12.0, 0, -4])))
    ]
    sweeps = [scan(wall, model, np.random.default_rng(0)) for model in (LINES, WIDE)]
    normal = np.array([np.cos(0.6), np.sin(0.6)])
    offsets = [sweep.points_lidar[:, :2] @ normal - (12.0 * np.cos(0.6) - 0.1) for sweep in sweeps]
    inner = [offset[np.abs(offset) < 0.05] for offset in offsets]
    assert len(inner[1]) >= len(inner[0]) > 1000
    # Beams at the rims see one side of their footprint only.
    assert np.abs(inner[1]).max() < 0.02
    assert (np.abs(inner[1]) > 1e-3).mean() < 0.1


def hits_at(range_m, cosine, share=1.0, material=Material.MASONRY):
    return Hits(
        np.array([range_m]), np.array([cosine]), np.array([int(material)]), np.zeros(1, np.int64), np.array([share])
    )


def test_range_noise_grows_with_range_and_with_the_depth_of_the_footprint():
    model = dataclasses.replace(WIDE, range_noise=0.01, range_noise_growth=2e-4, slant_noise=0.1)
    assert range_deviation(hits_at(50.0, 1.0), model) == pytest.approx(0.01 + 0.01)
    # At 45 degrees the footprint is as deep as it is wide: 50 m * 2 mrad.
    assert range_deviation(hits_at(50.0, np.sqrt(0.5)), model) == pytest.approx(np.hypot(0.02, 0.1 * 0.1))
    # At a grazing angle no deeper than an echo is long.
    assert range_deviation(hits_at(50.0, 1e-3), model) == pytest.approx(np.hypot(0.02, 0.1 * 0.75))


def test_echoes_of_less_light_dark_glassy_or_far_surfaces_are_missed_more_often():
    full = return_probability(hits_at(80.0, 1.0), WIDE)
    assert full == pytest.approx(1.0, abs=1e-2)
    for weaker in (
        hits_at(200.0, 1.0), hits_at(80.0, 0.05), hits_at(80.0, 1.0, 1 / 7),
        hits_at(80.0, 1.0, 1.0, Material.RUBBER), hits_at(80.0, 1.0, 1.0, Material.GLASS),
    ):  # fmt: skip
        assert return_probability(weaker, WIDE) < full - 0.01
    seen = dataclasses.replace(WIDE, loss_scale=0.0, reach=np.inf, min_grazing=0.0)
    assert return_probability(hits_at(200.0, 1e-3, 1 / 7, Material.GLASS), seen) == pytest.approx(1.0)


def test_a_mixed_point_belongs_to_what_sends_back_most():
    walls = step(0.3)
    both = merge([item.mesh.moved(item.T_lidar_obj) for item in walls])
    x, index = depths(WIDE, walls)
    joined, _ = depths(WIDE, [PlacedMesh(both, np.eye(4))])
    np.testing.assert_allclose(np.sort(joined), np.sort(x), atol=1e-4)
    mixed = between(x, 0.3)
    assert set(index[mixed & (x < 10.1)]) <= {0}
    assert set(index[mixed & (x > 10.2)]) <= {1}
