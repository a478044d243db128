"""The network made fast: batch norm folded away, wide layers in bfloat16 where the CPU knows it, clouds unpadded."""

from collections.abc import Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from registration.alignnet import checkpoint, ragged
from registration.alignnet.checkpoint import About
from registration.alignnet.layers import Head, NormalisedLinear, PointEncoder
from registration.alignnet.network import AlignNet, Encoding

PRECISIONS = ("auto", "float32", "bfloat16")
ALIKE = 16  # products of fewer float32 rows go another way, to other last bits: a pair would depend on its batch


class FoldedLinear(nn.Module):
    """A linear map that batch norm has become a part of."""

    def __init__(self, layer: NormalisedLinear | nn.Linear, dtype: torch.dtype, branch: int = 0) -> None:
        super().__init__()
        if isinstance(layer, NormalisedLinear):
            weight, bias = layer.folded(layer.weight[:0], branch)
        else:
            weight, bias = layer.weight, layer.bias
        self.weight: Tensor
        self.bias: Tensor
        self.register_buffer("weight", weight.detach().to(dtype).contiguous())
        self.register_buffer("bias", bias.detach().to(dtype))

    def forward(self, x: Float[Tensor, "n d_in"]) -> Float[Tensor, "n d_out"]:
        """Map a batch, in the same way whatever its size."""
        return functional.linear(x, self.weight, self.bias)


class FoldedPointEncoder(nn.Module):
    """A `PointEncoder` for inference, with the first layer in float32: bfloat16 knows 4 m to 2 cm only."""

    def __init__(self, encoder: PointEncoder, dtype: torch.dtype, branch: int = 0) -> None:
        super().__init__()
        first, *middle, last = encoder.normalised()
        self.first = FoldedLinear(first, torch.float32, branch)
        self.middle = nn.ModuleList(FoldedLinear(layer, dtype, branch) for layer in middle)
        self.last = FoldedLinear(last, dtype, branch)
        self.dtype = dtype

    def forward(
        self, points: Float[Tensor, "n 3"], cloud: Int64[Tensor, " n"], n_clouds: int, branch: int = 0
    ) -> Float[Tensor, "b d"]:
        """Encode a ragged batch; the last bias and activation come after the maximum, which they do not change."""
        features = torch.relu_(self.first(points)).to(self.dtype)  # (n, 64)
        for layer in self.middle:
            features = torch.relu_(layer(features))  # (n, 128)
        product = functional.linear(features, self.last.weight)  # (n, d)
        best = ragged.maximum(product, cloud, n_clouds)  # (b, d)
        return torch.relu_(best + self.last.bias).float()


class FoldedHead(nn.Module):
    """A `Head` for inference: no dropout."""

    def __init__(self, head: Head, dtype: torch.dtype, branch: int = 0) -> None:
        super().__init__()
        self.layers = nn.ModuleList(FoldedLinear(layer, dtype, branch) for layer in head.layers)  # type: ignore[arg-type]
        self.output = FoldedLinear(head.output, torch.float32)
        self.dtype = dtype
        self.dropout = nn.Identity()

    def hidden(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_hidden"]:
        """Give the features before the last layer."""
        for layer in self.layers:
            features = torch.relu_(layer(features.to(self.dtype)))  # (b, 512), (b, 256)
        return features.float()

    def forward(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_out"]:
        """Give the outputs."""
        return self.output(self.hidden(features, branch))


def fold(network: AlignNet, dtype: torch.dtype = torch.float32, branch: int = 0) -> AlignNet:
    """Make a network of the same answers for inference; the one given stays as it is.

    The wide layers work in `dtype`; coordinates, the first layer of points and the last of heads stay in float32.

    Args:
        network: trained.
        dtype: float32 or bfloat16.
        branch: whose batch norm, where each cloud of a pair has its own.
    """
    folded = deepcopy(network).eval().requires_grad_(False)
    for name in ("coarse", "fine", "embedding"):
        setattr(folded, name, FoldedPointEncoder(getattr(network.eval(), name), dtype, branch))
        if name != "embedding":
            setattr(folded, f"{name}_head", FoldedHead(getattr(network, f"{name}_head"), dtype, branch))
    folded.final_head = FoldedHead(network.final_head, dtype)  # type: ignore[assignment]
    if network.precision is not None:
        folded.precision = FoldedLinear(network.precision, torch.float32)  # type: ignore[assignment]
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
    if not path.is_file():
        checkpoint.read_weights(path)  # says what is wrong
    return _load(path, path.stat().st_mtime_ns, best_dtype(precision))


@lru_cache(maxsize=8)
def _load(path: Path, written: int, dtype: torch.dtype) -> tuple[list[AlignNet], About]:
    network, about = checkpoint.read_weights(path)
    n_branches = 2 if about.architecture.branch_norms else 1
    return [fold(network, dtype, branch) for branch in range(n_branches)], about


def stack(encodings: Sequence[Encoding]) -> Encoding:
    """Put encodings of single clouds together."""
    return Encoding(*(torch.cat(fields) for fields in zip(*encodings, strict=True)))
