"""Meshes made ready for rays: Open3D's ray casting, closed form for plain boxes, and a store of those in use."""

import threading
from collections import OrderedDict
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, Int64

from registration.libraries import load_open3d
from registration.synthetic.meshes import Mesh
from registration.types import Point

Pencil = Float32[np.ndarray, "n 6"]  # rays: start [m] and unit vector, from the middle of the mesh's box


class Meeting(NamedTuple):
    """Where rays meet one mesh.

    Attributes:
        distance: along the ray; infinite where it misses [m].
        cosine: between ray and surface normal, 0 flat to 1 head-on.
        triangle: that is met; any where there is none.
    """

    distance: Float64[np.ndarray, " n"]
    cosine: Float64[np.ndarray, " n"]
    triangle: Int64[np.ndarray, " n"]


@runtime_checkable
class Solid(Protocol):
    """A mesh that is ready for rays."""

    lower: Point
    upper: Point

    def meet(self, rays: Pencil) -> Meeting:
        """Find where rays meet the mesh first; single precision is finest around the middle, so they start there."""


class MeshSolid:
    """Any mesh, by Open3D."""

    def __init__(self, mesh: Mesh) -> None:
        open3d = load_open3d("the LiDAR simulator")
        self.lower, self.upper = mesh.bounds
        self._tensor: Any = open3d.core.Tensor
        self._scene: Any = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor((mesh.vertices - 0.5 * (self.lower + self.upper)).astype(np.float32)),
            self._tensor(mesh.triangles.astype(np.uint32)),
        )

    def meet(self, rays: Pencil) -> Meeting:
        """Find where rays meet the mesh first."""
        answer = self._scene.cast_rays(self._tensor.from_numpy(rays))
        distance = answer["t_hit"].numpy().astype(np.float64)
        normals = answer["primitive_normals"].numpy()
        cosine = np.abs(sum(normals[:, k] * rays[:, 3 + k] for k in range(3)))
        # Rays that meet nothing name no triangle.
        triangle = np.where(np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), 0)
        return Meeting(distance, np.minimum(cosine, 1.0).astype(np.float64), triangle)


class BoxSolid:
    """A box along its axes and of one material, such as the slab of a ground: its six planes, in closed form."""

    def __init__(self, mesh: Mesh) -> None:
        self.lower, self.upper = mesh.bounds

    def meet(self, rays: Pencil) -> Meeting:
        """Find where rays enter the box, or leave it when they start inside."""
        n = len(rays)
        enter, leave = np.full(n, -np.inf), np.full(n, np.inf)
        enter_cosine, leave_cosine = np.zeros(n), np.zeros(n)
        for k in range(3):
            half = 0.5 * (self.upper[k] - self.lower[k])
            start, along = rays[:, k].astype(np.float64), rays[:, 3 + k].astype(np.float64)
            cosine = np.abs(along)
            along = np.where(cosine < 1e-12, 1e-12, along)  # a parallel ray meets these planes beyond all others
            middle, reach = -start / along, half / np.abs(along)
            enter_cosine = np.where(middle - reach > enter, cosine, enter_cosine)
            enter = np.maximum(enter, middle - reach)
            leave_cosine = np.where(middle + reach < leave, cosine, leave_cosine)
            leave = np.minimum(leave, middle + reach)
        is_outside = enter > 0.0
        is_hit = (enter <= leave) & (leave > 0.0)
        distance = np.where(is_hit, np.where(is_outside, enter, leave), np.inf)
        return Meeting(distance, np.where(is_outside, enter_cosine, leave_cosine), np.zeros(n, dtype=np.int64))


class SolidCache:
    """Meshes made ready, the most recently used ones first; what deforms with each frame falls out at the end."""

    def __init__(self, max_triangles: int) -> None:
        self._max_triangles = max_triangles
        self._n_triangles = 0
        # By identity; each entry holds its mesh, so that no other can have the same identity meanwhile.
        self._entries: OrderedDict[int, tuple[Mesh, Solid]] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._entries)

    def get(self, mesh: Mesh) -> Solid:
        """Make a mesh ready, or find it ready.

        Raises:
            MissingLibraryError: Open3D cannot be imported.
        """
        with self._lock:
            if id(mesh) not in self._entries:
                self._entries[id(mesh)] = mesh, solid(mesh)
                self._n_triangles += len(mesh.triangles)
            self._entries.move_to_end(id(mesh))
            ready = self._entries[id(mesh)][1]
            while self._n_triangles > self._max_triangles and len(self._entries) > 1:
                _, (dropped, _) = self._entries.popitem(last=False)
                self._n_triangles -= len(dropped.triangles)
            return ready


SOLIDS = SolidCache(max_triangles=1_000_000)


def solid(mesh: Mesh) -> Solid:
    """Make a mesh ready for rays.

    Raises:
        MissingLibraryError: Open3D cannot be imported.
    """
    return BoxSolid(mesh) if _is_box(mesh) else MeshSolid(mesh)


def _is_box(mesh: Mesh) -> bool:
    """Tell whether a mesh is its own bounding box: closed, and of one material."""
    if len(mesh.vertices) != 8 or len(mesh.triangles) != 12 or len(np.unique(mesh.material)) != 1:
        return False
    lower, upper = mesh.bounds
    is_upper = mesh.vertices == upper
    if not (is_upper | (mesh.vertices == lower)).all() or not (lower < upper).all():
        return False
    corner = is_upper @ np.array([1, 2, 4])
    # Twelve different triangles, each within one side, of two for each side, cover all sides when none overlaps:
    # the two of a side must share exactly a diagonal.
    sides: dict[tuple[int, bool], list[set[int]]] = {}
    for triangle in mesh.triangles:
        for k in range(3):
            if len(set(is_upper[triangle, k])) == 1:
                sides.setdefault((k, bool(is_upper[triangle[0], k])), []).append(set(corner[triangle].tolist()))
    return len(sides) == 6 and all(
        len(two) == 2 and len(two[0] & two[1]) == 2 and len(two[0] | two[1]) == 4 for two in sides.values()
    )
