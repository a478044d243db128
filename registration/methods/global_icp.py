"""Global registration by features and RANSAC: the motion that most feature correspondences agree on, no start."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import planar, uncertainty
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

BATCH = 4096  # samples drawn at once
MAX_SCORED = 256  # hypotheses of a batch whose inliers are counted
MAX_KEPT = 50  # best hypotheses that are fitted to their inliers
MAX_COMPARED = 10  # of those that differ, whose misfit is compared
ALIKE = (0.05, 0.05, 0.03, 0.05)  # side of a cell of motions (x, y, yaw, z) that count as one [m, m, rad, m]

Samples = Float64[np.ndarray, "_ _ 3"]  # points of many samples [m]
Motions = Float64[np.ndarray, "_ 4"]  # (x, y, yaw, z) about the origin


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Motions between the clouds' origins, and how many correspondences agree with each."""

    motions: Motions
    n_inliers: Int64[np.ndarray, " _"]


@dataclass(frozen=True)
class GlobalICP(FeatureMethod):
    """Draw small samples of feature correspondences, move by each, keep the motion that most of them agree on.

    Features and correspondences are Open3D's (`registration.features`); the sampling is ours, since Open3D's
    estimates six degrees of freedom: here each sample gives a planar motion and a lift.  The best hypotheses are
    fitted to their inliers, and the one that brings the clouds closest together wins.  An answer that
    does not explain the clouds (`doubt`) is dropped for the belief, with a status.

    Source: Rusu, Blodow & Beetz, ICRA 2009 (SAC-IA); Fischler & Bolles, "Random sample consensus", CACM 24(6),
    1981; Chum, Matas & Kittler, "Locally optimized RANSAC", DAGM 2003; parameters of AlignNet-3D (3DV 2019),
    whose program allowed 4e6 samples but only 500 evaluations; here it is the confidence that ends the search.
    """

    name: ClassVar[str] = "global-icp"

    n_samples: int = 4  # correspondences that make a hypothesis
    edge_similarity: float = 0.9  # of the distances within a sample, source to target, both ways
    max_distance: float = 0.075  # of a correspondence that agrees [m]
    max_iterations: int = 100_000  # samples drawn, at most
    confidence: float = 0.999  # stop when a better motion would have been found with this probability, ...
    min_hypotheses: int = 20  # ... but not before this many samples have passed the tests of edges and of distance
    height_tolerance: float = 0.05  # correspondences differ no more than this from their common lift [m]
    believed_turn: float = 0.1  # standard deviation of the turn of the belief, without a prior [rad]
    seed: int = 0  # of every pair's own random numbers
    features: FeatureSettings = field(default_factory=FeatureSettings)
    doubt: Doubt = field(default_factory=Doubt)

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load Open3D."""
        if self.n_samples < 2:
            raise ValueError(f"n_samples must be at least 2, got {self.n_samples}")
        for name in ("max_distance", "height_tolerance", "believed_turn"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("max_iterations", "min_hypotheses"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence must be between 0 and 1, got {self.confidence}")
        load_open3d(self.name)

    def search(self, source: FeatureCloud, target: FeatureCloud, belief: Belief) -> RegistrationResult:
        """Draw samples of correspondences, and keep the motion that explains the clouds best."""
        if min(len(source.thinned), len(target.thinned)) < self.n_samples:
            return belief.result(Status.TOO_FEW_POINTS)
        pairs, _ = correspond(source, target, self.height_tolerance, self.name)
        hypotheses, n_drawn = self._sample(source.thinned[pairs[:, 0]], target.thinned[pairs[:, 1]])
        if len(hypotheses.motions) == 0:
            return belief.result(Status.NOT_CONVERGED)
        T = self._choose(hypotheses, source, target, pairs)
        n_agreeing, rmse = agreement(T, source, target, pairs, self.max_distance)
        if n_agreeing <= self.n_samples:  # a sample agrees with itself; somebody else must too
            return belief.result(Status.NOT_CONVERGED)
        if not self.doubt.admits(from_origins(T, source, target), source, target, belief):
            return belief.result(Status.NO_OVERLAP)
        return RegistrationResult(
            T_target_source=from_origins(T, source, target),
            source_centroid=source.origin,
            covariance=uncertainty.of_features(source.points, n_agreeing),
            status=Status.CONVERGED,
            rmse=rmse,
            n_pairs=n_agreeing,
            n_iterations=n_drawn,
        )

    def _sample(self, source: Points, target: Points) -> tuple[Hypotheses, int]:
        """Draw samples of corresponding points until the confidence is reached; give the best hypotheses."""
        best = Hypotheses(np.empty((0, 4)), np.empty(0, dtype=np.int64))
        n_drawn, n_passed, n_needed = 0, 0, float(self.max_iterations)
        batches = self._batches(len(source))
        while n_drawn < min(n_needed, self.max_iterations):
            rows = next(batches, None)
            if rows is None:  # fewer correspondences than a sample takes
                break
            n_drawn += len(rows)
            motions = self._hypothesise(source[rows], target[rows])
            inliers = count_inliers(motions, source, target, self.max_distance)
            best = keep_best(Hypotheses(np.vstack([best.motions, motions]), np.append(best.n_inliers, inliers)))
            n_passed += len(motions)
            if n_passed >= self.min_hypotheses:
                n_needed = samples_needed(best.n_inliers[0] / len(source), self.n_samples, self.confidence)
        return best, n_drawn

    def _batches(self, n: int) -> Iterator[Int64[np.ndarray, "b k"]]:
        """Draw rows of samples out of n correspondences, the same for every pair of that size."""
        rng = np.random.default_rng(self.seed)
        while n >= self.n_samples:
            yield rng.integers(0, n, (BATCH, self.n_samples))

    def _hypothesise(self, source: Samples, target: Samples) -> Motions:
        """Turn samples into motions; drop those whose edges or whose fit disagree."""
        alike = edges_agree(source, target, self.edge_similarity)
        source, target = source[alike], target[alike]
        motions = fit_planar(source, target)
        off = apply(motions, source) - target
        fits = ((off**2).sum(axis=2) < self.max_distance**2).all(axis=1)
        return motions[fits][:MAX_SCORED]

    def _choose(
        self, hypotheses: Hypotheses, source: FeatureCloud, target: FeatureCloud, pairs: Correspondences
    ) -> Transform:
        """Fit the best hypotheses to their inliers; of the fits that differ, take the one with the least misfit."""
        a, b = source.thinned[pairs[:, 0]], target.thinned[pairs[:, 1]]
        fitted = np.vstack([fit_to_inliers(motion, a, b, self.max_distance) for motion in hypotheses.motions])
        candidates = [to_transform(motion) for motion in distinct(fitted)[:MAX_COMPARED]]
        misfits = [self.doubt.misfit(from_origins(T, source, target), source, target) for T in candidates]
        return candidates[int(np.argmin(misfits))]


def edges_agree(source: Samples, target: Samples, similarity: float) -> Bool[np.ndarray, " n"]:
    """Say which samples have edges of like length in both clouds; coincident points have no edge and never do."""
    first, second = np.array(list(combinations(range(source.shape[1]), 2))).T
    a = np.linalg.norm(source[:, first] - source[:, second], axis=2)
    b = np.linalg.norm(target[:, first] - target[:, second], axis=2)
    return ((a >= similarity * b) & (b >= similarity * a) & (a > 0.0)).all(axis=1)


def fit_planar(source: Samples, target: Samples) -> Motions:
    """Find for each sample the planar motion and lift that bring its points closest to their partners.

    `planar.align_pairs`, many at once; the lift is the mean difference in z.
    """
    source_mean, target_mean = source.mean(axis=1), target.mean(axis=1)
    a, b = source - source_mean[:, None], target - target_mean[:, None]
    dot = (a[..., :2] * b[..., :2]).sum(axis=(1, 2))
    cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    yaw = np.arctan2(cross, dot)
    turned = apply(np.column_stack([np.zeros((len(yaw), 2)), yaw, np.zeros(len(yaw))]), source_mean[:, None])[:, 0]
    shift = target_mean - turned
    return np.column_stack([shift[:, 0], shift[:, 1], yaw, shift[:, 2]])


def apply(motions: Motions, points: Samples) -> Samples:
    """Move the points of row i by motion i; one row of points is moved by all motions."""
    c, s = np.cos(motions[:, 2])[:, None], np.sin(motions[:, 2])[:, None]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    moved = (c * x - s * y + motions[:, 0, None], s * x + c * y + motions[:, 1, None], z + motions[:, 3, None])
    return np.stack(moved, axis=-1)


def count_inliers(motions: Motions, source: Points, target: Points, reach: float) -> Int64[np.ndarray, " n"]:
    """Count for each motion the correspondences that it brings within reach [m]."""
    off = apply(motions, source[None]) - target
    return ((off**2).sum(axis=2) < reach**2).sum(axis=1)


def fit_to_inliers(motion: Float64[np.ndarray, "4"], source: Points, target: Points, reach: float) -> Motions:
    """Fit a motion to the correspondences that it brings within reach [m]: Chum, Matas & Kittler's local step."""
    off = apply(motion[None], source[None])[0] - target
    within = (off**2).sum(axis=1) < reach**2
    return fit_planar(source[within][None], target[within][None])


def distinct(motions: Motions) -> Motions:
    """Drop motions that are much like an earlier one."""
    cells = np.round(motions / ALIKE)
    _, first = np.unique(cells, axis=0, return_index=True)
    return motions[np.sort(first)]


def keep_best(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the few hypotheses with the most inliers; the earlier one of equals."""
    order = np.argsort(-hypotheses.n_inliers, kind="stable")[:MAX_KEPT]
    return Hypotheses(hypotheses.motions[order], hypotheses.n_inliers[order])


def samples_needed(share: float, n_samples: int, confidence: float) -> float:
    """Say how many samples find one without an outlier at that confidence: Fischler & Bolles, section II.B.

    >>> round(samples_needed(0.5, 4, 0.999))
    107
    """
    all_good = share**n_samples
    return 0.0 if all_good >= 1.0 else float(np.log(1.0 - confidence) / np.log1p(-all_good))


def to_transform(motion: Float64[np.ndarray, "4"]) -> Transform:
    """Write (x, y, yaw, z) about the origin as a transform."""
    return planar.to_transform(motion[:3], np.zeros(3), z=float(motion[3]))
