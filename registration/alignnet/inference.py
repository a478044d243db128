"""The network made fast: batch norm folded away, wide layers in bfloat16 where the CPU knows it, clouds unpadded."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn
from torch.nn import functional

from registration.alignnet import checkpoint, ragged
from registration.alignnet.checkpoint import About
from registration.alignnet.layers import Head, NormalisedLinear, PointEncoder
from registration.alignnet.network import AlignNet, Encoding
from registration.alignnet.products import FoldedLinear
from registration.types import Point

Row = Float32[np.ndarray, " w"]  # an `Encoding` of one cloud, field by field
Rows = Float32[np.ndarray, "b w"]

# oneDNN makes a program for each new number of rows, which takes as long as running it: there are few such numbers
LIKE_SIZED = 64

PRECISIONS = ("auto", "float32", "bfloat16")


class FoldedPointEncoder(nn.Module):
    """A `PointEncoder` for inference, with the first layer in float32: bfloat16 knows 4 m to 2 cm only."""

    def __init__(self, encoder: PointEncoder, how: "How", branch: int = 0) -> None:
        super().__init__()
        first, *middle, last = encoder.normalised()
        self.first = how.linear(first, branch, dtype=torch.float32)
        self.middle = nn.ModuleList(how.linear(layer, branch) for layer in middle)
        self.last = how.linear(last, branch)
        self.how = how

    def forward(
        self, points: Float[Tensor, "n 3"], cloud: Int64[Tensor, " n"], n_clouds: int, branch: int = 0
    ) -> Float[Tensor, "b d"]:
        """Encode a ragged batch; the last bias and activation come after the maximum, which they do not change."""
        if self.how.pack and (missing := -len(points) % LIKE_SIZED):
            points = functional.pad(points, (0, 0, 0, missing))  # zeros that belong to no cloud
        features = self.first(points).to(self.how.dtype)  # (n, 64)
        for layer in self.middle:
            features = layer(features)  # (n, 128)
        product = self.last.product(features)  # (n, d)
        if self.how.pack:
            product = product[: len(cloud)]
        maximum = ragged.half_maximum if self.how.dtype is torch.bfloat16 else ragged.maximum
        return torch.relu_(maximum(product, cloud, n_clouds) + self.last.bias).float()


class FoldedHead(nn.Module):
    """A `Head` for inference: no dropout."""

    def __init__(self, head: Head, how: "How", branch: int = 0) -> None:
        super().__init__()
        self.layers = nn.ModuleList(how.linear(layer, branch) for layer in head.layers)  # type: ignore[arg-type]
        self.output = how.linear(head.output, dtype=torch.float32, active=False)
        self.dtype = how.dtype
        self.dropout = nn.Identity()

    def hidden(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_hidden"]:
        """Give the features before the last layer."""
        for layer in self.layers:
            features = layer(features.to(self.dtype))  # (b, 512), (b, 256)
        return features.float()

    def forward(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_out"]:
        """Give the outputs."""
        return self.output(self.hidden(features, branch))


@dataclass(frozen=True)
class How:
    """How a network is folded.

    Attributes:
        dtype: of the wide layers, float32 or bfloat16; coordinates, the first layer of points and the last of heads
            stay in float32.
        pack: see `products.FoldedLinear`.
    """

    dtype: torch.dtype = torch.float32
    pack: bool = True

    def linear(
        self,
        layer: NormalisedLinear | nn.Linear,
        branch: int = 0,
        dtype: torch.dtype | None = None,
        active: bool = True,
    ) -> FoldedLinear:
        """Fold one layer; see `products.FoldedLinear`."""
        return FoldedLinear(layer, dtype or self.dtype, branch, active, self.pack)


def fold(network: AlignNet, how: How = How(), branch: int = 0) -> AlignNet:  # noqa: B008 - it is frozen
    """Make a network of the same answers for inference; the one given stays as it is.

    Args:
        network: trained.
        how: in which numbers.
        branch: whose batch norm, where each cloud of a pair has its own.
    """
    folded = deepcopy(network).eval().requires_grad_(False)
    for name in ("coarse", "fine", "embedding"):
        setattr(folded, name, FoldedPointEncoder(getattr(network.eval(), name), how, branch))
        if name != "embedding":
            setattr(folded, f"{name}_head", FoldedHead(getattr(network, f"{name}_head"), how, branch))
    folded.final_head = FoldedHead(network.final_head, how)  # type: ignore[assignment]
    if network.precision is not None:
        folded.precision = how.linear(network.precision, dtype=torch.float32, active=False)  # type: ignore[assignment]
    return folded


def best_dtype(precision: str = "auto") -> torch.dtype:
    """Give the number type of a precision; `auto` is bfloat16 where the CPU multiplies it in hardware.

    Raises:
        ValueError: no such precision.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision!r}")
    has_it = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return torch.bfloat16 if precision == "bfloat16" or (precision == "auto" and has_it) else torch.float32


def load(path: Path, precision: str = "auto") -> tuple[list[AlignNet], About]:
    """Read weights and fold them, once for each file: a network for the source, and one for the target.

    They are the same one unless each cloud of a pair has its own batch norm.

    Raises:
        WeightsError: see `checkpoint.read_weights`.
    """
    try:
        written = path.stat().st_mtime_ns
    except OSError:
        written = 0  # reading it will say what is wrong
    return _load(path, written, best_dtype(precision))


@lru_cache(maxsize=8)
def _load(path: Path, written: int, dtype: torch.dtype) -> tuple[list[AlignNet], About]:
    network, about = checkpoint.read_weights(path)
    n_branches = 2 if about.architecture.branch_norms else 1
    return [fold(network, How(dtype), branch) for branch in range(n_branches)], about


def to_rows(encoding: Encoding) -> Rows:
    """Put all that is known of each cloud into one row of numbers, to be kept and put together anew."""
    return torch.cat([field.reshape(len(field), -1) for field in encoding], dim=1).numpy()


def center(row: Row) -> Point:
    """Read from a row of `to_rows` where T-FineNet believes the object's centre, relative to the cloud's own origin."""
    found: Point = row[3:6].astype(np.float64)
    return found


def from_rows(rows: Sequence[Row], network: AlignNet) -> Encoding:
    """Put rows of single clouds together to a batch again; the network is the one that made them."""
    widths = 3, 3, 1, 2 * network.architecture.n_bins, 1
    stacked = torch.from_numpy(np.stack(rows))
    *fields, embedding = stacked.split([*widths, stacked.shape[1] - sum(widths)], dim=1)
    coarse_center, center, bearing, angle, heading = fields
    return Encoding(coarse_center, center, bearing[:, 0], angle, heading[:, 0], embedding)
