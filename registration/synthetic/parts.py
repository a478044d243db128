"""Parts that vehicles share: rounded shells, plates, wheels, and how a mesh is brought to size."""

import numpy as np
from jaxtyping import Float64

from registration.errors import SimulationError
from registration.synthetic.meshes import Material, Mesh, box_mesh, loft
from registration.types import Point

Span = tuple[float, float]  # from where to where [m]

_ARC = np.linspace(0.0, 0.5 * np.pi, 4)

# Paints of vehicles; silver and grey are the most usual.
PAINTS = (Material.PAINT_LIGHT, Material.PAINT_SILVER, Material.PAINT_SILVER, Material.PAINT_DARK)


def draw_paint(rng: np.random.Generator) -> Material:
    """Draw the paint of a vehicle."""
    return PAINTS[rng.integers(len(PAINTS))]


def shell(
    x: Float64[np.ndarray, " k"], sides: Float64[np.ndarray, "k 4"], material: Material, radius_x: float = 0.0
) -> Mesh:
    """Loft a hull over rounded rectangles that are upright and symmetrical.

    Args:
        x: where the rectangles are, ascending [m].
        sides: half width, lower edge, upper edge and corner radius of each [m].
        material: of the whole skin.
        radius_x: over which both ends are rounded too [m]; 0 for sharp edges.
    """
    if radius_x > 0.0:
        inset = radius_x * np.array([0.0, 0.1, 0.32, 0.65])
        shrink = 0.45 * radius_x * np.array([1.0, 0.55, 0.2, 0.04])[:, None] * [1.0, -1.0, 1.0, 0.0]
        x = np.concatenate([x[0] + inset, x[1:-1], x[-1] - inset[::-1]])
        sides = np.concatenate([sides[0] - shrink, sides[1:-1], sides[-1] - shrink[::-1]])
    half, low, high, corner = sides.T[:, :, None]
    corner = np.minimum(corner, 0.49 * np.minimum(2.0 * half, high - low))
    cos, sin = np.cos(_ARC), np.sin(_ARC)
    y = np.concatenate([half - corner + corner * sin, half - corner + corner * cos], axis=1)
    z = np.concatenate([low + corner - corner * cos, high - corner + corner * sin], axis=1)
    ring = np.stack([np.concatenate([y, -y[:, ::-1]], axis=1), np.concatenate([z, z[:, ::-1]], axis=1)], axis=-1)
    return loft(np.concatenate([np.broadcast_to(x[:, None, None], (*ring.shape[:2], 1)), ring], axis=-1), int(material))


def rounded_box(x: Span, y: Span, z: Span, material: Material, radius: float = 0.05) -> Mesh:
    """Build a box from where to where along each axis, its edges rounded [m]."""
    sides = np.tile([0.5 * (y[1] - y[0]), z[0], z[1], radius], (2, 1))
    return shell(np.array(x), sides, material, radius).shifted(np.array([0.0, 0.5 * (y[0] + y[1]), 0.0]))


def plate(x: Span, y: Span, z: Span, material: Material) -> Mesh:
    """Build a sharp box from where to where along each axis: a window, a board, a beam [m]."""
    size = np.array([x[1] - x[0], y[1] - y[0], z[1] - z[0]])
    return box_mesh(size, material).shifted(np.array([0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), z[0]]))


def both_sides(mesh: Mesh) -> list[Mesh]:
    """Give a part and its mirror image on the other side of the vehicle."""
    mirrored = Mesh(mesh.vertices * [1.0, -1.0, 1.0], mesh.triangles[:, ::-1].copy(), mesh.material)
    return [mesh, mirrored]


def wheel(radius: float, width: float, n_sides: int = 20) -> Mesh:
    """Build a wheel about the y axis, centred: a tyre, and a dished rim on either side."""
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    circle = np.column_stack([np.sin(angle), np.zeros(n_sides), np.cos(angle)])
    profile = [(0.15, 0.36), (0.64, 0.42), (0.66, 0.50), (0.93, 0.50), (1.0, 0.40)]
    profile += [(r, -half) for r, half in reversed(profile)]
    rings = np.stack([r * radius * circle - [0.0, half * width, 0.0] for r, half in profile])
    bands = np.array([Material.METAL] + 7 * [Material.RUBBER] + [Material.METAL], dtype=np.int64)
    return loft(rings, np.repeat(bands[:, None], n_sides, axis=1), int(Material.METAL))


def axle(x: float, half_width: float, radius: float, width: float) -> list[Mesh]:
    """Put a pair of wheels on the ground, their outer sides `half_width` from the middle [m]."""
    return both_sides(wheel(radius, width).shifted(np.array([x, half_width - 0.5 * width, radius])))


def hoop(center: Point, radius: float, thickness: float, material: Material, n_sides: int = 24) -> Mesh:
    """Build a ring about the y axis, as a bicycle's tyre; `radius` is its outer one [m]."""
    turn = 2.0 * np.pi * np.arange(n_sides) / n_sides
    section = 2.0 * np.pi * np.arange(6) / 6
    reach = radius - 0.5 * thickness * (1.0 - np.cos(section))
    y = np.broadcast_to(0.5 * thickness * np.sin(section), (n_sides, 6))
    vertices = np.stack([np.outer(np.sin(turn), reach), y, np.outer(np.cos(turn), reach)], axis=-1)
    here = np.arange(6 * n_sides).reshape(n_sides, 6)
    ahead, beside = np.roll(here, -1, axis=0), np.roll(here, -1, axis=1)
    both = np.roll(ahead, -1, axis=1)
    triangles = np.stack([here, ahead, both, here, both, beside], axis=-1).reshape(-1, 3)
    return Mesh(center + vertices.reshape(-1, 3), triangles, np.full(len(triangles), int(material)))


def fitted(mesh: Mesh, size: Point) -> Mesh:
    """Stretch a mesh to a bounding box of exactly this size, and stand it on the ground around the origin [m].

    Raises:
        SimulationError: the mesh is flat, or the size is not positive.
    """
    lower, upper = mesh.bounds
    if not (size > 0.0).all() or not (upper > lower).all():
        raise SimulationError(f"a body needs a length, width and height above 0 m, got {size.tolist()}")
    origin = np.array([*0.5 * (lower + upper)[:2], lower[2]])
    return mesh.shifted(-origin).stretched(size / (upper - lower))
