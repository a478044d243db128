"""The network the plain way, as published: what the fast way is measured against, in the same run."""

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
import torch

from registration.alignnet.layers import PointEncoder
from registration.alignnet.network import AlignNet, Motion
from registration.alignnet.packing import pack, padded
from registration.alignnet.ragged import Clouds
from registration.types import Points

PLAIN_POINTS = 512  # of each cloud, in the published network


class PlainWay:
    """The same network run as published: float32, layer by layer, clouds drawn to 512 points, both of a pair encoded.

    It takes clouds as a method does, and gives the network's motions instead of results.

    Args:
        network: not folded; batch norm runs as a layer of its own.
        n_points: that every cloud is drawn to.
    """

    def __init__(self, network: AlignNet, n_points: int = PLAIN_POINTS) -> None:
        self.network = unfolded(network)
        self.n_points = n_points
        self.rng = np.random.default_rng(0)

    def prepare(self, clouds: Sequence[Points]) -> list[Points]:
        """Do nothing: clouds are encoded pair by pair."""
        return list(clouds)

    def align(self, pairs: Sequence[tuple[Points, Points]]) -> list[Motion]:
        """Encode both clouds of each pair, all in one batch, and compare them; give the motions as a batch."""
        if not pairs:
            return []
        sides = [self._pack(clouds) for clouds in zip(*pairs, strict=True)]
        with torch.inference_mode():
            target_branch = 1 if self.network.architecture.branch_norms else 0
            encodings = self.network.encode(sides[0]), self.network.encode(sides[1], target_branch)
            return [self.network.align(*encodings)]

    def _pack(self, clouds: Sequence[Points]) -> Clouds:
        """Draw as many points of each cloud, relative to its mean, seen from the origin."""
        origins = [cloud.mean(axis=0) for cloud in clouds]
        drawn = [padded(cloud, self.n_points, self.rng) for cloud in clouds]
        return pack(drawn, origins, -np.stack(origins)[:, :2], self.n_points)


def unfolded(network: AlignNet) -> AlignNet:
    """Make a network that runs layer by layer, as the paper writes it; the one given stays as it is."""
    network = deepcopy(network)
    for module in network.modules():
        if isinstance(module, PointEncoder):
            module.forward = module.plain  # type: ignore[method-assign]
    return network.eval()
