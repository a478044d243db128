"""From numpy clouds to the network's ragged batches: large clouds thinned evenly, nothing repeated."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float64

from registration.alignnet.ragged import Clouds
from registration.types import Point, Points


def pack(
    clouds: Sequence[Points], origins: Sequence[Point], sensors: Float64[np.ndarray, "b 2"], max_points: int
) -> Clouds:
    """Put clouds one behind the other, each relative to an origin of its own.

    Of a cloud with more points than `max_points`, every so-manieth is kept: in the order of a scan, ring by ring,
    that is evenly over the surface, and always the same points.

    Args:
        clouds: in any axes with z up [m].
        origins: one near each cloud, in the same axes [m].
        sensors: (x, y) of the sensor relative to each origin [m].
        max_points: of a cloud.
    """
    kept = [thinned(cloud, max_points) - origin for cloud, origin in zip(clouds, origins, strict=True)]
    sizes = [len(cloud) for cloud in kept]
    return Clouds(
        points=torch.from_numpy(np.concatenate(kept).astype(np.float32)),
        cloud=torch.from_numpy(np.repeat(np.arange(len(kept)), sizes)),
        n_seen=torch.tensor([float(len(cloud)) for cloud in clouds]),
        sensor=torch.from_numpy(sensors.astype(np.float32)),
    )


def thinned(cloud: Points, max_points: int) -> Points:
    """Keep at most so many points, evenly out of all."""
    if len(cloud) <= max_points:
        return cloud
    return cloud[(np.arange(max_points) * len(cloud)) // max_points]


def padded(cloud: Points, n_points: int, rng: np.random.Generator) -> Points:
    """Draw exactly so many points, some of them repeatedly: how the paper makes clouds equally large.

    Source: AlignNet-3D, released code, provider.py, 95-98.
    """
    return cloud[rng.integers(0, len(cloud), n_points)]
