"""How weights follow gradients: the optimiser, its learning rate, and the momentum of the running averages."""

import math

import torch

from registration.alignnet.layers import NormalisedLinear
from registration.alignnet.network import AlignNet
from registration.alignnet.recipe import OptimiserSettings


def make_optimiser(network: AlignNet, settings: OptimiserSettings) -> torch.optim.Optimizer:
    """Make the optimiser of a recipe; weights decay, gains and shifts do not."""
    weights = [p for name, p in network.named_parameters() if name.endswith("weight")]
    others = [p for name, p in network.named_parameters() if not name.endswith("weight")]
    groups = [{"params": weights, "weight_decay": settings.weight_decay}, {"params": others, "weight_decay": 0.0}]
    kind = torch.optim.Adam if settings.name == "adam" else torch.optim.AdamW
    return kind(groups, lr=settings.rate, betas=(0.9, 0.999), eps=1e-8)


def learning_rate(settings: OptimiserSettings, epoch: float, n_epochs: int) -> float:
    """Give the rate at a time in the training; `epoch` counts from 0 and has fractions within an epoch.

    Source of "halving": AlignNet-3D, released code, train.py, 133-156.
    """
    if settings.schedule == "halving":
        return max(settings.least_rate, settings.rate * 0.5 ** (int(epoch) // settings.period))
    done = min(epoch / n_epochs, 1.0)
    if settings.schedule == "one-cycle" and done < settings.warm_up:
        return settings.rate * (0.04 + 0.96 * done / settings.warm_up)
    start = settings.warm_up if settings.schedule == "one-cycle" else 0.0
    falling = 0.5 * (1.0 + math.cos(math.pi * (done - start) / (1.0 - start)))
    return settings.least_rate + (settings.rate - settings.least_rate) * falling


def norm_momentum(settings: OptimiserSettings, epoch: float) -> float:
    """Give the share of the batch in batch norm's running averages.

    Source of the published one: released code, train.py, 164-174; decay = min(0.99, 1 - 0.5^(1 + epoch / period)).
    """
    if settings.norm_momentum > 0.0:
        return settings.norm_momentum
    return max(0.01, 0.5 * 0.5 ** (int(epoch) // settings.period))


def set_norm_momentum(network: AlignNet, momentum: float) -> None:
    """Tell it to all normalised layers."""
    for module in network.modules():
        if isinstance(module, NormalisedLinear):
            module.momentum = momentum
