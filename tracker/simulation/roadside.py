"""Things beside roads: guard rails, signs, gantries, hedges, posts; and rows of houses and trees."""

import numpy as np

from registration import se3
from registration.synthetic.meshes import Material, Mesh, box_mesh, cylinder, ellipsoid, merge
from tracker.simulation.background import bar, house, pose_beside, tree
from tracker.simulation.trajectories import Curve

__all__ = [
    "bar", "box_at", "bush", "gantry", "guard_rail", "hedge", "house", "houses_along", "place", "pose_beside", "post",
    "sign", "tall_tree", "traffic_light", "tree", "trees_along",
]  # fmt: skip


def place(mesh: Mesh, x: float, y: float, yaw: float = 0.0) -> Mesh:
    """Set something on the ground."""
    return mesh.moved(se3.from_yaw(yaw, np.array([x, y, 0.0])))


def box_at(line: Curve, s: float, offset: float, size: tuple[float, float, float], material: Material) -> Mesh:
    """Set a box of (length, width, height) [m] beside a line."""
    return box_mesh(np.array(size), material).moved(pose_beside(line, s, offset))


def post(height: float = 6.0) -> Mesh:
    """Build a lamp post."""
    return cylinder(0.08, height, Material.METAL, n_sides=8)


def traffic_light() -> Mesh:
    """Build a signal on its post, which looks towards -x."""
    lamp = box_mesh(np.array([0.25, 0.3, 0.9]), Material.METAL)
    return merge([cylinder(0.06, 3.4, Material.METAL, n_sides=8), _raised(lamp, 2.5)])


def sign(width: float, height: float, clearance: float) -> Mesh:
    """Build a sign on two posts, across the x axis [m]."""
    panel = _raised(box_mesh(np.array([0.06, width, height]), Material.PAINT_LIGHT), clearance)
    pole = cylinder(0.06, clearance + height, Material.METAL, n_sides=6)
    y = 0.42 * width
    return merge([panel, place(pole, 0.1, y), place(pole, 0.1, -y)])


def gantry(span: float, clearance: float = 5.6) -> Mesh:
    """Build a sign gantry across the x axis, `span` wide, with a panel above each lane [m]."""
    leg = box_mesh(np.array([0.35, 0.35, clearance + 1.2]), Material.METAL)
    beam = _raised(box_mesh(np.array([0.5, span, 0.7]), Material.METAL), clearance + 0.3)
    panel = _raised(box_mesh(np.array([0.1, 2.6, 2.0]), Material.PAINT_LIGHT), clearance - 0.1)
    lanes = [place(panel, -0.35, y) for y in np.arange(-0.5 * span + 3.0, 0.5 * span - 2.0, 3.6).tolist()]
    return merge([place(leg, 0.0, -0.5 * span), place(leg, 0.0, 0.5 * span), beam, *lanes])


def guard_rail(line: Curve, start: float, end: float, offset: float) -> list[Mesh]:
    """Build a rail on posts along a line, from start to end, `offset` to its left [m]."""
    rail = bar(line, np.linspace(start, end, max(int((end - start) / 8.0), 1) + 1), offset, (0.45, 0.76, 0.10),
               Material.METAL)  # fmt: skip
    stakes = [box_at(line, float(s), offset, (0.10, 0.06, 0.5), Material.METAL) for s in np.arange(start, end, 4.0)]
    return [rail, *stakes]


def hedge(length: float, width: float, height: float) -> Mesh:
    """Build a hedge along the x axis [m]."""
    return box_mesh(np.array([length, width, height]), Material.FOLIAGE)


def bush(rng: np.random.Generator, largest: float = 1.4) -> Mesh:
    """Grow a bush that stands on the ground, at most `largest` in radius [m]."""
    radius = float(rng.uniform(0.5, 1.0)) * largest
    return ellipsoid(np.array([0.0, 0.0, 0.7 * radius]), np.array([radius, radius, 0.8 * radius]), Material.FOLIAGE, 10)


def tall_tree(rng: np.random.Generator) -> Mesh:
    """Grow a tree whose crown is above everybody's head."""
    radius, height = rng.uniform([1.1, 4.4], [1.9, 6.0])
    crown = ellipsoid(np.array([0.0, 0.0, height]), np.array([radius, radius, 1.1 * radius]), Material.FOLIAGE)
    return merge([cylinder(0.14, float(height), Material.MASONRY, n_sides=8), crown])


def houses_along(line: Curve, ends: tuple[float, float], offset: float, rng: np.random.Generator) -> list[Mesh]:
    """Build houses along a line whose fronts look at it, from `offset` on to its left (or, negative, right) [m]."""
    s, row = ends[0], []
    while s < ends[1] - 8.0:
        length = min(float(rng.uniform(9.0, 17.0)), ends[1] - s)
        setback, height = rng.uniform([0.0, 5.5], [1.5, 13.0])
        away = np.sign(offset)
        T_site_front = pose_beside(line, s + 0.5 * length, offset + away * float(setback))
        turned = T_site_front if away > 0 else T_site_front @ se3.from_yaw(np.pi, np.zeros(3))
        row.append(house(length, float(height)).moved(turned))
        s += length + (float(rng.uniform(2.0, 7.0)) if rng.uniform() < 0.35 else 0.0)
    return row


def trees_along(line: Curve, ends: tuple[float, float], offset: float, rng: np.random.Generator) -> list[Mesh]:
    """Set street trees and lamp posts along a line, in turn, `offset` to its left [m]."""
    positions = np.arange(ends[0] + 3.0, ends[1] - 3.0, 13.0)
    things = [tall_tree(rng) if i % 2 else post() for i in range(len(positions))]
    places = positions + rng.uniform(-2.0, 2.0, len(positions))
    return [thing.moved(pose_beside(line, float(s), offset)) for thing, s in zip(things, places, strict=True)]


def _raised(mesh: Mesh, z: float) -> Mesh:
    return mesh.moved(se3.from_yaw(0.0, np.array([0.0, 0.0, z])))
