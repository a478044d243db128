"""Names to estimators: the centroid filter, and every registration method by its own name."""

import registration
from registration.registry import load_class, with_seed
from tracker.errors import InputError, UnknownEstimatorError
from tracker.estimators.centroid_kalman import CentroidKalman
from tracker.estimators.contract import Estimator
from tracker.estimators.registration import RegistrationEstimator
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean

ADH = ("adh-2d", "adh-3d", "adh-3d-tuned")  # registration methods whose estimator is a filter of its own
FUSED = "fused"
CAUSAL = "causal"
SMOOTHINGS = (CAUSAL, "window", "rts", "lag1", "lag2", "lag3")


def estimator_names() -> list[str]:
    """List the names that `create_estimator` knows."""
    return sorted({CentroidKalman.name, FUSED, *registration.names()})


def create_estimator(name: str, smoothing: Smoothing | None = None, seed: int = 0) -> Estimator:
    """Make an estimator from its name.

    Args:
        name: `centroid-kf`, `fused`, or a registration method's name.
        smoothing: what its `smooth` does; a window of w = 1 unless said.
        seed: for methods that draw random numbers.

    Raises:
        UnknownEstimatorError: no estimator and no registration method has that name.
        RegistrationError: the method cannot be created; the message says why.
    """
    if name == CentroidKalman.name:
        return CentroidKalman(smoothing)
    if name == FUSED:
        from tracker.estimators.fused import FusedEstimator  # here: it loads torch

        return FusedEstimator(smoothing)
    if name not in registration.names():
        raise UnknownEstimatorError(name, estimator_names())
    if name in ADH:
        from tracker.estimators.adh import AdhEstimator  # here: it loads numba

        return AdhEstimator(load_class(name)(), smoothing)
    return RegistrationEstimator(with_seed(registration.create(name), seed), smoothing)


def create_smoothing(name: str, half_width: int = 1) -> Smoothing:
    """Make a smoothing from its name in SMOOTHINGS; `causal` has none.

    Raises:
        InputError: no such smoothing, or a negative window.
    """
    if name == "window" and half_width >= 0:
        return WindowMean(half_width)
    if name == "rts":
        return RauchTungStriebel()
    if name.startswith("lag") and name in SMOOTHINGS:
        return FixedLag(int(name.removeprefix("lag")))
    what = f"a window of {half_width}" if name == "window" else f"smoothing {name!r}"
    raise InputError(f"there is no {what}; expected one of {', '.join(SMOOTHINGS)}, and a window of 0 or more")
