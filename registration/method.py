"""The shell around methods that align one pair at a time: checks at the door, batches by a plain loop."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from registration import uncertainty
from registration.errors import InvalidCloudError
from registration.types import MotionPrior, Point, Points, RegistrationMethod, RegistrationResult, Status


class PairMethod(ABC):
    """A registration method whose author only writes `prepare_cloud` and `align_pair`.

    Subclasses are frozen dataclasses; their fields are their settings.  A method that gains from seeing many
    pairs at once overrides `align`.
    """

    name: ClassVar[str]

    @abstractmethod
    def prepare_cloud(self, points: Points) -> Any:
        """Do what depends on one cloud only; `points` is checked, finite and may be empty."""

    @abstractmethod
    def align_pair(self, source: Any, target: Any, prior: MotionPrior | None) -> RegistrationResult:
        """Register two prepared clouds."""

    def prepare(self, clouds: Sequence[ArrayLike]) -> list[Any]:
        """Check each (N, 3) cloud and prepare it.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
        """
        return [self.prepare_cloud(check_cloud(cloud)) for cloud in clouds]

    def align(
        self, pairs: Sequence[tuple[Any, Any]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Register prepared (source, target) pairs, one after the other.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        priors = one_prior_a_pair(pairs, priors)
        return [self.align_pair(a, b, prior) for (a, b), prior in zip(pairs, priors, strict=True)]

    def register(self, source: ArrayLike, target: ArrayLike, prior: MotionPrior | None = None) -> RegistrationResult:
        """Register one pair of (N, 3) clouds [m].

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
        """
        a, b = self.prepare([source, target])
        return self.align([(a, b)], [prior])[0]


def one_prior_a_pair(pairs: Sequence[Any], priors: Sequence[MotionPrior | None] | None) -> Sequence[MotionPrior | None]:
    """Give the priors that go with pairs: those of the caller, or none for any pair.

    Raises:
        ValueError: there are priors, but not one a pair.
    """
    if priors is None:
        return [None] * len(pairs)
    if len(priors) != len(pairs):
        raise ValueError(f"align got {len(pairs)} pairs but {len(priors)} priors; expected one a pair")
    return priors


def prepare_seen_from(
    method: RegistrationMethod, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None
) -> list[Any]:
    """Prepare clouds, and tell where each was seen from to a method that says that it wants to know.

    Such a method has `wants_sensors = True` and a second argument of `prepare`; clouds whose origin is not the
    sensor (world axes) need it.

    Args:
        method: any.
        clouds: (N, 3) each [m].
        sensors: (x, y) of the sensor for each cloud, in the same axes [m]; None: at the origin.
    """
    if sensors is not None and getattr(method, "wants_sensors", False):
        return method.prepare(clouds, sensors)  # type: ignore[call-arg]
    return method.prepare(clouds)


def check_cloud(cloud: ArrayLike) -> Points:
    """Give a cloud as a float64 (N, 3) array, or say what is wrong with it.

    Raises:
        InvalidCloudError: wrong shape, not numbers, or not finite.
    """
    try:
        points = np.asarray(cloud, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidCloudError(f"a cloud must be an (N, 3) array of numbers, got {cloud!r:.80}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidCloudError(f"a cloud must have shape (N, 3), got {points.shape}")
    if not np.isfinite(points).all():
        finite = np.isfinite(points).all(axis=1)
        bad = int((~finite).sum())
        first = int(np.argmin(finite))
        raise InvalidCloudError(
            f"a cloud must be finite, got {bad} of {len(points)} points with NaN or infinity, first at row {first}"
        )
    return points


def nothing_known(source_centroid: Point, status: Status) -> RegistrationResult:
    """Give the answer to a pair that says nothing: no motion, hardly any certainty, and the reason."""
    return RegistrationResult(
        T_target_source=np.eye(4),
        source_centroid=source_centroid,
        covariance=uncertainty.unknown(),
        status=status,
        rmse=float("nan"),
        n_pairs=0,
    )
