"""What comes back: mixed echoes of beams that meet an edge, noise of ranges, and echoes too weak to be noticed."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration.synthetic.lidar.beams import BeamModel, Rays
from registration.synthetic.lidar.casting import Hits, PlacedMesh, cast
from registration.synthetic.meshes import SURFACES, Material
from registration.types import Points

REFLECTIVITY = np.array([SURFACES[material].reflectivity for material in Material])
LOSS = np.array([SURFACES[material].loss for material in Material])

EDGE = 0.1  # depth of a step between neighbouring beams that counts as an edge [m]
N_RING = 6  # pulses on a ring, which with the one in the middle sample equal shares of a beam
# Radius of the ring, as a share of the beam's: it halves the area between the middle's seventh and the rim.
RING_RADIUS = float(np.sqrt(0.5 * (1.0 + 1.0 / (N_RING + 1))))


def mix_edges(hits: Hits, rays: Rays, placed: Sequence[PlacedMesh], beam_model: BeamModel) -> Hits:
    """Let beams be as wide as they are, where neighbours see different depths.

    A beam that meets surfaces at several depths returns the strongest echo; surfaces within one echo's length of each
    other make one echo, at the mean of their ranges weighted with what they send back.  So a point at an edge
    lies between two near surfaces, or on either of two that are far apart, and objects look a little wider than they
    are.

    Args:
        hits: of the beams' middles, a full turn.
        rays: the beams' middles.
        placed: the objects.
        beam_model: the sensor.

    Returns:
        The hits, those at edges replaced.
    """
    at_edge = np.flatnonzero(edges(hits.range_m, beam_model))
    if beam_model.divergence == 0.0 or len(at_edge) == 0:
        return hits
    around = cast(placed, _ring(rays, at_edge, beam_model), beam_model.max_range + beam_model.echo_length)

    def sampled(name: str) -> np.ndarray:
        """Put the middle before its ring, one row a beam."""
        return np.column_stack([getattr(hits, name)[at_edge], getattr(around, name).reshape(-1, N_RING)])

    mixed = _strongest(beam_model, sampled("range_m"), sampled("cosine"), sampled("material"), sampled("object_index"))
    changed = {}
    for field in dataclasses.fields(Hits):
        values = getattr(hits, field.name).copy()
        values[at_edge] = getattr(mixed, field.name)
        changed[field.name] = values
    return Hits(**changed)


def edges(range_m: Float64[np.ndarray, " n"], beam_model: BeamModel) -> Bool[np.ndarray, " n"]:
    """Tell which beams of a full turn see another depth than the plane through their neighbours.

    The inverse range of a plane is linear in direction, however slanted it is, and 0 for the sky: a beam is at an edge
    when its inverse range leaves the line between those of the beams on both sides, or above and below.
    """
    nearness = 1.0 / np.maximum(range_m.reshape(beam_model.n_beams, -1), 1e-3)
    found = np.zeros(nearness.shape, dtype=bool)
    left, right = np.roll(nearness, 1, axis=1), np.roll(nearness, -1, axis=1)
    found |= _leaves_line(nearness, left, right, 0.5)
    if beam_model.n_beams > 2:
        found |= _edges_between_rings(nearness, beam_model)
    return found.ravel()


def _edges_between_rings(
    nearness: Float64[np.ndarray, "beams columns"], beam_model: BeamModel
) -> Bool[np.ndarray, "beams columns"]:
    """Tell which beams see another depth than the line through the beams above and below."""
    order, columns = np.argsort(beam_model.elevations), _columns_alike(beam_model)
    rings = np.take_along_axis(nearness, columns, axis=1)[order]
    gap = np.diff(beam_model.elevations[order])
    weight = gap[1:] / np.maximum(gap[1:] + gap[:-1], 1e-9)  # of the ring below
    between = _leaves_line(rings[1:-1], rings[:-2], rings[2:], weight[:, None])
    # From another start even a plane looks different: two blocks of lasers have no line between them.
    heights = beam_model.per_beam("beam_heights")[order]
    between &= (np.maximum(np.abs(heights[1:-1] - heights[:-2]), np.abs(heights[2:] - heights[1:-1])) < 0.01)[:, None]
    aligned, found = np.zeros(nearness.shape, dtype=bool), np.zeros(nearness.shape, dtype=bool)
    aligned[order[1:-1]] = between
    np.put_along_axis(found, columns, aligned, axis=1)
    return found


def _columns_alike(beam_model: BeamModel) -> Int64[np.ndarray, "beams columns"]:
    """List for each beam the firings in which it points where the head points in firing 0, 1, ..."""
    n = beam_model.n_azimuths
    shift = np.round(beam_model.per_beam("azimuth_offsets") * n / (2.0 * np.pi)).astype(np.int64)
    return (np.arange(n) - shift[:, None]) % n


def _leaves_line(
    nearness: Float64[np.ndarray, "rows columns"],
    before: Float64[np.ndarray, "rows columns"],
    after: Float64[np.ndarray, "rows columns"],
    weight: float | Float64[np.ndarray, "rows 1"],
) -> Bool[np.ndarray, "rows columns"]:
    """Tell where an inverse range is not what a straight line between two others gives, by half a step of `EDGE`."""
    offset = np.abs(nearness - weight * before - (1.0 - weight) * after)
    return offset > 0.5 * EDGE * np.square(np.maximum(np.maximum(before, after), nearness))


def _ring(rays: Rays, chosen: Int64[np.ndarray, " n"], beam_model: BeamModel) -> Rays:
    """Aim pulses around the middles of some beams."""
    forward = rays.directions[chosen]
    left = np.column_stack([-forward[:, 1], forward[:, 0], np.zeros(len(chosen))])
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.cross(forward, left)
    angle = 2.0 * np.pi * np.arange(N_RING) / N_RING
    radius = 0.5 * beam_model.divergence * RING_RADIUS
    aside = radius * (np.cos(angle)[:, None] * left[:, None] + np.sin(angle)[:, None] * up[:, None])
    directions = forward[:, None] + aside
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    height, column = (np.repeat(values[chosen], N_RING) for values in (rays.height, rays.column))
    return Rays(directions.reshape(-1, 3), height, column, rays.times)


def _strongest(
    beam_model: BeamModel,
    range_m: Float64[np.ndarray, "n k"],
    cosine: Float64[np.ndarray, "n k"],
    material: Int64[np.ndarray, "n k"],
    object_index: Int64[np.ndarray, "n k"],
) -> Hits:
    """Merge samples of a beam into its strongest echo."""
    is_hit = np.isfinite(range_m)
    distance = np.where(is_hit, range_m, 1e9)
    passed = 1.0 - np.minimum(beam_model.loss_scale * LOSS[material], 1.0)
    strength = np.where(is_hit, REFLECTIVITY[material] * np.maximum(cosine, 1e-6) * passed / distance**2, 0.0)
    behind = distance[:, None, :] - distance[:, :, None]  # of sample k behind sample j, in [:, j, k]
    together = (behind >= 0.0) & (behind <= beam_model.echo_length) & is_hit[:, None, :]
    echo = np.einsum("njk,nk->nj", together, strength).argmax(axis=1)
    row = np.arange(len(echo))
    merged = together[row, echo]
    weight = merged * strength
    loudest = weight.argmax(axis=1)
    total = weight.sum(axis=1)
    mean = np.divide((weight * distance).sum(axis=1), total, out=np.full(len(row), np.inf), where=total > 0.0)
    return Hits(mean, cosine[row, loudest], material[row, loudest], object_index[row, loudest], merged.mean(axis=1))


def range_deviation(hits: Hits, beam_model: BeamModel) -> Float64[np.ndarray, " n"]:
    """Tell the standard deviation of each range [m].

    A slanted surface answers over the depth of the beam's footprint, range * divergence / tan(grazing angle), but
    never over more than the length of an echo.
    """
    flatness = np.sqrt(1.0 - np.square(hits.cosine)) / np.maximum(hits.cosine, 1e-6)
    depth = np.minimum(hits.range_m * beam_model.divergence * flatness, beam_model.echo_length)
    far = beam_model.range_noise + beam_model.range_noise_growth * hits.range_m
    return np.hypot(far, beam_model.slant_noise * depth)


def return_probability(hits: Hits, beam_model: BeamModel) -> Float64[np.ndarray, " n"]:
    """Tell how likely each echo is noticed."""
    echo = np.sqrt(np.maximum(REFLECTIVITY[hits.material] * hits.cosine * hits.share, 1e-9))
    effort = hits.range_m / (beam_model.reach * echo)
    probability = (1.0 - beam_model.misfire) / (1.0 + effort**beam_model.fade)
    probability *= 1.0 - np.minimum(beam_model.loss_scale * LOSS[hits.material], 1.0)
    if beam_model.min_grazing > 0.0:
        grazing = np.arcsin(hits.cosine)
        probability *= 1.0 - np.exp(-np.square(grazing / beam_model.min_grazing))
    return probability


def brightness(hits: Hits) -> Float64[np.ndarray, " n"]:
    """Tell the strength of each echo, corrected for range, in [0, 1]."""
    return REFLECTIVITY[hits.material] * (0.3 + 0.7 * hits.cosine) * hits.share


def jitter_deviation(hits: Hits, placed: Sequence[PlacedMesh], beam_model: BeamModel) -> Float64[np.ndarray, " n"]:
    """Tell the standard deviation of each coordinate of a point by the distance of its object's centroid [m]."""
    jitter = beam_model.jitter
    if jitter is None:
        return np.zeros(len(hits.range_m))
    centroids: Points = np.zeros((len(placed), 3))
    for index in np.unique(hits.object_index):
        mesh, T_lidar_obj, _ = placed[index]
        centroids[index] = T_lidar_obj[:3, :3] @ mesh.vertices.mean(axis=0) + T_lidar_obj[:3, 3]
    deviation = np.maximum(jitter.minimum, jitter.slope * np.linalg.norm(centroids, axis=1))
    return deviation[hits.object_index]
