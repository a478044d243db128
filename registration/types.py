"""What goes into a registration and what comes out of it: the vocabulary of the plug-in contract."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from registration import planar, se3

Points = Float64[np.ndarray, "_ 3"]  # metres; "_" because two clouds need not be equally long
Point = Float64[np.ndarray, "3"]
Transform = Float64[np.ndarray, "4 4"]  # T_dst_src: p_dst = T_dst_src @ p_src
PlanarMotion = Float64[np.ndarray, "3"]  # (x, y, yaw) [m, m, rad] about a stated centre
PlanarCovariance = Float64[np.ndarray, "3 3"]  # of a PlanarMotion, same order


class Status(str, Enum):
    """How a registration ended; anything but CONVERGED is an abstention and is counted as one."""

    CONVERGED = "converged"
    TOO_FEW_POINTS = "too-few-points"
    NO_OVERLAP = "no-overlap"
    NOT_CONVERGED = "not-converged"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """What is known of the motion before the clouds are looked at.

    Attributes:
        mean: expected motion (x, y, yaw) about the source centroid [m, m, rad].
        covariance: of the mean, in the same order.
    """

    mean: PlanarMotion
    covariance: PlanarCovariance


@dataclass(frozen=True, slots=True)
class RegistrationResult:
    """Where the source cloud lies in the target's frame, and how far to trust the answer.

    Attributes:
        T_target_source: maps source coordinates to target coordinates: a turn about z and a shift.
            Always a best guess, also when the status says that it is no more than that.
        source_centroid: mean of the source cloud (source frame) [m]: the centre that `covariance` refers to.
        covariance: of the motion (x, y, yaw) about the source centroid [m, m, rad].
        status: anything but CONVERGED is counted as a failure by `evaluation`, never dropped.
        rmse: root-mean-square distance of the paired points [m]; NaN when there are no pairs.
        n_pairs: number of source points that found a partner in the target.
        n_iterations: how often the method updated the motion; 0 for closed forms.
    """

    T_target_source: Transform
    source_centroid: Point
    covariance: PlanarCovariance
    status: Status
    rmse: float
    n_pairs: int
    n_iterations: int = 0

    def motion_about(self, center: Point) -> PlanarMotion:
        """Give the motion (x, y, yaw) about a centre: (x, y) is that point's own displacement [m, m, rad]."""
        return planar.motion_about(self.T_target_source, center)

    def covariance_about(self, center: Point) -> PlanarCovariance:
        """Carry the covariance from the source centroid to another centre of rotation."""
        yaw = se3.yaw(self.T_target_source)
        return planar.transport_covariance(self.covariance, yaw, self.source_centroid[:2], center[:2])


@runtime_checkable
class RegistrationMethod(Protocol):
    """Two clouds in, one planar motion out; `conformance.check_method` proves that a class keeps this contract.

    `prepare` does what depends on one cloud only (trees, normals, features) and is paid once per cloud;
    `align` takes any pairs of prepared clouds at once; `register` is the one-pair case of both.
    Hard data gives a `Status`; wrong input (shape, NaN) raises `InvalidCloudError`.
    """

    @property
    def name(self) -> str:
        """The name that tables print and `registration.create` knows."""

    def prepare(self, clouds: Sequence[ArrayLike]) -> list[Any]:
        """Turn (N, 3) clouds into whatever `align` wants of them."""

    def align(
        self, pairs: Sequence[tuple[Any, Any]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Register prepared (source, target) pairs; one result a pair, in order."""

    def register(self, source: ArrayLike, target: ArrayLike, prior: MotionPrior | None = None) -> RegistrationResult:
        """Register one pair of (N, 3) clouds."""
