"""Fast global registration: all feature correspondences at once, the wrong ones fading out as the scale shrinks."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from registration import se3
from registration.belief import Belief
from registration.features import (
    Correspondences,
    Doubt,
    FeatureCloud,
    FeatureSettings,
    agreement,
    correspond,
    from_origins,
)
from registration.global_search import FeatureMethod
from registration.libraries import load_open3d
from registration.types import Points, RegistrationResult, Status, Transform
from registration.uncertainty import of_features

MIN_CORRESPONDENCES = 4  # three make a tuple; one more can contradict it
AGREEING = 0.075  # of a correspondence that is counted as agreeing with the answer [m]


@dataclass(frozen=True)
class FastGlobalRegistration(FeatureMethod):
    """Minimise a scaled Geman-McClure cost over all feature correspondences, from a wide scale to a narrow one.

    Open3D's implementation; made planar as in AlignNet-3D's fork of it: correspondences are found in 3-D, then z
    is dropped before the optimisation.  The lift is that of the correspondences.  An answer that does not
    explain the clouds (`doubt`) is dropped for the belief, with a status.

    Source: Zhou, Park & Koltun, "Fast global registration", ECCV 2016; parameters of AlignNet-3D (3DV 2019).
    """

    name: ClassVar[str] = "fgr"

    max_distance: float = 0.025  # scale at which the cost stops narrowing; a share of the clouds' size
    max_iterations: int = 64
    division: float = 1.4  # the scale shrinks by this every fourth iteration
    narrows: bool = True  # Open3D's decrease_mu: False in its Python default and in the fork's, True in the paper
    tuple_scale: float = 0.95  # similarity of edge lengths asked of a triple of correspondences
    max_tuples: int = 1000
    height_tolerance: float = 0.1  # correspondences differ no more than this from their common lift [m]
    believed_turn: float = 0.1  # standard deviation of the turn of the belief, without a prior [rad]
    seed: int = 0  # of Open3D's random numbers, set anew for each pair
    features: FeatureSettings = field(default_factory=FeatureSettings)
    doubt: Doubt = field(default_factory=Doubt)

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load Open3D."""
        for name in ("max_distance", "tuple_scale", "height_tolerance", "believed_turn"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("max_iterations", "max_tuples"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not self.division > 1.0:
            raise ValueError(f"division must be above 1, got {self.division}")
        load_open3d(self.name)

    def search(self, source: FeatureCloud, target: FeatureCloud, belief: Belief) -> RegistrationResult:
        """Optimise over all correspondences at once."""
        pairs, lift = correspond(source, target, self.height_tolerance, self.name)
        if len(pairs) < MIN_CORRESPONDENCES:
            return belief.result(Status.TOO_FEW_POINTS)
        T = self._optimise(source, target, pairs, lift)
        if not self.doubt.admits(from_origins(T, source, target), source, target, belief):
            return belief.result(Status.NO_OVERLAP)
        n_agreeing, rmse = agreement(T, source, target, pairs, AGREEING)
        is_confirmed = n_agreeing >= MIN_CORRESPONDENCES  # else the belief is all that speaks for the answer
        return RegistrationResult(
            T_target_source=from_origins(T, source, target),
            source_centroid=source.origin,
            covariance=of_features(source.points, n_agreeing) if is_confirmed else belief.covariance,
            status=Status.CONVERGED,
            rmse=rmse,
            n_pairs=n_agreeing,
            n_iterations=self.max_iterations,
        )

    def _optimise(self, source: FeatureCloud, target: FeatureCloud, pairs: Correspondences, lift: float) -> Transform:
        """Give the motion between the clouds' origins."""
        open3d = load_open3d(self.name)
        open3d.utility.random.seed(self.seed)  # a pair's triples do not depend on the pairs before it
        option = open3d.pipelines.registration.FastGlobalRegistrationOption(
            division_factor=self.division,
            use_absolute_scale=False,
            decrease_mu=self.narrows,
            maximum_correspondence_distance=self.max_distance,
            iteration_number=self.max_iterations,
            tuple_scale=self.tuple_scale,
            maximum_tuple_count=self.max_tuples,
        )
        found = open3d.pipelines.registration.registration_fgr_based_on_correspondence(
            _flat(open3d, source.thinned),
            _flat(open3d, target.thinned),
            open3d.utility.Vector2iVector(pairs.astype(np.int32)),
            option,
        )
        T = np.array(found.transformation)
        return se3.from_yaw(se3.yaw(T), np.array([T[0, 3], T[1, 3], lift]))


def _flat(open3d: Any, points: Points) -> Any:
    """Drop z: the fork's constraint, under which the optimum has neither tilt nor lift."""
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points * [1.0, 1.0, 0.0]))
