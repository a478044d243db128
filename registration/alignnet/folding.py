"""The network with batch norm folded away, of torch's own operators only: what is exported."""

from copy import deepcopy

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from registration.alignnet import ragged
from registration.alignnet.layers import Head, PointEncoder
from registration.alignnet.network import AlignNet
from registration.alignnet.products import FoldedLinear


class FoldedPointEncoder(nn.Module):
    """A `PointEncoder` for inference."""

    def __init__(self, encoder: PointEncoder) -> None:
        super().__init__()
        *layers, last = encoder.normalised()
        self.layers = nn.ModuleList(FoldedLinear(layer, torch.float32, pack=False) for layer in layers)
        self.last = FoldedLinear(last, torch.float32, pack=False)

    def forward(
        self, points: Float[Tensor, "n 3"], cloud: Int64[Tensor, " n"], n_clouds: int, branch: int = 0
    ) -> Float[Tensor, "b d"]:
        """Encode a ragged batch; the last bias and activation come after the maximum, which they do not change."""
        features = points
        for layer in self.layers:
            features = layer(features)  # (n, 64), (n, 128)
        best = ragged.maximum(self.last.product(features), cloud, n_clouds)  # (b, d)
        return torch.relu(best + self.last.bias)


class FoldedHead(nn.Module):
    """A `Head` for inference: no dropout."""

    def __init__(self, head: Head) -> None:
        super().__init__()
        self.layers = nn.ModuleList(FoldedLinear(layer, torch.float32, pack=False) for layer in head.normalised())
        self.output = FoldedLinear(head.output, torch.float32, active=False, pack=False)
        self.dropout = nn.Identity()

    def hidden(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_hidden"]:
        """Give the features before the last layer."""
        for layer in self.layers:
            features = layer(features)  # (b, 512), (b, 256)
        return features

    def forward(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_out"]:
        """Give the outputs."""
        return self.output(self.hidden(features, branch))


def fold(network: AlignNet) -> AlignNet:
    """Make a network of the same answers, in float32; the one given stays as it is.

    Args:
        network: trained; with one batch norm for both clouds of a pair.
    """
    folded = deepcopy(network).eval().requires_grad_(False)
    for name in ("coarse", "fine", "embedding"):
        setattr(folded, name, FoldedPointEncoder(getattr(network.eval(), name)))
    for name in ("coarse_head", "fine_head", "final_head"):
        setattr(folded, name, FoldedHead(getattr(network, name)))
    return folded
