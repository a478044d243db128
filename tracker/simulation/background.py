"""What stands beside the street and never moves: houses with windows, kerbs, lamp posts, trees."""

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.meshes import Material, Mesh, box_mesh, cylinder, ellipsoid, loft, merge
from registration.types import Transform
from tracker.simulation.trajectories import Curve

KERB_RIGHT, KERB_LEFT = -4.50, 10.85  # offsets to the left of the street's line [m]
HOUSES_RIGHT, HOUSES_LEFT = -7.6, 13.9
POSTS_RIGHT, POSTS_LEFT = -4.90, 11.2
JUNCTION_HALF_WIDTH = 4.2  # of the side street [m]
KERB_HEIGHT, KERB_WIDTH = 0.12, 0.18  # [m]


def street_background(street: Curve, junction: float, ground_z: float, rng: np.random.Generator) -> Mesh:
    """Build everything that stands beside the street, on both sides, in the world.

    Args:
        street: the line of the ego car's lane.
        junction: where a side street crosses, along the line [m].
        ground_z: height of the ground [m].
        rng: source of the houses' and trees' sizes.
    """
    parts = []
    for side, (kerb, houses, posts) in enumerate(
        ((KERB_RIGHT, HOUSES_RIGHT, POSTS_RIGHT), (KERB_LEFT, HOUSES_LEFT, POSTS_LEFT))
    ):
        away = 2.0 * side - 1.0
        parts += _kerbs(street, junction, kerb)
        parts += _houses(street, junction, houses, away, rng)
        parts += _posts(street, junction, posts, rng)
    return merge(parts).moved(se3.from_yaw(0.0, np.array([0.0, 0.0, ground_z])))


def pose_beside(street: Curve, s: float, offset: float) -> Transform:
    """Stand at s, `offset` to the left of the street, facing along it."""
    yaw = street.yaw(s)
    x, y = street.position(s) + offset * np.array([-np.sin(yaw), np.cos(yaw)])
    return se3.from_yaw(yaw, np.array([x, y, 0.0]))


def _kerbs(street: Curve, junction: float, offset: float) -> list[Mesh]:
    """Lay a kerb before and one behind the junction."""
    gap = JUNCTION_HALF_WIDTH + 2.0
    ends = [(float(street.s[0]), junction - gap), (junction + gap, float(street.s[-1]))]
    return [_kerb(street, np.arange(start, end, 2.0), offset) for start, end in ends]


def _kerb(street: Curve, s: Float64[np.ndarray, " k"], offset: float) -> Mesh:
    return bar(street, s, offset, (0.0, KERB_HEIGHT, KERB_WIDTH), Material.MASONRY)


def bar(
    line: Curve, s: Float64[np.ndarray, " k"], offset: float, section: tuple[float, float, float], material: Material
) -> Mesh:
    """Stretch a bar along a line, `offset` to its left: a kerb, a wall, a rail.

    Args:
        line: what it follows.
        s: arc lengths of its corners, at least 2 [m].
        offset: of its middle [m].
        section: heights of its lower and upper edge, and its width [m].
        material: of all of it.
    """
    bottom, top, y = section[0], section[1], 0.5 * section[2]
    corners = np.array([[0.0, -y, bottom], [0.0, y, bottom], [0.0, y, top], [0.0, -y, top]])
    rings = np.stack([se3.transform(pose_beside(line, float(at), offset), corners) for at in s])
    return loft(rings, int(material))


def _houses(street: Curve, junction: float, offset: float, away: float, rng: np.random.Generator) -> list[Mesh]:
    """Build a row of houses whose fronts are at `offset`; `away` is +1 on the left and -1 on the right."""
    houses, s = [], float(street.s[0])
    while s < street.s[-1] - 18.0:
        length, height, setback = rng.uniform([9.0, 6.0, 0.0], [16.0, 14.0, 1.2])
        gap = float(rng.uniform(1.5, 4.0)) if rng.uniform() < 0.3 else 0.0
        before_junction = junction - JUNCTION_HALF_WIDTH - 1.5
        if s < before_junction < s + length:
            length = max(before_junction - s, 1.0)
        middle = s + 0.5 * length
        T_world_front = pose_beside(street, float(middle), offset + away * float(setback))
        turned = T_world_front if away > 0 else T_world_front @ se3.from_yaw(np.pi, np.zeros(3))
        houses.append(house(float(length), float(height)).moved(turned))
        s += float(length) + gap
        if before_junction - 1e-6 <= s < junction + JUNCTION_HALF_WIDTH + 1.5:
            s = junction + JUNCTION_HALF_WIDTH + 1.5
    return houses


def house(length: float, height: float, depth: float = 10.0) -> Mesh:
    """Build a house behind its front, which is the plane y = 0, looking towards -y."""
    walls = box_mesh(np.array([length, depth, height]), Material.MASONRY)
    walls = walls.moved(se3.from_yaw(0.0, np.array([0.0, 0.5 * depth, 0.0])))
    pane = box_mesh(np.array([1.1, 0.04, 1.4]), Material.GLASS)
    columns = np.arange(-0.5 * length + 1.6, 0.5 * length - 1.2, 2.6)
    rows = np.arange(1.0, height - 1.8, 3.0)
    panes = [pane.moved(se3.from_yaw(0.0, np.array([x, 0.0, z]))) for x in columns.tolist() for z in rows.tolist()]
    return merge([walls, *panes])


def _posts(street: Curve, junction: float, offset: float, rng: np.random.Generator) -> list[Mesh]:
    """Set lamp posts and trees along the kerb, in turn."""
    posts = []
    positions = np.arange(float(street.s[0]) + 3.0, float(street.s[-1]) - 3.0, 12.0)
    for i, s in enumerate(positions + rng.uniform(-2.0, 2.0, len(positions))):
        is_clear = abs(s - junction) > JUNCTION_HALF_WIDTH + 3.0
        post = tree(rng) if i % 2 else cylinder(0.08, 6.0, Material.METAL, n_sides=8)
        if is_clear:
            posts.append(post.moved(pose_beside(street, float(s), offset)))
    return posts


def tree(rng: np.random.Generator) -> Mesh:
    """Grow a small street tree."""
    radius, height = rng.uniform([1.0, 3.6], [1.6, 4.6])
    crown = ellipsoid(np.array([0.0, 0.0, height]), np.array([radius, radius, 1.2 * radius]), Material.FOLIAGE)
    return merge([cylinder(0.13, float(height), Material.MASONRY, n_sides=8), crown])
