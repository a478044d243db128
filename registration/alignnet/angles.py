"""Headings as one of fifty bins and what remains of it: how the network says angles."""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor

TURN = 2.0 * math.pi

Angles = Float[Tensor, " b"]  # [rad]
AngleOutputs = Float[Tensor, "b bins2"]  # class logits, then one residual a bin


def wrap(angle: Angles) -> Angles:
    """Bring angles to [-pi, pi)."""
    return torch.remainder(angle + math.pi, TURN) - math.pi


def fold(angle: Angles) -> Angles:
    """Bring turns to [-pi/2, pi/2): the nearest of those that differ by half a turn."""
    return torch.remainder(angle + 0.5 * math.pi, math.pi) - 0.5 * math.pi


def encode(angle: Angles, n_bins: int) -> tuple[Int64[Tensor, " b"], Angles]:
    """Give the bin of each angle, and its residual in half bin widths, in [-1, 1); bin k is centred at k * width.

    Source: AlignNet-3D, section 3 (after Frustum PointNets); released code, tp8.py, 193-199 and 278.
    """
    width = TURN / n_bins
    turned = torch.remainder(angle + 0.5 * width, TURN)
    bins = (turned / width).long().clamp(0, n_bins - 1)  # rounding, and NaN, may lead out of them
    return bins, 2.0 * (turned / width - bins) - 1.0


def decode(outputs: AngleOutputs) -> Angles:
    """Give the angle of the likeliest bin and its residual, in [-pi, pi).

    The residual is scaled by half a bin width, as in the released graph; its evaluation forgot to.
    """
    logits, residuals = outputs.chunk(2, dim=1)  # (b, bins) each
    bins = logits.argmax(dim=1, keepdim=True)  # (b, 1)
    half_width = math.pi / logits.shape[1]
    return wrap((2.0 * bins + residuals.gather(1, bins))[:, 0] * half_width)


def rotate(points: Float[Tensor, "n d"], angle: Float[Tensor, " n"]) -> Float[Tensor, "n d"]:
    """Turn each point (x, y) or (x, y, z) counter-clockwise about z by its own angle [rad]."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y = points[:, 0], points[:, 1]
    return torch.cat([torch.stack([c * x - s * y, s * x + c * y], dim=1), points[:, 2:]], dim=1)
