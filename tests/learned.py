"""Small networks, clouds and sets of pairs for the tests of AlignNet."""

import numpy as np
import torch

from registration.alignnet import checkpoint
from registration.alignnet.dataset import PackedPairs
from registration.alignnet.network import AlignNet, Architecture
from registration.alignnet.ragged import Clouds
from registration.alignnet.recipe import Recipe
from registration.pair_set import CloudPair
from tests.segments import car_cloud

SMALL = {"coarse": (8, 8, 16), "fine": (8, 8, 16), "embedding": (8, 8, 16), "head": (16, 16)}
FEW = dict(SMALL, dropout=0.0)


def network(seed=0, **settings) -> AlignNet:
    """Make a small network whose batch norms have seen something."""
    torch.manual_seed(seed)
    made = AlignNet(Architecture(**{**SMALL, **settings}))
    with torch.no_grad():
        for module in made.modules():
            if hasattr(module, "gain"):
                for tensor, low, high in (
                    (module.gain, 0.5, 1.5),
                    (module.shift, -0.2, 0.2),
                    (module.mean, -0.2, 0.2),
                    (module.variance, 0.5, 1.5),
                ):
                    tensor.uniform_(low, high)
    return made.eval()


def clouds(sizes=(30, 1, 200, 7), seed=0) -> Clouds:
    """Draw a ragged batch of points about the clouds' origins."""
    rng = np.random.default_rng(seed)
    n = sum(sizes)
    return Clouds(
        points=torch.from_numpy(rng.uniform([-2, -1, -0.7], [2, 1, 0.7], (n, 3)).astype(np.float32)),
        cloud=torch.from_numpy(np.repeat(np.arange(len(sizes)), sizes)),
        n_seen=torch.tensor([float(size) for size in sizes]),
        sensor=torch.from_numpy(rng.uniform(5, 20, (len(sizes), 2)).astype(np.float32)),
    )


def pair(rng) -> CloudPair:
    """Let a car stand and turn somewhere, twice."""
    heading, turn = rng.uniform(-np.pi, np.pi), rng.normal(0.0, 0.05)
    start = np.array([*rng.uniform(8.0, 15.0, 2), -1.0])
    end = start + [*rng.uniform(-1.0, 1.0, 2), 0.0]
    clouds_ = []
    for place, angle in ((start, heading), (end, heading + turn)):
        c, s = np.cos(angle), np.sin(angle)
        body = car_cloud(int(rng.integers(20, 60)), seed=int(rng.integers(1 << 30))) - [0.0, 0.0, 0.7]
        clouds_.append(body @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + place)
    return CloudPair(*clouds_, start, end, float(heading), float(heading + turn))


def packed(n=24, seed=0) -> PackedPairs:
    """Make a small set, ready to be trained on."""
    rng = np.random.default_rng(seed)
    pairs = [pair(rng) for _ in range(n)]
    all_clouds = [cloud for p in pairs for cloud in (p.source, p.target)]
    return PackedPairs(
        points=np.concatenate(all_clouds).astype(np.float32),
        begin=np.concatenate([[0], np.cumsum([len(cloud) for cloud in all_clouds])]),
        center=np.stack([c for p in pairs for c in (p.start_position, p.end_position)]),
        heading=np.array([a for p in pairs for a in (p.start_angle, p.end_angle)]),
    )


def quiet_weights(path, **settings):
    """Write weights of a network that sees nothing: it answers with the centroids' shift and the bearings' turn."""
    made = network(**settings)
    with torch.no_grad():
        for head in (made.coarse_head, made.fine_head, made.final_head):
            head.output.weight.mul_(1e-3)
            head.output.bias.zero_()
            if len(head.output.bias) > 3:  # the first bin, and surely so
                head.output.bias[made.architecture.translation_dims] = 1.0
    checkpoint.write_weights(path, made, checkpoint.About(Recipe(network=made.architecture)))
    return path
