"""Where rays meet surfaces: against a brute force that casts every ray on all objects at once."""

import numpy as np
import pytest

from registration import se3
from registration.libraries import load_open3d
from registration.synthetic.cars import HATCHBACK, SEDAN, VAN, car
from registration.synthetic.lidar import HDL_64E, BeamModel, PlacedMesh, Rays, fire, pose_after
from registration.synthetic.lidar.casting import cast
from registration.synthetic.lidar.culling import RaysByAzimuth
from registration.synthetic.lidar.solids import BoxSolid, MeshSolid, SolidCache, solid
from registration.synthetic.meshes import Material, Mesh, box_mesh, cylinder, merge

HEIGHTS = np.linspace(0.0, 0.25, 64)
RAYS = fire(BeamModel("coarse", HDL_64E.elevations, np.deg2rad(0.9), beam_heights=HEIGHTS), phase=0.003)
SHAPES = [car(SEDAN), car(HATCHBACK), car(VAN), cylinder(0.1, 4.0, Material.METAL)]


def brute_force(placed: list[PlacedMesh], rays: Rays, t: float = 0.0):
    """Cast all rays on one mesh of everything as it is at time t: ranges, and whose triangle it is."""
    poses = [T if twist is None else pose_after(twist, t) @ T for _, T, twist in placed]
    meshes = [item.mesh.moved(T) for item, T in zip(placed, poses, strict=True)]
    world = merge(meshes)
    open3d = load_open3d("a test")
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(world.vertices.astype(np.float32)), open3d.core.Tensor(world.triangles.astype(np.uint32))
    )
    starts = np.column_stack([np.zeros((len(rays.height), 2)), rays.height])
    pencil = np.concatenate([starts, rays.directions], axis=1).astype(np.float32)
    answer = scene.cast_rays(open3d.core.Tensor(pencil))
    owner = np.repeat(np.arange(len(placed)), [len(mesh.triangles) for mesh in meshes])
    range_m = answer["t_hit"].numpy().astype(np.float64)
    return range_m, owner[np.where(np.isfinite(range_m), answer["primitive_ids"].numpy(), 0)]


def crowd(rng: np.random.Generator, n: int = 25, is_moving: bool = False) -> list[PlacedMesh]:
    """Place things all around: near and far, at the back, overhead, around the sensor, upside down."""
    placed = []
    for _ in range(n):
        distance, bearing = rng.uniform(2.0, 60.0), rng.uniform(-np.pi, np.pi)
        center = np.array([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-3.0, 3.0)])
        T_lidar_obj = se3.from_yaw(rng.uniform(-np.pi, np.pi), center)
        twist = np.concatenate([rng.uniform(-40.0, 40.0, 3), rng.uniform(-2.0, 2.0, 3)]) if is_moving else None
        placed.append(PlacedMesh(SHAPES[rng.integers(len(SHAPES))], T_lidar_obj, twist))
    ring = merge([box_mesh(np.array([1.0, 1.0, 3.0]), Material.MASONRY).moved(se3.from_yaw(a, 30.0 * np.array(
        [np.cos(a), np.sin(a), 0.0]))) for a in np.arange(0.0, 6.0, 0.5)])  # fmt: skip
    tunnel = box_mesh(np.array([90.0, 70.0, 30.0]), Material.MASONRY)
    bridge = box_mesh(np.array([4.0, 30.0, 0.5]), Material.MASONRY)
    behind = box_mesh(np.array([0.5, 3.0, 3.0]), Material.MASONRY)
    ground = box_mesh(np.array([300.0, 300.0, 1.0]), Material.ASPHALT)
    places = [(ring, 0.0, -2.0), (tunnel, 0.0, -10.0), (bridge, 1.0, 0.4), (behind, -9.0, -1.5), (ground, 0.0, -2.8)]
    return placed + [PlacedMesh(mesh, se3.from_yaw(0.1, np.array([x, 0.0, z]))) for mesh, x, z in places]


@pytest.mark.parametrize("seed", range(3))
def test_rays_that_can_hit_find_what_casting_everything_on_everything_finds(seed):
    placed = crowd(np.random.default_rng(seed))
    hits = cast(placed, RAYS)
    range_m, owner = brute_force(placed, RAYS)
    np.testing.assert_array_equal(np.isfinite(hits.range_m), np.isfinite(range_m))
    # Single precision may pass a rim on either side: there, and only there, the two differ.
    agree = np.isclose(hits.range_m, range_m, atol=2e-4)
    assert (~agree).sum() <= 3
    assert (hits.object_index == owner)[agree].mean() > 0.9999
    assert len(set(hits.object_index)) > 12
    assert np.isinf(cast(placed[:3], RAYS).range_m).any()


@pytest.mark.parametrize("seed", range(3))
def test_moving_objects_are_met_where_they_are_when_each_ray_is_fired(seed):
    rng = np.random.default_rng(seed)
    placed = crowd(rng, n=40, is_moving=True)
    hits = cast(placed, RAYS)
    struck = np.unique(RAYS.column[np.isfinite(hits.range_m) & (hits.object_index < 40)])
    n_hit = 0
    for firing in struck[:: len(struck) // 10]:
        column, t = np.flatnonzero(RAYS.column == firing), RAYS.times[firing]
        alone = Rays(RAYS.directions[column], RAYS.height[column], np.zeros(64, dtype=np.int64), np.array([t]))
        range_m, owner = brute_force(placed, alone, t)
        agree = np.isclose(hits.range_m[column], range_m, atol=3e-4) | (
            np.isinf(range_m) & np.isinf(hits.range_m[column])
        )
        assert (~agree).sum() <= 1
        n_hit += (owner[agree] < 40).sum()
    assert n_hit > 40


@pytest.mark.parametrize("is_moving", [False, True])
def test_no_ray_that_hits_is_left_out(is_moving, monkeypatch):
    placed = crowd(np.random.default_rng(7), is_moving=is_moving)
    culled = cast(placed, RAYS)
    offered = []

    def everything(self, bounds):
        offered.append(bounds)
        return np.arange(len(RAYS.column))

    monkeypatch.setattr(RaysByAzimuth, "within", everything)
    full = cast(placed, RAYS)
    assert len(offered) == len(placed)
    np.testing.assert_array_equal(culled.range_m, full.range_m)
    np.testing.assert_array_equal(culled.object_index, full.object_index)
    np.testing.assert_array_equal(culled.cosine, full.cosine)


def test_only_rays_towards_an_object_are_cast_on_it(monkeypatch):
    n_cast = []
    meet = MeshSolid.meet
    monkeypatch.setattr(MeshSolid, "meet", lambda self, rays: n_cast.append(len(rays)) or meet(self, rays))
    cast([PlacedMesh(SHAPES[0], se3.from_yaw(0.3, np.array([-20.0, 0.5, -1.7])))], RAYS)
    assert 0 < n_cast[0] < 0.01 * len(RAYS.column)
    cast([PlacedMesh(SHAPES[0], se3.from_yaw(0.3, np.array([500.0, 0.0, -1.7])))], RAYS, max_range=120.0)
    assert len(n_cast) == 1


def test_nothing_and_empty_meshes_are_not_met():
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64))
    for placed in ([], [PlacedMesh(empty, np.eye(4))]):
        assert np.isinf(cast(placed, RAYS).range_m).all()


def test_materials_and_angles_of_incidence_are_those_of_the_triangle_met():
    box = box_mesh(np.array([2.0, 40.0, 6.0]), Material.GLASS)
    hits = cast([PlacedMesh(box, se3.from_yaw(0.0, np.array([11.0, 0.0, -3.0])))], RAYS)
    met = np.flatnonzero(np.isfinite(hits.range_m) & (np.abs(RAYS.directions[:, 2]) < 0.1))
    assert set(hits.material[met]) == {int(Material.GLASS)}
    front = met[np.abs(np.arctan2(RAYS.directions[met, 1], RAYS.directions[met, 0])) < 1.0]
    np.testing.assert_allclose(hits.cosine[front], RAYS.directions[front, 0], atol=1e-6)


def test_a_box_in_closed_form_is_met_where_its_triangles_are():
    box = box_mesh(np.array([4.0, 2.0, 1.5]), Material.MASONRY)
    rng = np.random.default_rng(0)
    starts = rng.uniform(-4.0, 4.0, (5000, 3))
    directions = rng.standard_normal((5000, 3))
    directions[:100, :2] = 0.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = np.concatenate([starts, directions], axis=1).astype(np.float32)
    closed, triangles = BoxSolid(box).meet(rays), MeshSolid(box).meet(rays)
    differ = ~np.isclose(closed.distance, triangles.distance, atol=1e-4)
    assert differ.sum() <= 2  # rays along an edge
    assert np.isfinite(closed.distance).sum() > 400
    met = np.isfinite(closed.distance) & ~differ
    np.testing.assert_allclose(closed.cosine[met], triangles.cosine[met], atol=1e-5)
    inside = (np.abs(starts) < [1.9, 0.9, 0.7]).all(axis=1)
    assert inside.sum() > 20
    assert np.isfinite(closed.distance[inside]).all()


def test_only_closed_boxes_of_one_material_are_taken_for_boxes():
    box = box_mesh(np.array([4.0, 2.0, 1.5]), Material.MASONRY)
    assert isinstance(solid(box), BoxSolid)
    doubled = box.triangles.copy()
    doubled[0] = doubled[1]  # a hole
    painted = box.material.copy()
    painted[3] = Material.GLASS
    skewed = box.vertices.copy()
    skewed[0, 0] -= 0.1
    others = [
        Mesh(box.vertices, doubled, box.material),
        Mesh(box.vertices, box.triangles, painted),
        Mesh(skewed, box.triangles, box.material),
        Mesh(box.vertices, box.triangles[1:], box.material[1:]),
        Mesh(box.vertices * [1.0, 1.0, 0.0], box.triangles, box.material),
        SHAPES[3],
    ]
    assert all(isinstance(solid(mesh), MeshSolid) for mesh in others)


def test_a_mesh_is_made_ready_once_and_deforming_ones_do_not_pile_up():
    cache = SolidCache(max_triangles=20 * len(SHAPES[3].triangles))
    rigid = cylinder(0.5, 2.0, Material.METAL)
    ready = cache.get(rigid)
    for k in range(200):
        cache.get(cylinder(0.1, 1.0 + 0.01 * k, Material.CLOTH))
        assert cache.get(rigid) is ready
    assert len(cache) <= 20
    for k in range(30):
        cache.get(cylinder(0.1, 1.0 + 0.01 * k, Material.CLOTH))
    assert cache.get(rigid) is not ready
    large = SolidCache(max_triangles=1)
    assert large.get(rigid) is large.get(rigid)
