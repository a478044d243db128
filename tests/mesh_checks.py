"""What any mesh of a road user must hold, measured."""

import numpy as np

from registration.libraries import load_open3d
from registration.synthetic.meshes import Mesh


def volume(mesh: Mesh) -> float:
    """Volume by the divergence theorem; right only if the skin is closed and all its triangles face outwards."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


def open_edges(mesh: Mesh) -> int:
    """Count directed edges that no neighbouring triangle runs through the other way."""
    edges = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    there = {tuple(edge) for edge in edges.tolist()}
    return sum((b, a) not in there for a, b in there)


def flat_triangles(mesh: Mesh) -> int:
    """Count triangles without an area; those around the pole of a small ellipsoid still have 1e-11 m^2."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return int((np.linalg.norm(normals, axis=1) < 1e-12).sum())


def rays_that_see_an_inside(mesh: Mesh, n: int = 60) -> tuple[int, int]:
    """Count, of parallel rays from eight sides and from above, how many hit, and how many hit a triangle's back."""
    lower, upper = mesh.bounds
    center, reach = 0.5 * (lower + upper), float(np.linalg.norm(upper - lower))
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.5, 0.5, n)]), axis=-1).reshape(-1, 2) * reach
    n_hits, n_backs = 0, 0
    for azimuth, elevation in [*((a, 0.15) for a in np.linspace(0.0, 2.0 * np.pi, 9)[:-1]), (0.3, 1.4)]:
        cos, sin = np.cos(elevation), np.sin(elevation)
        ahead = -np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), sin])
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        origins = center - reach * ahead + grid @ np.stack([right, np.cross(right, ahead)])
        triangles = first_triangles(mesh, origins, ahead)
        corners = mesh.vertices[mesh.triangles[triangles[triangles >= 0]]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        n_hits += len(normals)
        n_backs += int((normals @ ahead > 1e-3 * np.linalg.norm(normals, axis=1)).sum())
    return n_hits, n_backs


def first_triangles(mesh: Mesh, origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Tell which triangle each of some parallel rays meets first; -1 for none."""
    open3d = load_open3d("a test")
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)), open3d.core.Tensor(mesh.triangles.astype(np.uint32))
    )
    rays = np.hstack([origins, np.broadcast_to(direction, origins.shape)]).astype(np.float32)
    answer = scene.cast_rays(open3d.core.Tensor(rays))
    triangles = answer["primitive_ids"].numpy().astype(np.int64)
    return np.where(np.isfinite(answer["t_hit"].numpy()), triangles, -1)
