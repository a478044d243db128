"""The network's speed in a tracker, beside the plain way: two callables to be timed in turn."""

from collections.abc import Callable, Sequence
from copy import deepcopy

import numpy as np
import torch

from registration.alignnet.layers import PointEncoder
from registration.alignnet.method import Cloud, LearnedRegistration
from registration.alignnet.network import AlignNet, Motion
from registration.alignnet.packing import pack, padded
from registration.types import Points

PLAIN_POINTS = 512  # of each cloud, in the published network


def streaming(method: LearnedRegistration, frames: Sequence[Sequence[Points]]) -> tuple[Callable[[], object], int]:
    """Give what a tracker does with a method, frame by frame, and how many transforms that makes.

    Object k of a frame is object k of the one before.  Each cloud is prepared once, as target, and kept as source.
    """

    def run() -> object:
        before: list[Cloud] = []
        results: list[object] = []
        for clouds in frames:
            now = method.prepare(clouds)
            results += method.align(list(zip(before, now, strict=False)))
            before = now
        return results

    return run, sum(min(len(a), len(b)) for a, b in zip(frames[:-1], frames[1:], strict=True))


def plain(network: AlignNet, frames: Sequence[Sequence[Points]]) -> tuple[Callable[[], object], int]:
    """Give the same work done as published: float32, all clouds drawn to 512 points, and both of a pair encoded.

    Args:
        network: not folded; batch norm runs as a layer of its own.
        frames: as for `streaming`; no cloud is empty.
    """
    rng = np.random.default_rng(0)

    def run() -> object:
        motions: list[Motion] = []
        for earlier, later in zip(frames[:-1], frames[1:], strict=True):
            n = min(len(earlier), len(later))
            batches = [
                pack(
                    [padded(cloud, PLAIN_POINTS, rng) - cloud.mean(axis=0) for cloud in clouds[:n]],
                    np.stack([-cloud.mean(axis=0)[:2] for cloud in clouds[:n]]),
                    PLAIN_POINTS,
                )
                for clouds in (earlier, later)
            ]
            with torch.inference_mode():
                target_branch = 1 if network.architecture.branch_norms else 0
                encodings = network.encode(batches[0]), network.encode(batches[1], target_branch)
                motions.append(network.align(*encodings))
        return motions

    return run, sum(min(len(a), len(b)) for a, b in zip(frames[:-1], frames[1:], strict=True))


def unfolded(network: AlignNet) -> AlignNet:
    """Make a network that runs layer by layer, as the paper writes it; the one given stays as it is."""
    network = deepcopy(network)
    for module in network.modules():
        if isinstance(module, PointEncoder):
            module.forward = module.plain  # type: ignore[method-assign]
    return network.eval()
