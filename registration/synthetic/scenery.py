"""What is around an object on the road: the ground under it, a neighbour beside it, something that hides part of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.bodies import Body, RigidBody, draw_body
from registration.synthetic.lidar import PlacedMesh
from registration.synthetic.meshes import Material, box_mesh, cylinder
from registration.synthetic.traffic import Sight, Traffic

SENSOR_HEIGHT = 1.73  # of KITTI's LiDAR [m]
LEVEL_WITHIN = 20.0  # nearer ground differs in height, not in slope [m]
# Share of an object's angular width that is hidden, by KITTI's level of occlusion: visible, partly, largely hidden.
HIDDEN = ((0.0, 0.0), (0.15, 0.5), (0.5, 0.85))
CREEP = 0.03  # standard deviation of the change of that share, a frame
NEAREST = 2.0  # distance of what hides from the sensor [m]

Vector2 = Float64[np.ndarray, "2"]
Size = Float64[np.ndarray, "3"]


class Ground(NamedTuple):
    """A plane.

    Attributes:
        height: below the sensor: z there [m].
        gradient: rise along x and y.
    """

    height: float
    gradient: Vector2

    def z(self, xy: Vector2) -> float:
        """Height at a place [m]."""
        return float(self.height + self.gradient @ xy)


class Neighbour(NamedTuple):
    """A body beside an object, that keeps its place there.

    Attributes:
        body: its shape.
        T_obj_neighbour: its pose in the axes of the object, both on the ground.
    """

    body: Body
    T_obj_neighbour: Float64[np.ndarray, "4 4"]


class Occluder(NamedTuple):
    """A body between the sensor and an object.

    Attributes:
        body: its shape.
        depth: its distance, as a share of the object's.
        side: 1 where it hides the object's left end, as the sensor sees it, -1 for the right.
        turn: its heading, from that of the object [rad].
    """

    body: Body
    depth: float
    side: float
    turn: float


def draw_ground(sight: Sight, statistics: Traffic, rng: np.random.Generator) -> Ground:
    """Draw the ground between the sensor and an object."""
    bottom = statistics.ground(sight.range_m, rng)
    slope = (bottom + SENSOR_HEIGHT) / max(sight.range_m, LEVEL_WITHIN)
    return Ground(bottom - slope * sight.range_m, slope * sight.xy / sight.range_m)


def ground_patch(ground: Ground, xy: Vector2, side: float) -> PlacedMesh:
    """Lay a piece of road around a place: all the ground that an object's box can hold.

    Args:
        ground: the plane.
        xy: its middle [m].
        side: its length and width [m].
    """
    thickness = 0.2
    slab = box_mesh(np.array([side, side, thickness]), Material.ASPHALT)
    normal = np.array([*(-ground.gradient), 1.0])
    normal /= np.linalg.norm(normal)
    forward = np.array([1.0, 0.0, ground.gradient[0]])
    forward /= np.linalg.norm(forward)
    R = np.stack([forward, np.cross(normal, forward), normal], axis=1)
    return PlacedMesh(slab, se3.pose(R, np.array([*xy, ground.z(xy)]) - thickness * normal))


def draw_neighbour(size: Size, statistics: Traffic, rng: np.random.Generator) -> Neighbour | None:
    """Draw who stands or goes beside an object of some size, if anybody."""
    place = statistics.beside(rng)
    if place is None:
        return None
    class_name, gap, direction = place
    body = draw_body(class_name, rng)
    heading = float(rng.normal(0.0, np.deg2rad(4.0)) + np.pi * rng.integers(2))
    along = direction < 2
    reach = 0.5 * (size[0 if along else 1] + body.size[0 if along else 1]) + gap
    offset = float(rng.uniform(-0.4, 0.4)) * size[1 if along else 0]
    sign = -1.0 if direction % 2 else 1.0
    xy = [sign * reach, offset] if along else [offset, sign * reach]
    return Neighbour(body, se3.from_yaw(heading, np.array([*xy, 0.0])))


def place_neighbour(neighbour: Neighbour, T_lidar_obj: Float64[np.ndarray, "4 4"], ground: Ground) -> PlacedMesh:
    """Put a neighbour beside an object that stands on the ground."""
    T_lidar_neighbour = T_lidar_obj @ neighbour.T_obj_neighbour
    T_lidar_neighbour[2, 3] = ground.z(T_lidar_neighbour[:2, 3])
    return PlacedMesh(neighbour.body.mesh(0.0), T_lidar_neighbour)


def draw_occluder(hidden: float, statistics: Traffic, rng: np.random.Generator) -> Occluder:
    """Draw what hides a share of an object's width: another road user, or a pole, a tree, a hedge, a wall."""
    class_name, depth = statistics.before(rng)
    body = _street_furniture(hidden, rng) if class_name is None else draw_body(class_name, rng)
    side = float(rng.choice([-1.0, 1.0]))
    return Occluder(body, depth, side, float(rng.normal(0.0, np.deg2rad(5.0)) + np.pi * rng.integers(2)))


def _street_furniture(hidden: float, rng: np.random.Generator) -> Body:
    if hidden < HIDDEN[1][1] and rng.uniform() < 0.5:
        return RigidBody(cylinder(float(rng.uniform(0.06, 0.35)), float(rng.uniform(2.5, 7.0)), Material.MASONRY))
    size = rng.uniform([0.8, 0.3, 0.7], [4.0, 1.2, 2.2])
    return RigidBody(box_mesh(size, Material.FOLIAGE if rng.uniform() < 0.6 else Material.MASONRY))


def draw_hidden_shares(levels: tuple[int, int], gap: int, rng: np.random.Generator) -> tuple[float, float]:
    """Draw how much of an object is hidden at two times, of its angular width, from KITTI's levels then.

    While the level stays, the share changes but slowly.
    """
    first, second = (float(rng.uniform(*HIDDEN[level])) for level in levels)
    step = CREEP * np.sqrt(gap) * rng.standard_normal()
    if levels[0] == levels[1]:
        second = float(np.clip(first + step, *HIDDEN[levels[1]]))
    return first, second


def place_occluder(occluder: Occluder, sight: Sight, size: Size, hidden: float, ground: Ground) -> PlacedMesh | None:
    """Put something between the sensor and an object so that it hides a share of the object's angular width.

    Args:
        occluder: what hides.
        sight: where the object is.
        size: of the object [m].
        hidden: the share; a body that is too narrow hides less.
        ground: what both stand on.

    Returns:
        None where there is no room between them.
    """
    own_size = occluder.body.size
    room = 0.5 * float(np.hypot(*size[:2]) + np.hypot(*own_size[:2])) + 0.2
    nearest = NEAREST + 0.5 * float(np.hypot(*own_size[:2]))
    if hidden <= 0.0 or sight.range_m - room < nearest:
        return None
    distance = float(np.clip(occluder.depth * sight.range_m, nearest, sight.range_m - room))
    low, high = _span(sight, size)
    bearing = sight.bearing
    for _ in range(3):  # its own angular width depends a little on where it is
        own_low, own_high = _span(Sight(distance, bearing, sight.yaw + occluder.turn), own_size)
        edge = hidden * (high - low)
        shift = high - edge - own_low if occluder.side > 0.0 else low + edge - own_high
        bearing = sight.bearing + shift
    xy = Sight(distance, bearing, 0.0).xy
    T_lidar_obj = se3.from_yaw(sight.yaw + occluder.turn, np.array([*xy, ground.z(xy)]))
    return PlacedMesh(occluder.body.mesh(0.0), T_lidar_obj)


def _span(sight: Sight, size: Size) -> tuple[float, float]:
    """Angular width of a box: its rightmost and leftmost corner, from the bearing of its centre [rad]."""
    signs = 0.5 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    relative = sight.yaw - sight.bearing  # in axes whose x is the line of sight
    c, s = np.cos(relative), np.sin(relative)
    corners = (signs * size[:2]) @ np.array([[c, s], [-s, c]]) + [sight.range_m, 0.0]
    angles = np.arctan2(corners[:, 1], corners[:, 0])
    return float(angles.min()), float(angles.max())
