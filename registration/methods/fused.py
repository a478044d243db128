"""One motion out of two opinions: the network's and the histograms', weighed against each other, refined by shape."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from registration import planar
from registration.method import PairMethod, check_cloud, nothing_known, one_prior_a_pair, prepare_seen_from
from registration.refined import LOST
from registration.registry import create
from registration.types import (
    MotionPrior,
    PlanarCovariance,
    PlanarMotion,
    Point,
    Points,
    RegistrationMethod,
    RegistrationResult,
    Status,
)

ANYWHERE = 1.0 / (6.0 * 6.0 * 1.0)  # density of a shape search that found something else [1/(m^2 rad)]
TAIL = 3.0  # degrees of freedom of the network's errors, seen from a prior
VAGUE: PlanarCovariance = 1e6 * np.eye(3)  # of a prior that only says which of two opposite turns is meant
_ROUNDING = 1e-8  # so that a prior that claims certainty has an inverse [m^2, rad^2]
# What is left of the standard deviations of (x, y, yaw) after all: opinions that are doubted agree in the end.  Fitted
# on validation parts of generated pairs and on simulated training sequences: 95 % of errors in their 95 % regions.
SHARE = np.diag([0.63, 0.63, 0.77])
DOUBTED = np.linalg.inv(SHARE)  # of a prior's, so that it comes out as it was where nothing else is known


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud as each part of the method wants it.

    Attributes:
        n_points: number of points.
        centroid: their mean [m]; zero for an empty cloud.
        thin_centroid: mean of those that are left when it is thinned [m].
        learned: what the network makes of it.
        searched: what the histograms make of it.
        surface: what generalised ICP makes of it, thinned.
    """

    n_points: int
    centroid: Point
    thin_centroid: Point
    learned: Any
    searched: Any
    surface: Any


@dataclass(frozen=True)
class FusedRegistration(PairMethod):
    """Weigh the network's answer and the histograms', and let generalised ICP refine what both make likely.

    The network (AlignNet) sees turns and knows how objects look from elsewhere; annealed histograms see all shifts
    of an object that hardly turns, and do not depend on what a network was trained on.  Either the second agrees with
    the first, and both count by their covariances, or it found something else, and only the first counts: the
    belief is the mean and covariance of both cases, each as likely as the distance between the answers makes it.
    A prior is a third opinion, which always counts: the network counts less the more it contradicts it (Student's t).
    The belief is where the refinement starts, and what it falls back on.  Clouds are thinned for it: the thousands of
    points of a near object share their errors, and would overrule any belief.  Where there is nothing to refine, the
    belief is the answer, with the network's status.

    Source: the parts' (`alignnet`, `adh-3d`, `gicp`); the two cases: an outlier model as in Box & Tiao, "A Bayesian
    approach to some outlier problems", Biometrika 55(1), 1968.
    """

    name: ClassVar[str] = "fused"
    wants_sensors: ClassVar[bool] = True

    network: str = "alignnet"  # name of the method that gives the first opinion; alignnet-persons: of persons too, ...
    search: str = "adh-3d"  # ... of the one that gives the second, ...
    refinement: str = "gicp"  # ... and of the one that refines what they make likely
    doubt: float = 3.0  # factor of the covariances that both opinions claim
    apart: float = 0.5  # share of pairs where the histograms are expected to find something else
    max_points: int = 600  # of a cloud that take part in the refinement, evenly out of all

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load the libraries and weights.

        Raises:
            MissingLibraryError, WeightsError: see the parts.
        """
        if not self.doubt > 0.0:
            raise ValueError(f"doubt must be positive, got {self.doubt}")
        if not 0.0 < self.apart < 1.0:
            raise ValueError(f"apart must be between 0 and 1, got {self.apart}")
        if self.max_points < 1:
            raise ValueError(f"max_points must be at least 1, got {self.max_points}")
        _ = self._parts  # what cannot be loaded says so now

    @cached_property
    def _parts(self) -> tuple[RegistrationMethod, RegistrationMethod, RegistrationMethod]:
        return create(self.network), create(self.search), create(self.refinement)

    def prepare_cloud(self, points: Points) -> Cloud:
        """Prepare one cloud, seen from the origin."""
        return self.prepare([points])[0]

    def prepare(self, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None = None) -> list[Cloud]:
        """Check each (N, 3) cloud, and prepare all of them for each part.

        Args:
            clouds: in any axes with z up, if both clouds of a pair share them [m].
            sensors: where each cloud was seen from (x, y), in the same axes [m]; None: from the origin.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
            ValueError: there are sensors, but not one a cloud.
        """
        checked = [check_cloud(cloud) for cloud in clouds]
        thin = [_thinned(cloud, self.max_points) for cloud in checked]
        prepared = [
            prepare_seen_from(m, c, sensors) for m, c in zip(self._parts, (checked, checked, thin), strict=True)
        ]
        return [
            Cloud(len(cloud), _centroid(cloud), _centroid(left), *parts)
            for cloud, left, *parts in zip(checked, thin, *prepared, strict=True)
        ]

    def align(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Ask for both opinions of all pairs, then refine all of them.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        priors = one_prior_a_pair(pairs, priors)
        folds = [None if prior is None else MotionPrior(prior.mean, VAGUE) for prior in priors]
        network, search, refinement = self._parts
        learned = network.align([(a.learned, b.learned) for a, b in pairs], folds)
        searched = search.align([(a.searched, b.searched) for a, b in pairs])
        beliefs = [self._believe(*opinions) for opinions in zip(learned, searched, priors, strict=True)]
        starts = [_about(belief, a.thin_centroid) for belief, (a, _) in zip(beliefs, pairs, strict=True)]
        refined = refinement.align([(a.surface, b.surface) for a, b in pairs], starts)
        return [_result(*found) for found in zip(pairs, beliefs, refined, strict=True)]

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Align one pair."""
        return self.align([(source, target)], [prior])[0]

    def _believe(
        self, learned: RegistrationResult, searched: RegistrationResult, prior: MotionPrior | None
    ) -> RegistrationResult:
        """Give what the opinions make likely, with the network's status."""
        center = learned.source_centroid
        belief = MotionPrior(learned.motion_about(center), self.doubt * learned.covariance)
        if prior is not None:
            doubted = DOUBTED @ prior.covariance @ DOUBTED + _ROUNDING * np.eye(3)
            known = MotionPrior(prior.mean, doubted)
            belief, _ = multiply(_doubted(belief, known), known)
        covariance = self.doubt * searched.covariance
        covariance[2, 2] = searched.covariance[2, 2]  # no histogram's claim: how little objects turn
        belief = combine(belief, MotionPrior(searched.motion_about(center), covariance), self.apart)
        T = planar.to_transform(belief.mean, center, z=float(learned.T_target_source[2, 3]))
        return replace(learned, T_target_source=T, covariance=belief.covariance)


def combine(first: MotionPrior, second: MotionPrior, apart: float) -> MotionPrior:
    """Weigh two opinions of a motion of which the second may be of something else.

    Args:
        first, second: about the same centre.
        apart: how likely the second is of something else, before the opinions are compared.

    Returns:
        mean and covariance of both cases, that they agree and that the second is to be dropped.
    """
    both, log_density = multiply(first, second)
    log_odds = math.log(apart / (1.0 - apart) * ANYWHERE) - log_density  # of being apart
    agree = 1.0 / (1.0 + math.exp(min(log_odds, 700.0)))
    off = _difference(both.mean, first.mean)
    covariance = agree * both.covariance + (1.0 - agree) * first.covariance
    return MotionPrior(first.mean + agree * off, covariance + agree * (1.0 - agree) * np.outer(off, off))


def multiply(first: MotionPrior, second: MotionPrior) -> tuple[MotionPrior, float]:
    """Multiply two normal densities; give the product, and the log of how well they agree [1/(m^2 rad)]."""
    off = _difference(second.mean, first.mean)
    total = first.covariance + second.covariance
    gain = np.linalg.solve(total, first.covariance).T
    covariance = first.covariance - gain @ first.covariance
    log_density = -0.5 * float(off @ np.linalg.solve(total, off) + np.linalg.slogdet(2.0 * np.pi * total)[1])
    symmetric = 0.5 * (covariance + covariance.T) + _ROUNDING * np.eye(3)
    return MotionPrior(first.mean + gain @ off, symmetric), log_density


def _doubted(opinion: MotionPrior, known: MotionPrior) -> MotionPrior:
    """Widen an opinion that contradicts what is known, as Student's t weighs what is far off; else leave it."""
    off = _difference(opinion.mean, known.mean)
    distance = float(off @ np.linalg.solve(opinion.covariance + known.covariance, off))
    return MotionPrior(opinion.mean, max(1.0, (TAIL + distance) / (TAIL + len(off))) * opinion.covariance)


def _difference(motion: PlanarMotion, other: PlanarMotion) -> PlanarMotion:
    off = motion - other
    off[2] = planar.wrap(float(off[2]))
    return off


def _thinned(points: Points, most: int) -> Points:
    return points if len(points) <= most else points[:: math.ceil(len(points) / most)]


def _centroid(points: Points) -> Point:
    return points.mean(axis=0) if len(points) else np.zeros(3)


def _about(belief: RegistrationResult, center: Point) -> MotionPrior:
    return MotionPrior(belief.motion_about(center), belief.covariance_about(center))


def _result(pair: tuple[Cloud, Cloud], belief: RegistrationResult, refined: RegistrationResult) -> RegistrationResult:
    """Give the refined motion about the centroid of all points, or the belief where there was nothing to refine."""
    source, target = pair
    if min(source.n_points, target.n_points) == 0:
        return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
    found = belief if refined.status in LOST else refined
    covariance = SHARE @ found.covariance_about(source.centroid) @ SHARE
    return replace(found, source_centroid=source.centroid, covariance=covariance)
