"""Triangle meshes with a material per triangle, and the primitives that everything else is made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.errors import SimulationError
from registration.types import Point, Transform


class Material(IntEnum):
    """What a triangle is made of; `SURFACES` says how it answers to a laser of 905 nm."""

    ASPHALT = 0
    MASONRY = 1
    PAINT_LIGHT = 2
    PAINT_SILVER = 3
    PAINT_DARK = 4
    GLASS = 5
    RUBBER = 6
    METAL = 7
    CLOTH = 8
    SKIN = 9
    FOLIAGE = 10


@dataclass(frozen=True, slots=True)
class Surface:
    """How a material answers to a laser pulse.

    Attributes:
        reflectivity: share of the light that comes back diffusely, hit head-on.
        loss: probability that a pulse passes through or is mirrored away, at any range and angle.
    """

    reflectivity: float
    loss: float = 0.0


SURFACES: dict[Material, Surface] = {
    Material.ASPHALT: Surface(0.22),
    Material.MASONRY: Surface(0.45),
    Material.PAINT_LIGHT: Surface(0.60, 0.01),
    Material.PAINT_SILVER: Surface(0.35, 0.02),
    Material.PAINT_DARK: Surface(0.10, 0.05),
    Material.GLASS: Surface(0.06, 0.88),
    Material.RUBBER: Surface(0.07, 0.02),
    Material.METAL: Surface(0.30, 0.05),
    Material.CLOTH: Surface(0.35),
    Material.SKIN: Surface(0.50),
    Material.FOLIAGE: Surface(0.50, 0.45),
}


@dataclass(frozen=True, slots=True)
class Mesh:
    """A triangle mesh in the axes of its object: x forward, y left, z up, origin on the ground below its centre.

    Attributes:
        vertices: corners (n, 3) [m].
        triangles: rows of `vertices` that make each triangle (m, 3).
        material: the `Material` of each triangle (m,).
    """

    vertices: Float64[np.ndarray, "n 3"]
    triangles: Int64[np.ndarray, "m 3"]
    material: Int64[np.ndarray, " m"]

    def __post_init__(self) -> None:
        if len(self.triangles) != len(self.material):
            raise SimulationError(
                f"a mesh needs one material a triangle, got {len(self.material)} for {len(self.triangles)}"
            )
        if self.triangles.size and not 0 <= self.triangles.min() <= self.triangles.max() < len(self.vertices):
            raise SimulationError(f"a triangle names a vertex outside 0..{len(self.vertices) - 1}")
        if not np.isfinite(self.vertices).all():
            raise SimulationError("a mesh must have finite vertices")

    @property
    def bounds(self) -> tuple[Point, Point]:
        """Lowest and highest corner of the box around the mesh, in its own axes [m]."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def moved(self, T_dst_obj: Transform) -> "Mesh":
        """Give the same mesh in another frame."""
        return Mesh(se3.transform(T_dst_obj, self.vertices), self.triangles, self.material)

    def shifted(self, offset: Point) -> "Mesh":
        """Move the mesh without turning it [m]."""
        return Mesh(self.vertices + offset, self.triangles, self.material)

    def stretched(self, factors: Point) -> "Mesh":
        """Scale the mesh about its origin, by its own factor along each axis."""
        return Mesh(self.vertices * factors, self.triangles, self.material)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Make one mesh of many that share a frame; none at all give the empty mesh."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64))
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh.material for mesh in meshes]),
    )


def normalised(mesh: Mesh, longest: float = 1.0) -> Mesh:
    """Centre a mesh's bounding box on the origin, and scale it so that its longest side is `longest` [m].

    The paper's text takes the centroid instead of the centre; what its authors released takes this, and so do we.

    Raises:
        SimulationError: the mesh has no extent.

    Source: AlignNet-3D (3DV 2019), section 4.
    """
    if len(mesh.vertices) == 0:
        raise SimulationError("an empty mesh cannot be normalised")
    lower, upper = mesh.bounds
    extent = float((upper - lower).max())
    if not extent > 0.0:
        raise SimulationError("a mesh of no extent cannot be normalised")
    return Mesh((mesh.vertices - 0.5 * (lower + upper)) * (longest / extent), mesh.triangles, mesh.material)


def loft(
    rings: Float64[np.ndarray, "k n 3"],
    material: Int64[np.ndarray, "bands n"] | int,
    cap_material: int | None = None,
) -> Mesh:
    """Stretch a skin over closed rings, and close both ends.

    Args:
        rings: k >= 2 rings of n points each, counter-clockwise seen from the last ring [m].
        material: of the quad behind point j of ring i, in row i of k - 1 and column j; or one for all.
        cap_material: of the two ends; that of the first quad when None.

    Raises:
        SimulationError: fewer than two rings, or of three points.
    """
    k, n = rings.shape[:2]
    if k < 2 or n < 3:
        raise SimulationError(f"a loft needs at least 2 rings of 3 points, got {k} of {n}")
    quads = np.broadcast_to(np.asarray(material, dtype=np.int64), (k - 1, n))
    here = np.arange((k - 1) * n).reshape(k - 1, n)
    beside = np.roll(here, -1, axis=1)
    sides = np.stack([here, beside, beside + n, here, beside + n, here + n], axis=-1).reshape(-1, 3)
    first, last = _fan(n), _fan(n)[:, ::-1] + (k - 1) * n
    cap = int(quads[0, 0]) if cap_material is None else cap_material
    return Mesh(
        rings.reshape(-1, 3),
        np.concatenate([sides, first[:, ::-1], last[:, ::-1]]),
        np.concatenate([np.repeat(quads.ravel(), 2), np.full(2 * len(first), cap)]),
    )


def _fan(n: int) -> Int64[np.ndarray, "m 3"]:
    """Cover a convex ring of n points with triangles that all meet in its first point."""
    return np.stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)


def box_mesh(size: Point, material: Material) -> Mesh:
    """Build a box of (length, width, height) that stands on the ground around the origin [m]."""
    x, y, height = 0.5 * size[0], 0.5 * size[1], size[2]
    ring = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return loft(np.stack([ring, ring + [0.0, 0.0, height]]), int(material))


def tube(
    centers: Float64[np.ndarray, "k 3"],
    radii: Float64[np.ndarray, "k 2"],
    material: Material,
    n_sides: int = 12,
) -> Mesh:
    """Build a round limb: elliptic rings about a polyline, all perpendicular to its chord.

    Args:
        centers: the polyline [m].
        radii: of each ring, along the two axes perpendicular to the chord: the one nearest to x, then y [m].
        material: of the whole skin.
        n_sides: corners of a ring.
    """
    chord = centers[-1] - centers[0]
    axis = chord / np.linalg.norm(chord)
    reference = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.8 else np.array([0.0, 0.0, 1.0])
    across = reference - (reference @ axis) * axis
    across /= np.linalg.norm(across)
    up = np.cross(axis, across)
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offsets = (radii[:, None, :] * circle) @ np.stack([across, up])
    return loft(centers[:, None, :] + offsets, int(material))


def cylinder(radius: float, height: float, material: Material, n_sides: int = 16) -> Mesh:
    """Build an upright cylinder that stands on the ground around the origin [m]."""
    return tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]]), np.full((2, 2), radius), material, n_sides)


def ellipsoid(center: Point, radii: Point, material: Material, n_sides: int = 12) -> Mesh:
    """Build an ellipsoid with its axes along x, y and z [m]."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, n_sides // 2 + 1)[:, None]
    heights = radii[2] * np.sin(latitude) * [0.0, 0.0, 1.0]
    # Rings of no size at the poles would make triangles without a normal.
    return tube(center + heights, np.maximum(np.cos(latitude), 1e-3) * radii[:2], material, n_sides)
