"""Products with weights that never change again: oneDNN's layout of them is made once, not in every call.

oneDNN's products also have the same bits on any number of threads, which those of `functional.linear` in float32 have
not.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from registration.alignnet.layers import NormalisedLinear

ROWS = 64  # oneDNN's layout is chosen for about so many rows; any number works


class FoldedLinear(nn.Module):
    """A linear map that batch norm has become a part of, and a ReLU too where one follows.

    Args:
        layer: what is folded.
        dtype: float32 or bfloat16.
        branch: whose batch norm, where each cloud of a pair has its own.
        active: a ReLU follows.
        pack: use oneDNN's layout, where torch can; False: only operators that can be exported.
    """

    def __init__(
        self,
        layer: NormalisedLinear | nn.Linear,
        dtype: torch.dtype,
        branch: int = 0,
        active: bool = True,
        pack: bool = True,
    ) -> None:
        super().__init__()
        if isinstance(layer, NormalisedLinear):
            weight, bias = layer.folded(layer.weight[:0], branch)
        else:
            weight, bias = layer.weight, layer.bias
        self.weight: Tensor
        self.bias: Tensor
        self.register_buffer("weight", weight.detach().to(dtype).contiguous())
        self.register_buffer("bias", bias.detach().to(dtype))
        self.active = active
        self.packed = _packed(self.weight) if pack else None

    def forward(self, x: Float[Tensor, "n d_in"]) -> Float[Tensor, "n d_out"]:
        """Map a batch, in the same way whatever its size."""
        if self.packed is not None:
            return _multiply(x, self.packed, self.bias, "relu" if self.active else "none")
        product = functional.linear(x, self.weight, self.bias)
        return torch.relu_(product) if self.active else product

    def product(self, x: Float[Tensor, "n d_in"]) -> Float[Tensor, "n d_out"]:
        """Multiply by the weights only: no bias, no ReLU."""
        if self.packed is not None:
            return _multiply(x, self.packed, None, "none")
        return functional.linear(x, self.weight)


def _packed(weight: Float[Tensor, "d_out d_in"]) -> Any | None:
    """Lay weights out as oneDNN multiplies them; None where this build of torch, or its operators, cannot.

    `functional.linear` of bfloat16 does so in every call, which for a few rows takes as long as the product.
    """
    try:
        with torch.inference_mode():
            packed = torch.ops.mkldnn._reorder_linear_weight(weight, ROWS)
            _multiply(weight[:1], packed, None, "none")
    except (AttributeError, NotImplementedError, RuntimeError, TypeError):
        return None
    return packed


def _multiply(x: Tensor, packed: Any, bias: Tensor | None, then: str) -> Tensor:
    """Call the operator that torch.compile puts in the place of linear layers."""
    return torch.ops.mkldnn._linear_pointwise(x, packed, bias, then, [], "")
