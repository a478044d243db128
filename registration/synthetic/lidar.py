"""The LiDAR that looks at meshes: a beam model, and one sweep of it ray-cast over a set of objects."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import se3
from registration.errors import SimulationError
from registration.libraries import load_open3d
from registration.synthetic.meshes import SURFACES, Material, Mesh, box_mesh, merge
from registration.types import Points, Transform


class PlacedMesh(NamedTuple):
    """A mesh somewhere before the sensor.

    Attributes:
        mesh: in its own axes.
        T_lidar_obj: its pose at the reference time of the sweep, when the beams point forward.
        twist_lidar: its motion relative to the sensor during the sweep: (vx, vy, vz) of the point that
            is at the sensor's origin [m/s] and (wx, wy, wz) [rad/s], in the sensor's axes, so that its pose is
            T(t) = exp(t * twist) T_lidar_obj; None for one that stands still.
    """

    mesh: Mesh
    T_lidar_obj: Transform
    twist_lidar: Float64[np.ndarray, "6"] | None = None


GROUND = -1  # the object index of ground returns

_REFLECTIVITY = np.array([SURFACES[material].reflectivity for material in Material])
_LOSS = np.array([SURFACES[material].loss for material in Material])


@dataclass(frozen=True, slots=True)
class BeamModel:
    """A spinning LiDAR whose beams all start in one point.

    A return is lost by chance: always with `misfire`; the more, the flatter the beam hits (`min_grazing`);
    the more, the weaker the echo is, which falls with range, slant and dark surfaces (`reach`); and as the
    material says (glass).

    Attributes:
        name: as tables print it.
        elevations: angle of each beam above the horizon [rad].
        azimuth_step: turn between two firings [rad].
        height: of the sensor above the ground, where a scene does not say otherwise [m].
        min_range: nothing nearer is returned [m].
        max_range: nor farther [m].
        range_noise: standard deviation of a range [m].
        reach: range at which half of the echoes of a white surface hit head-on get lost [m].
        min_grazing: angle between beam and surface below which returns thin out [rad].
        misfire: share of pulses lost for no reason.
        intensity_noise: standard deviation of an intensity, relative.
    """

    name: str
    elevations: Float64[np.ndarray, " beams"]
    azimuth_step: float
    height: float = 1.73
    min_range: float = 0.9
    max_range: float = 120.0
    range_noise: float = 0.017
    reach: float = 320.0
    min_grazing: float = float(np.deg2rad(1.5))
    misfire: float = 0.01
    intensity_noise: float = 0.08

    def __post_init__(self) -> None:
        if len(self.elevations) == 0 or not 0.0 < self.azimuth_step <= np.pi:
            raise SimulationError("a beam model needs at least one beam and 0 < azimuth_step <= pi")
        if not 0.0 <= self.min_range < self.max_range:
            raise SimulationError("a beam model needs 0 <= min_range < max_range")

    @property
    def n_azimuths(self) -> int:
        """Number of firings in a full turn."""
        return round(2.0 * np.pi / self.azimuth_step)


# Velodyne HDL-64E at 10 Hz: an upper block of 32 lasers every 1/3 degree, a lower block every 1/2 degree.
HDL_64E = BeamModel(
    name="HDL-64E",
    elevations=np.deg2rad(np.concatenate([2.0 - np.arange(32) / 3.0, -8.83 - 0.5 * np.arange(32)])),
    azimuth_step=float(np.deg2rad(0.1728)),
)


@dataclass(frozen=True, slots=True)
class Sweep:
    """What one turn of the sensor returned, beam by beam from the first elevation to the last.

    Attributes:
        points_lidar: the returns (n, 3) [m].
        intensity: strength of each echo, corrected for range, in [0, 1].
        object_index: which of the scanned objects each return comes from; GROUND (-1) for the ground.
    """

    points_lidar: Points
    intensity: Float64[np.ndarray, " n"]
    object_index: Int64[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class _Hits:
    """Where rays meet surfaces first; range is infinite where they meet none."""

    range_m: Float64[np.ndarray, " rays"]
    cosine: Float64[np.ndarray, " rays"]  # between ray and surface normal, 0 flat to 1 head-on
    material: Int64[np.ndarray, " rays"]
    object_index: Int64[np.ndarray, " rays"]


def level_ground(beam_model: BeamModel) -> PlacedMesh:
    """Lay asphalt under a level sensor, as far as it sees."""
    size = np.array([4.0, 4.0, 1.0]) * [beam_model.max_range, beam_model.max_range, 1.0]
    slab = box_mesh(size, Material.ASPHALT)
    return PlacedMesh(slab, se3.from_yaw(0.0, np.array([0.0, 0.0, -beam_model.height - 1.0])))


def scan(
    objects: Sequence[PlacedMesh],
    beam_model: BeamModel,
    rng: np.random.Generator,
    ground: PlacedMesh | None = None,
) -> Sweep:
    """Ray-cast one sweep over objects: each beam returns from the first surface it meets, or not at all.

    The sweep is instantaneous: nothing moves while the sensor turns.  The turn starts at a random fraction of an
    azimuth step, as a free-running sensor does.  The random numbers are drawn per ray, before any is cast, so that
    a return keeps its noise whatever else is in the scene, and a seed gives the same bits on any number of threads.

    Args:
        objects: meshes and their poses in the sensor's frame (x forward, y left, z up).
        beam_model: the sensor.
        rng: source of the noise and of the lost returns.
        ground: what counts as ground, for example `level_ground(beam_model)`; None for empty space.

    Raises:
        MissingLibraryError: Open3D cannot be imported.
    """
    directions = ray_directions(beam_model, phase=rng.uniform(0.0, beam_model.azimuth_step))
    noise = rng.standard_normal((2, len(directions)))
    luck = rng.uniform(size=len(directions))
    placed = list(objects) if ground is None else [*objects, ground]
    hits = _cast(placed, directions)
    range_m = hits.range_m + beam_model.range_noise * noise[0]
    in_reach = (beam_model.min_range <= range_m) & (range_m <= beam_model.max_range)
    kept = np.flatnonzero(in_reach & (luck < _return_probability(hits, beam_model)))
    brightness = _REFLECTIVITY[hits.material] * (0.3 + 0.7 * hits.cosine)
    intensity = brightness * (1.0 + beam_model.intensity_noise * noise[1])
    index = np.where(hits.object_index < len(objects), hits.object_index, GROUND)
    return Sweep(directions[kept] * range_m[kept, None], np.clip(intensity[kept], 0.0, 1.0), index[kept])


def ray_directions(beam_model: BeamModel, phase: float = 0.0) -> Points:
    """List the unit vectors of a full turn, beam after beam, each from azimuth `phase` [rad] counter-clockwise."""
    azimuth = phase + 2.0 * np.pi * np.arange(beam_model.n_azimuths) / beam_model.n_azimuths
    elevation = beam_model.elevations[:, None]
    directions = np.empty((len(beam_model.elevations), beam_model.n_azimuths, 3))
    directions[..., 0] = np.cos(elevation) * np.cos(azimuth)
    directions[..., 1] = np.cos(elevation) * np.sin(azimuth)
    directions[..., 2] = np.sin(elevation)
    return directions.reshape(-1, 3)


def _cast(placed: Sequence[PlacedMesh], directions: Points) -> _Hits:
    """Find the first surface on each ray from the origin."""
    n = len(directions)
    world = merge([mesh.moved(T_lidar_obj) for mesh, T_lidar_obj, _ in placed])
    if len(world.triangles) == 0:
        return _Hits(np.full(n, np.inf), np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.int64))
    owner = np.repeat(np.arange(len(placed)), [len(mesh.triangles) for mesh, *_ in placed])
    open3d = load_open3d("the LiDAR simulator")
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(world.vertices.astype(np.float32)),
        open3d.core.Tensor(world.triangles.astype(np.uint32)),
    )
    rays = np.zeros((n, 6), dtype=np.float32)
    rays[:, 3:] = directions
    answer = scene.cast_rays(open3d.core.Tensor(rays))
    range_m = answer["t_hit"].numpy().astype(np.float64)
    # Rays that meet nothing name no triangle; any will do, their range is infinite.
    triangle = np.where(np.isfinite(range_m), answer["primitive_ids"].numpy().astype(np.int64), 0)
    normals = answer["primitive_normals"].numpy().astype(np.float64)
    cosine = np.minimum(np.abs((normals * directions).sum(axis=1)), 1.0)
    return _Hits(range_m, cosine, world.material[triangle], owner[triangle])


def _return_probability(hits: _Hits, beam_model: BeamModel) -> Float64[np.ndarray, " rays"]:
    """Tell how likely each ray's echo is noticed."""
    echo = np.sqrt(np.maximum(_REFLECTIVITY[hits.material] * hits.cosine, 1e-9))
    is_hit: Bool[np.ndarray, " rays"] = np.isfinite(hits.range_m)
    effort = np.where(is_hit, hits.range_m, 0.0) / (beam_model.reach * echo)
    strong_enough = 1.0 / (1.0 + effort**6)
    grazing = np.arcsin(hits.cosine)
    steep_enough = 1.0 - np.exp(-np.square(grazing / beam_model.min_grazing))
    passed = (1.0 - beam_model.misfire) * (1.0 - _LOSS[hits.material])
    return np.where(is_hit, passed * strong_enough * steep_enough, 0.0)
