"""One method after another: the answer of the first is where the second starts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import ArrayLike

from registration.method import prepare_seen_from
from registration.registry import create
from registration.types import MotionPrior, RegistrationMethod, RegistrationResult, Status

LOST = (Status.NO_OVERLAP, Status.TOO_FEW_POINTS)  # the second found nothing to work on


@dataclass(frozen=True)
class Refined:
    """A method whose answer another one refines: itself a method, named `first+second`.

    The second gets the first's motion and covariance as its prior, also where the first abstains: its fallback is
    the best start there is, and the status is then the second's.  Where the second finds no overlap or too few
    points, the first's motion and covariance stand, with the second's status.

    Source: AlignNet-3D (3DV 2019), section 4.2, where every global answer is refined by ICP.
    """

    first: RegistrationMethod
    second: RegistrationMethod

    @property
    def name(self) -> str:
        """Both names, in the order of work."""
        return f"{self.first.name}+{self.second.name}"

    @property
    def wants_sensors(self) -> bool:
        """Whether one of the two looks at clouds from where the sensor was."""
        return any(getattr(method, "wants_sensors", False) for method in (self.first, self.second))

    def prepare(self, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None = None) -> list[Any]:
        """Prepare each cloud for both methods; see `method.prepare_seen_from` for the sensors.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
        """
        first, second = (prepare_seen_from(method, clouds, sensors) for method in (self.first, self.second))
        return list(zip(first, second, strict=True))

    def align(
        self, pairs: Sequence[tuple[Any, Any]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Align all pairs by the first method, then all by the second.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        found = self.first.align([(source[0], target[0]) for source, target in pairs], priors)
        starts = [MotionPrior(result.motion_about(result.source_centroid), result.covariance) for result in found]
        refined = self.second.align([(source[1], target[1]) for source, target in pairs], starts)
        return [_merge(before, after) for before, after in zip(found, refined, strict=True)]

    def register(self, source: ArrayLike, target: ArrayLike, prior: MotionPrior | None = None) -> RegistrationResult:
        """Register one pair of (N, 3) clouds [m].

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
        """
        a, b = self.prepare([source, target])
        return self.align([(a, b)], [prior])[0]


def refined(method: str | RegistrationMethod, by: str | RegistrationMethod = "icp") -> Refined:
    """Let one method refine the answers of another.

    Args:
        method: name or instance of the one that searches.
        by: name or instance of the one that refines; it should use the mean of its prior as its start.

    >>> refined("centroid").name
    'centroid+icp'

    Raises:
        RegistrationError, TypeError: see `registration.create`.
    """
    return Refined(create(method), create(by))


def _merge(before: RegistrationResult, after: RegistrationResult) -> RegistrationResult:
    return replace(before, status=after.status) if after.status in LOST else after
