"""The two bricks of the network: a batch-normalised linear map, and the point encoder made of it."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from registration.alignnet import ragged

EPSILON = 1e-3  # of batch norm, as in the released code
STATISTICS = 2048  # about so many points, evenly out of all, give the statistics of a layer


class NormalisedLinear(nn.Module):
    """A linear map with batch norm: outputs have mean 0 and variance 1 over the batch, up to a learned gain and shift.

    Both maps are linear, so they fold into one: over points, mean and variance of W x follow from those of x
    (`folded`), and the features are passed over once only.  `forward` is the plain way.

    Args:
        n_branches: sets of gains, shifts and statistics; 2 to have one for each cloud of a pair, as the released
            TensorFlow code does (its variables were not shared); 1 for a siamese network.
    """

    def __init__(self, d_in: int, d_out: int, n_branches: int = 1) -> None:
        super().__init__()
        self.momentum = 0.1  # share of the batch in the running averages
        self.weight = nn.Parameter(nn.init.xavier_uniform_(torch.empty(d_out, d_in)))
        self.gain = nn.Parameter(torch.ones(n_branches, d_out))
        self.shift = nn.Parameter(torch.zeros(n_branches, d_out))
        self.mean: Tensor
        self.variance: Tensor
        self.register_buffer("mean", torch.zeros(n_branches, d_out))
        self.register_buffer("variance", torch.ones(n_branches, d_out))

    def forward(self, x: Float[Tensor, "n d_in"], branch: int = 0) -> Float[Tensor, "n d_out"]:
        """Map and normalise a batch, before the activation."""
        product = functional.linear(x, self.weight).float()  # (n, d_out)
        if not self.training:
            return self._normalise(product, self.mean[branch], self.variance[branch], branch)
        variance, mean = torch.var_mean(product, dim=0, correction=0)
        self._remember(mean, variance, branch)
        return self._normalise(product, mean, variance, branch)

    def folded(
        self, x: Float[Tensor, "n d_in"], branch: int = 0
    ) -> tuple[Float[Tensor, "d_out d_in"], Float[Tensor, " d_out"]]:
        """Give weight and bias of the one linear map that `forward` is on this batch."""
        if self.training:
            mean, variance = self._statistics(x)
            self._remember(mean, variance, branch)
        else:
            mean, variance = self.mean[branch], self.variance[branch]
        gain = self.gain[branch] / torch.sqrt(variance + EPSILON)  # (d_out,)
        return gain[:, None] * self.weight, self.shift[branch] - gain * mean

    def _statistics(self, x: Float[Tensor, "n d_in"]) -> tuple[Float[Tensor, " d_out"], Float[Tensor, " d_out"]]:
        with torch.autocast(x.device.type, enabled=False):
            sample = x[:: max(1, round(len(x) / STATISTICS))].float()
            center = sample.mean(dim=0)  # (d_in,)
            offsets = sample - center
            scatter = offsets.T @ offsets / max(len(sample), 1)  # (d_in, d_in)
            return self.weight @ center, ((self.weight @ scatter) * self.weight).sum(dim=1)

    def _remember(self, mean: Tensor, variance: Tensor, branch: int) -> None:
        with torch.no_grad():
            self.mean[branch].lerp_(mean.float(), self.momentum)
            self.variance[branch].lerp_(variance.float(), self.momentum)

    def _normalise(self, product: Tensor, mean: Tensor, variance: Tensor, branch: int) -> Tensor:
        gain = self.gain[branch] / torch.sqrt(variance + EPSILON)
        return torch.addcmul(self.shift[branch], product - mean, gain)


class PointEncoder(nn.Module):
    """A PointNet: the same layers for every point, then the maximum over each cloud.

    Source: AlignNet-3D, section 3; Qi et al., "PointNet", CVPR 2017.
    """

    def __init__(self, sizes: Sequence[int], n_branches: int = 1) -> None:
        super().__init__()
        widths = [3, *sizes]
        self.layers = nn.ModuleList(
            NormalisedLinear(d_in, d_out, n_branches) for d_in, d_out in zip(widths[:-1], widths[1:], strict=True)
        )

    def normalised(self) -> list[NormalisedLinear]:
        """Give the layers, first to last."""
        return [layer for layer in self.layers if isinstance(layer, NormalisedLinear)]

    def forward(
        self, points: Float[Tensor, "n 3"], cloud: Int64[Tensor, " n"], n_clouds: int, branch: int = 0
    ) -> Float[Tensor, "b d"]:
        """Encode a ragged batch; an empty cloud gives zeros.

        Normalisation folds into the linear maps, and the last map's bias and activation come after the maximum,
        which they do not change: they keep the order of the values.
        """
        first, *middle, last = self.normalised()
        weight, bias = first.folded(points, branch)
        with torch.autocast(points.device.type, enabled=False):  # bfloat16 knows 4 m to 2 cm only
            features = torch.relu(functional.linear(points, weight, bias))  # (n, 64)
        for layer in middle:
            weight, bias = layer.folded(features, branch)
            features = torch.relu(functional.linear(features, weight, bias))  # (n, 128)
        weight, bias = last.folded(features, branch)
        dtype = _compute_dtype(points)
        best = ragged.linear_maximum(features.to(dtype), weight.to(dtype), cloud, n_clouds)  # (b, d)
        return torch.relu(best.float() + bias)

    def plain(
        self, points: Float[Tensor, "n 3"], cloud: Int64[Tensor, " n"], n_clouds: int, branch: int = 0
    ) -> Float[Tensor, "b d"]:
        """Encode layer by layer, as the paper writes it: what `forward` is measured against."""
        features = points
        for layer in self.layers:
            features = torch.relu(layer(features, branch))  # (n, 64), (n, 128), (n, d)
        return ragged.maximum(features, cloud, n_clouds).clamp(min=0.0)


class Head(nn.Module):
    """Fully connected layers on a cloud's or a pair's features, dropout before the last.

    Source: AlignNet-3D, section 3.  The paper's "dropout of 70 %" is a share kept: 30 % are dropped.
    """

    def __init__(self, d_in: int, sizes: Sequence[int], d_out: int, dropout: float, n_branches: int = 1) -> None:
        super().__init__()
        widths = [d_in, *sizes]
        self.layers = nn.ModuleList(
            NormalisedLinear(a, b, n_branches) for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        self.dropout = nn.Dropout(dropout)
        self.output = nn.Linear(widths[-1], d_out)
        nn.init.xavier_uniform_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def normalised(self) -> list[NormalisedLinear]:
        """Give the layers before the last, first to last."""
        return [layer for layer in self.layers if isinstance(layer, NormalisedLinear)]

    def hidden(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_hidden"]:
        """Give the features before the last layer, without dropout."""
        for layer in self.layers:
            features = torch.relu(layer(features, branch))  # (b, 512), (b, 256)
        return features

    def forward(self, features: Float[Tensor, "b d_in"], branch: int = 0) -> Float[Tensor, "b d_out"]:
        """Give the outputs."""
        return self.output(self.dropout(self.hidden(features, branch))).float()


def _compute_dtype(like: Tensor) -> torch.dtype:
    kind = like.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32
