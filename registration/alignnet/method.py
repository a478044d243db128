"""The network as a registration method: numpy clouds in, planar motions with covariances out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from registration.alignnet import answers, checkpoint, inference, inference_kernels
from registration.alignnet.answers import Answers
from registration.alignnet.inference import Encoding, Inference
from registration.alignnet.timing import PlainWay
from registration.belief import believe
from registration.method import PairMethod, check_cloud, nothing_known, one_prior_a_pair
from registration.types import MotionPrior, Point, Points, RegistrationResult, Status

BELIEVED_TURN = 0.1  # standard deviation of the turn where the network does not know it [rad]
DOUBT = 2.0  # factor of the centroids' covariance where the network was asked and does not know


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud and what the network knows of it.

    Attributes:
        points: as they came [m].
        centroid: their mean [m]; zero for an empty cloud.
        encodings: as a source, and as a target, relative to the centroid; none where there are too few points.
    """

    points: Points
    centroid: Point
    encodings: tuple[Encoding, Encoding] | None


@dataclass(frozen=True)
class LearnedRegistration(PairMethod):
    """Ask AlignNet-3D: each cloud is encoded once, and what it takes to compare two encodings is small.

    A prior is fused with the answer, each weighted by its covariance.  Where the network is not sure of the motion,
    or contradicts the clouds, the centroids' motion (or the prior's) stands in, with the status NOT_CONVERGED.

    Source: Gross, Osep & Leibe, "AlignNet-3D: Fast point cloud registration of partially observed objects",
    3DV 2019.
    """

    name: ClassVar[str]
    wants_sensors: ClassVar[bool] = True

    weights: str = ""  # path of a weights file; empty: those that come with the package
    precision: str = "auto"  # float32, bfloat16; auto: bfloat16 where the CPU knows it
    max_points: int = 256  # of a cloud that are looked at, evenly out of all
    min_points: int = 3  # smaller clouds say nothing
    max_spread: float = 1.5  # standard deviation of the shift beyond which the network does not know [m]
    max_offset: float = 8.0  # the object's centre cannot be farther than this from the mean of its points [m]
    fold_turn: bool = True  # between two clouds an object turns by less than 90 degrees; False: front and back differ

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load the weights.

        Raises:
            WeightsError: there are none, or they cannot be used.
        """
        if not 1 <= self.min_points <= self.max_points:
            raise ValueError(f"expected 1 <= min_points <= max_points, got {self.min_points} and {self.max_points}")
        _ = self._loaded  # loads them

    def __getstate__(self) -> dict[str, object]:
        """Leave out what oneDNN has laid out, which nothing can copy: a copy loads the weights itself."""
        return {name: value for name, value in vars(self).items() if name != "_loaded"}

    def prepare_cloud(self, points: Points) -> Cloud:
        """Encode one cloud, seen from the origin."""
        return self.prepare([points])[0]

    def prepare(self, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None = None) -> list[Cloud]:
        """Check each (N, 3) cloud, and encode all of them at once.

        Args:
            clouds: in any axes with z up, if both clouds of a pair share them [m].
            sensors: where each cloud was seen from (x, y), in the same axes [m]; None: from the origin.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
            ValueError: there are sensors, but not one a cloud.
        """
        checked = [check_cloud(cloud) for cloud in clouds]
        places = np.zeros((len(checked), 2)) if sensors is None else np.asarray(sensors, dtype=np.float64)
        if places.size == 0:  # of no clouds
            places = places.reshape(0, 2)
        if places.shape != (len(checked), 2):
            raise ValueError(f"expected the sensor's (x, y) for each of {len(checked)} clouds, got {places.shape}")
        means = np.array([cloud.mean(axis=0) if len(cloud) else np.zeros(3) for cloud in checked]).reshape(-1, 3)
        return self.encode(checked, means, places)

    def encode(
        self, clouds: Sequence[Points], means: Float64[np.ndarray, "b 3"], sensors: Float64[np.ndarray, "b 2"]
    ) -> list[Cloud]:
        """Do `prepare` for clouds that are known to be arrays of finite numbers, and whose means are known [m]."""
        told = [k for k, cloud in enumerate(clouds) if len(cloud) >= self.min_points]
        encodings: list[tuple[Encoding, Encoding] | None] = [None] * len(clouds)
        if told:
            own, (networks, _) = [clouds[k] for k in told], self._loaded
            by_branch = [network.encode(own, means[told], sensors[told], self.max_points) for network in networks]
            for k, source, target in zip(told, by_branch[0], by_branch[-1], strict=True):
                encodings[k] = source, target
        return list(map(Cloud, clouds, means, encodings))

    def align(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Compare all pairs at once.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        priors = one_prior_a_pair(pairs, priors)
        told = [k for k, pair in enumerate(pairs) if pair[0].encodings and pair[1].encodings]
        answered = {}
        if told:
            found = self._answer([pairs[k] for k in told], [priors[k] for k in told])
            answered = dict(zip(told, found, strict=True))
        return [
            answered[k] if k in answered else _fallback(pair, prior, Status.TOO_FEW_POINTS)
            for k, (pair, prior) in enumerate(zip(pairs, priors, strict=True))
        ]

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Compare one pair."""
        return self.align([(source, target)], [prior])[0]

    def compare(
        self, pairs: Sequence[tuple[Cloud, Cloud]], turns: Float64[np.ndarray, " n"] | None = None
    ) -> tuple[Answers, Bool[np.ndarray, " n"]]:
        """Ask the network about pairs of clouds that it has encoded (see `Cloud.encodings`), all answers in one piece.

        Args:
            pairs: n of them, one at least.
            turns: that are expected [rad], where front and back do not differ; None: none.

        Returns:
            answers, and where the network does not know, or contradicts the clouds (n).

        Raises:
            ValueError: a cloud has too few points for it to have been encoded.
        """
        networks, about = self._loaded
        known = [(a.encodings[0], b.encodings[1]) for a, b in pairs if a.encodings and b.encodings]
        if len(known) < len(pairs):
            raise ValueError(
                f"expected clouds of {self.min_points} points or more, got {len(pairs) - len(known)} smaller"
            )
        sources, targets = zip(*known, strict=True)
        found = networks[0].align(sources, targets, about.covariance_scale)
        expected = np.zeros(len(pairs)) if turns is None else turns
        limits = float(self.max_offset), float(self.max_spread)
        return found, inference_kernels.judge(found.motions, found.covariance, expected, self.fold_turn, *limits)

    def center(self, cloud: Cloud) -> Point | None:
        """Say where the network believes the object's centre [m]; None where there are too few points to tell."""
        return cloud.centroid + cloud.encodings[0].pose[:3] if cloud.encodings else None

    def plain_way(self) -> PlainWay:
        """Give the same weights run as published, to be timed beside this."""
        return PlainWay(checkpoint.read_weights(self._path)[0])

    @cached_property
    def _path(self) -> Path:
        return Path(self.weights) if self.weights else checkpoint.shipped(self.name)

    @cached_property
    def _loaded(self) -> tuple[list[Inference], checkpoint.About]:
        return inference.load(self._path, self.precision)

    def _answer(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None]
    ) -> list[RegistrationResult]:
        """Compare pairs of encoded clouds, and judge what the network says of them."""
        found, is_doubtful = self.compare(pairs, np.array([0.0 if p is None else p.mean[2] for p in priors]))
        sources, targets = (np.stack([pair[side].centroid for pair in pairs]) for side in (0, 1))
        results = answers.results(found, [(a.points, b.points) for a, b in pairs], sources, targets)
        for k, (pair, prior) in enumerate(zip(pairs, priors, strict=True)):
            if is_doubtful[k]:
                results[k] = _fallback(pair, prior, Status.NOT_CONVERGED)
            elif prior is not None:
                results[k] = answers.fused(results[k], prior)
        return results


class AlignNetCars(LearnedRegistration):
    """The network for cars and vans."""

    name: ClassVar[str] = "alignnet"


class AlignNetPersons(LearnedRegistration):
    """The network for cars and persons."""

    name: ClassVar[str] = "alignnet-persons"


def _fallback(pair: tuple[Cloud, Cloud], prior: MotionPrior | None, status: Status) -> RegistrationResult:
    """Give the centroids' motion, or the prior's, where the network does not know."""
    source, target = pair
    if len(source.points) == 0 or len(target.points) == 0:
        return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
    belief = believe(source.points, target.points, prior, BELIEVED_TURN)
    return belief.result(status, DOUBT if status is Status.NOT_CONVERGED and prior is None else 1.0)
