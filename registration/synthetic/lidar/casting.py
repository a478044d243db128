"""Where rays meet surfaces first: each object is cast in its own axes, and the nearest hit of all objects counts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.synthetic.lidar.beams import Rays
from registration.synthetic.lidar.culling import RaysByAzimuth, bounds_of
from registration.synthetic.lidar.motion import Columns, Twist, carried
from registration.synthetic.lidar.solids import SOLIDS, Pencil
from registration.synthetic.meshes import Mesh
from registration.types import Transform


class PlacedMesh(NamedTuple):
    """A mesh somewhere before the sensor.

    Attributes:
        mesh: in its own axes; its arrays must not change once it has been scanned.
        T_lidar_obj: its pose at the reference time of the sweep, when the beams point forward.
        twist_lidar: its motion relative to the sensor during the sweep: (vx, vy, vz) of the point that
            is at the sensor's origin [m/s] and (wx, wy, wz) [rad/s], in the sensor's axes, so that its pose is
            T(t) = exp(t * twist) T_lidar_obj; None for one that stands still.
    """

    mesh: Mesh
    T_lidar_obj: Transform
    twist_lidar: Float64[np.ndarray, "6"] | None = None


@dataclass(frozen=True, slots=True)
class Hits:
    """Where rays meet surfaces first; range is infinite where they meet none.

    Attributes:
        range_m: from the start of the ray [m].
        cosine: between ray and surface normal, 0 flat to 1 head-on.
        material: of the surface; any where there is none.
        object_index: which of the objects it is; 0 where there is none.
        share: of the beam's light that makes this echo.
    """

    range_m: Float64[np.ndarray, " n"]
    cosine: Float64[np.ndarray, " n"]
    material: Int64[np.ndarray, " n"]
    object_index: Int64[np.ndarray, " n"]
    share: Float64[np.ndarray, " n"]


def cast(placed: Sequence[PlacedMesh], rays: Rays, max_range: float = np.inf) -> Hits:
    """Find the first surface on each ray.

    A moving object is met where it is when the ray is fired.  Only rays that can hit an object are cast against it.

    Args:
        placed: the objects.
        rays: in the sensor's frame.
        max_range: objects farther away than this at all times are left out [m].

    Raises:
        MissingLibraryError: Open3D cannot be imported.
    """
    n = len(rays.column)
    range_m, cosine = np.full(n, np.inf), np.zeros(n)
    material, object_index = np.zeros(n, np.int64), np.zeros(n, np.int64)
    lookup, still = RaysByAzimuth(rays), _StillRays(rays)
    times = float(rays.times.min(initial=0.0)), float(rays.times.max(initial=0.0))
    for index, (mesh, T_lidar_obj, twist_lidar) in enumerate(placed):
        if len(mesh.triangles) == 0:
            continue
        solid = SOLIDS.get(mesh)
        bounds = bounds_of((solid.lower, solid.upper), T_lidar_obj, twist_lidar, times, lookup.heights)
        chosen = lookup.within(bounds) if bounds.nearest <= max_range else np.zeros(0, np.int64)
        if len(chosen) == 0:
            continue
        T_middle_lidar = se3.invert(T_lidar_obj)
        T_middle_lidar[:3, 3] -= 0.5 * (solid.lower + solid.upper)
        met = solid.meet(still.seen_from(T_middle_lidar, twist_lidar, chosen))
        nearer = np.flatnonzero(met.distance < range_m.take(chosen))
        hit = chosen[nearer]
        range_m[hit], cosine[hit] = met.distance[nearer], met.cosine[nearer]
        material[hit], object_index[hit] = mesh.material[met.triangle[nearer]], index
    return Hits(range_m, cosine, material, object_index, np.ones(n))


class _StillRays:
    """Rays seen from the axes of objects, when each is fired."""

    def __init__(self, rays: Rays) -> None:
        self._rays = rays
        self._directions: Columns = np.ascontiguousarray(rays.directions.T)
        self._of_motion: dict[bytes, Float64[np.ndarray, "3 4 columns"]] = {}

    def seen_from(self, T_dst_lidar: Transform, twist_lidar: Twist | None, chosen: Int64[np.ndarray, " n"]) -> Pencil:
        """Give some rays in axes that are at T_dst_lidar at time 0, and move."""
        corners = np.einsum("ij,jkc->ikc", T_dst_lidar[:3, :3], self._sensor_corners(twist_lidar))
        corners[:, 0] += T_dst_lidar[:3, 3, None]
        corners[:, 1:] += T_dst_lidar[:3, 3, None, None] - corners[:, :1]
        if twist_lidar is not None:
            corners = corners.take(self._rays.column.take(chosen), axis=2)
        height, (x, y, z) = self._rays.height.take(chosen), (row.take(chosen) for row in self._directions)
        rays = np.empty((len(chosen), 6), dtype=np.float32)
        for k, (start, ahead, left, up) in enumerate(corners):
            rays[:, k] = start + height * up
            rays[:, 3 + k] = x * ahead + y * left + z * up
        return rays

    def _sensor_corners(self, twist_lidar: Twist | None) -> Float64[np.ndarray, "3 4 columns"]:
        """Place the sensor's origin and its unit points where an object of some motion takes it to be, by firing."""
        unit_points = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
        if twist_lidar is None:
            return unit_points[:, :, None]
        key = twist_lidar.tobytes()
        if key not in self._of_motion:
            n = len(self._rays.times)
            moved = carried(twist_lidar, np.tile(-self._rays.times, 4), np.repeat(unit_points, n, axis=1))
            self._of_motion[key] = moved.reshape(3, 4, n)
        return self._of_motion[key]
