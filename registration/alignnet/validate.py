"""How good a network is on held-out pairs: its errors, pair by pair, and how sure it was of them."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float64

from registration.alignnet import loss
from registration.alignnet.dataset import PackedPairs, in_order, to_tensors
from registration.alignnet.network import AlignNet


class Held(NamedTuple):
    """Errors of n held-out pairs.

    Attributes:
        errors: rows of (translation about the true centre [m], turn [rad]), as the paper's tables count them.
        distance: horizontal, of the object's true centre in the source [m].
        nees: squared error over (x, y, yaw) in units of the predicted covariance; its expectation is 3.
    """

    errors: Float64[np.ndarray, "n 2"]
    distance: Float64[np.ndarray, " n"]
    nees: Float64[np.ndarray, " n"]

    def covariance_scale(self) -> float:
        """Give the factor of the covariances that makes 95 % of the errors fall within their 95 % ellipsoids.

        A factor that is right on average would follow the few worst errors; this one follows all but those.
        """
        return float(np.quantile(self.nees, 0.95) / CHI2_95)


CHI2_95 = 7.815  # 95 % quantile of chi squared with 3 degrees of freedom


def validate(
    network: AlignNet, pairs: PackedPairs, max_points: int, heading_axis: bool = True, device: str = "cpu"
) -> Held:
    """Run a network over held-out pairs, always with the same points, in float32.

    The errors are those of `evaluation.registration_error`: the shift at the object's true centre, and the turn,
    where half a turn more is no error if only the heading's axis counts.
    """
    was_training = network.training
    network.eval()
    found = []
    with torch.no_grad():
        for batch in in_order(pairs, 64, max_points):
            (source, target), (source_truth, target_truth) = to_tensors(batch)
            motion = network(source.to(device), target.to(device))[2]
            first, second = (loss.Truth(*(f.to(device) for f in truth)) for truth in (source_truth, target_truth))
            shift = loss.displacement_error(motion, first, second, heading_axis)[:, :2].norm(dim=1)
            error = loss.motion_error(motion, first, second, heading_axis)
            whitened = torch.einsum("bij,bj->bi", loss.precision_factor(motion.precision), error)
            nees = (whitened * whitened).sum(dim=1)
            distance = (source_truth.center[:, :2] - source.sensor).norm(dim=1).to(device)
            found.append(torch.stack([shift, error[:, 2].abs(), distance, nees], dim=1).cpu().double().numpy())
    network.train(was_training)
    columns = np.concatenate(found)
    return Held(columns[:, :2], columns[:, 2], columns[:, 3])
