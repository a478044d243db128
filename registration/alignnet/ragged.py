"""Clouds of different size in one piece: points one after the other, with no padding and no repetition."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int64
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from registration.alignnet import kernels

CHUNK = 4096  # points worked on at a time on a CPU, so that wide layers are never stored whole


class Clouds(NamedTuple):
    """A batch of b clouds with n points in all, horizontal axes of the sensor, origin near each cloud.

    Attributes:
        points: relative to each cloud's own origin [m].
        cloud: which cloud each point belongs to; ascending.
        n_seen: number of points each cloud had before any were left out.
        sensor: where the sensor is (x, y), relative to each cloud's own origin [m].
    """

    points: Float[Tensor, "n 3"]
    cloud: Int64[Tensor, " n"]
    n_seen: Float[Tensor, " b"]
    sensor: Float[Tensor, "b 2"]

    def to(self, device: torch.device | str) -> "Clouds":
        """Move all of it to a device."""
        return Clouds(*(tensor.to(device, non_blocking=True) for tensor in self))


def join(first: Clouds, second: Clouds) -> Clouds:
    """Put two batches one behind the other."""
    return Clouds(
        points=torch.cat([first.points, second.points]),
        cloud=torch.cat([first.cloud, second.cloud + len(first.n_seen)]),
        n_seen=torch.cat([first.n_seen, second.n_seen]),
        sensor=torch.cat([first.sensor, second.sensor]),
    )


def mean(points: Float[Tensor, "n d"], cloud: Int64[Tensor, " n"], n_clouds: int) -> Float[Tensor, "b d"]:
    """Average the points of each cloud; zero for an empty one."""
    total = points.new_zeros(n_clouds, points.shape[1]).index_add(0, cloud, points)
    count = points.new_zeros(n_clouds).index_add(0, cloud, torch.ones_like(points[:, 0]))
    return total / count.clamp(min=1.0)[:, None]


def spread(values: Float[Tensor, "b ..."], cloud: Int64[Tensor, " n"]) -> Float[Tensor, "n ..."]:
    """Give each point the value of its cloud."""
    return values.index_select(0, cloud)


def in_axes(
    points: Float[Tensor, "n 3"],
    cloud: Int64[Tensor, " n"],
    origin: Float[Tensor, "b 3"],
    heading: Float[Tensor, " b"],
) -> Float[Tensor, "n 3"]:
    """Say each point in axes of its cloud's own: about an origin [m], x along a heading [rad]."""
    frames = torch.cat([origin, torch.cos(heading)[:, None], torch.sin(heading)[:, None]], dim=1)  # (b, 5)
    ox, oy, oz, c, s = spread(frames, cloud).unbind(dim=1)
    x, y, z = points.unbind(dim=1)
    x, y = x - ox, y - oy
    return torch.stack([c * x + s * y, c * y - s * x, z - oz], dim=1)


def maximum(features: Float[Tensor, "n d"], cloud: Int64[Tensor, " n"], n_clouds: int) -> Float[Tensor, "b d"]:
    """Give the largest of each feature over each cloud; minus infinity for an empty one."""
    lowest = features.new_full((n_clouds, features.shape[1]), -torch.inf)
    return lowest.scatter_reduce(0, cloud[:, None].expand_as(features), features, "amax", include_self=True)


def linear_maximum(
    features: Float[Tensor, "n d_in"], weight: Float[Tensor, "d_out d_in"], cloud: Int64[Tensor, " n"], n_clouds: int
) -> Float[Tensor, "b d_out"]:
    """Give `maximum(features @ weight.T)`; on a CPU without storing what the maximum drops.

    There the product is made chunk by chunk, and of the points that share a maximum the first gets its gradient.
    """
    if features.is_cuda:
        return maximum(functional.linear(features, weight), cloud, n_clouds)
    return _LinearMaximum.apply(features, weight, cloud, n_clouds)


class _LinearMaximum(torch.autograd.Function):
    """The maximum of a product whose gradient is known to be sparse."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, weight: Tensor, cloud: Tensor, n_clouds: int) -> Tensor:
        best = features.new_full((n_clouds, len(weight)), -torch.inf)
        row = torch.empty(best.shape, dtype=torch.int32)
        begin = offsets(cloud, n_clouds)
        for first, last in _chunks(begin):
            points = slice(begin[first], begin[last])
            product = features[points] @ weight.T  # (chunk, d_out)
            _best_rows(product, begin[first : last + 1], best[first:last], row[first:last])
        ctx.save_for_backward(features, weight, row)
        return best

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, None, None]:
        features, weight, row = ctx.saved_tensors
        of_features = torch.zeros(features.shape)
        of_weight = torch.zeros(weight.shape)
        arrays = (gradient.float(), row, features.float(), weight.float(), of_features, of_weight)
        kernels.scatter_gradient(*(array.contiguous().numpy() for array in arrays))
        return of_features.to(features.dtype), of_weight.to(weight.dtype), None, None


def offsets(cloud: Int64[Tensor, " n"], n_clouds: int) -> NDArray[np.int64]:
    """Say where each cloud begins: cloud k is rows offsets[k] to offsets[k + 1]."""
    return np.searchsorted(cloud.numpy(), np.arange(n_clouds + 1))


def _best_rows(product: Tensor, begin: NDArray[np.int64], best: Tensor, row: Tensor) -> None:
    """Run the kernel on integers of the same order where numpy does not know the numbers."""
    if product.dtype is not torch.bfloat16:
        kernels.best_rows(product.numpy(), begin - begin[0], best.numpy(), row.numpy())
    else:
        bits = best.view(torch.int16).numpy()
        bits[:] = kernels.ordered(bits)
        kernels.best_rows(kernels.ordered(product.view(torch.int16).numpy()), begin - begin[0], bits, row.numpy())
        bits[:] = kernels.ordered(bits)
    row.add_(int(begin[0]) * (row >= 0))


def _chunks(begin: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Split the clouds into runs of about CHUNK points: clouds first to last - 1 of each run."""
    first = 0
    for last in range(1, len(begin)):
        if last == len(begin) - 1 or begin[last + 1] - begin[first] > CHUNK:
            yield first, last
            first = last
