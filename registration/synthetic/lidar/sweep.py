"""One turn of the sensor: rays cast, echoes formed, points written."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.synthetic.lidar import echoes
from registration.synthetic.lidar.beams import BeamModel, fire
from registration.synthetic.lidar.casting import Hits, PlacedMesh, cast
from registration.synthetic.meshes import Material, box_mesh
from registration.types import Points

GROUND = -1  # the object index of ground returns


@dataclass(frozen=True, slots=True)
class Sweep:
    """What one turn of the sensor returned, beam by beam in the order of the model's elevations.

    Attributes:
        points_lidar: the returns (n, 3), each in the sensor's frame at its own time of firing [m].
        intensity: strength of each echo, corrected for range, in [0, 1].
        object_index: which of the scanned objects each return comes from; GROUND (-1) for the ground.
        time: of each return, after the moment when the sensor's head points forward [s].
        beam_index: which of the model's beams each return comes from.
    """

    points_lidar: Points
    intensity: Float64[np.ndarray, " n"]
    object_index: Int64[np.ndarray, " n"]
    time: Float64[np.ndarray, " n"]
    beam_index: Int64[np.ndarray, " n"]


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
    """Ray-cast one sweep over objects: each beam returns its strongest echo, or none.

    Objects with a twist move while the sensor turns (rolling shutter): each ray meets them where they are when it is
    fired, and its point is written in the sensor's frame of that moment, as raw sweeps have it.  With all twists None
    the sweep is instantaneous.  The random numbers are drawn per ray, before any is cast, so that a return keeps its
    noise whatever else is in the scene, and a seed gives the same bits on any number of threads.

    Args:
        objects: meshes, their poses in the sensor's frame (x forward, y left, z up), and their motion.
        beam_model: the sensor.
        rng: source of the noise and of the lost returns.
        ground: what counts as ground, for example `level_ground(beam_model)`; None for empty space.

    Raises:
        MissingLibraryError: Open3D cannot be imported.
    """
    phase = rng.uniform(0.0, beam_model.azimuth_step) if beam_model.is_free_running else 0.0
    n_rays = beam_model.n_beams * beam_model.n_azimuths
    noise = rng.standard_normal((2, n_rays))
    luck = rng.uniform(size=n_rays)
    shake = None if beam_model.jitter is None else rng.standard_normal((n_rays, 3))

    rays = fire(beam_model, phase)
    placed = list(objects) if ground is None else [*objects, ground]
    hits = cast(placed, rays, beam_model.max_range + beam_model.echo_length)
    if beam_model.divergence > 0.0:
        hits = echoes.mix_edges(hits, rays, placed, beam_model)

    kept = np.flatnonzero(np.isfinite(hits.range_m))
    hits = _chosen(hits, kept)
    beam = kept // beam_model.n_azimuths
    range_m = hits.range_m + echoes.range_deviation(hits, beam_model) * noise[0, kept]
    range_m += beam_model.per_beam("range_offsets")[beam]
    in_reach = (beam_model.min_range <= range_m) & (range_m <= beam_model.max_range)
    heard = np.flatnonzero(in_reach & (luck[kept] < echoes.return_probability(hits, beam_model)))
    kept, hits = kept[heard], _chosen(hits, heard)

    points = rays.directions[kept] * range_m[heard, None]
    points[:, 2] += rays.height[kept]
    if shake is not None and beam_model.jitter is not None:
        shift = echoes.jitter_deviation(hits, placed, beam_model)[:, None] * shake[kept]
        points += np.clip(shift, -beam_model.jitter.limit, beam_model.jitter.limit)
    intensity = echoes.brightness(hits) * (1.0 + beam_model.intensity_noise * noise[1, kept])
    index = np.where(hits.object_index < len(objects), hits.object_index, GROUND)
    return Sweep(points, np.clip(intensity, 0.0, 1.0), index, rays.times[rays.column[kept]], beam[heard])


def _chosen(hits: Hits, chosen: Int64[np.ndarray, " m"]) -> Hits:
    """Pick some of the hits."""
    return Hits(**{field.name: getattr(hits, field.name)[chosen] for field in dataclasses.fields(Hits)})
