"""Prove that a registration method keeps the plug-in contract: for our own methods, and for outside authors'."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from registration import se3
from registration.errors import InvalidCloudError, MethodContractError
from registration.types import MotionPrior, Points, RegistrationMethod, RegistrationResult, Status


def check_method(method: Any) -> None:
    """Run a method through every promise of the contract; return quietly when it keeps them all.

    Promises: it has a name; results are planar rigid motions with a symmetric, positive semi-definite, finite
    covariance; a small known motion is found; the same input gives the same result; `register` is the one-pair
    case of `prepare` and `align`; pairs of a batch do not influence each other; a prior is accepted; inputs stay
    as they were; few, coincident or no points give a status, never an exception and never a leap; NaN and wrong
    shapes raise `InvalidCloudError`.

    Raises:
        MethodContractError: the first promise that is broken, and how.
    """
    _promise(isinstance(method, RegistrationMethod), "it has name, prepare, align and register")
    _promise(isinstance(method.name, str) and bool(method.name), "its name is a non-empty string")
    for check in _CHECKS:
        try:
            check(method)
        except MethodContractError as error:
            raise MethodContractError(f"{method.name}: {error}") from None


def _finds_a_small_motion(method: RegistrationMethod) -> None:
    source, target, T = _scene(seed=1)
    result = method.register(source, target)
    _check_result(result, source)
    error = result.motion_about(source.mean(axis=0)) - _motion(T, source)
    _promise(
        np.hypot(*error[:2]) < 0.3,
        f"a car moved by 0.4 m is found to 0.3 m, got an error of {np.hypot(*error[:2]):.2f} m",
    )
    _promise(result.status is Status.CONVERGED, f"an easy pair converges, got {result.status}")


def _repeats_itself(method: RegistrationMethod) -> None:
    source, target, _ = _scene(seed=2)
    before = source.copy(), target.copy()
    first, second = method.register(source, target), method.register(source, target)
    _promise(_same(first, second), "the same input gives the same result")
    untouched = np.array_equal(source, before[0]) and np.array_equal(target, before[1])
    _promise(untouched, "inputs are never changed")


def _aligns_batches(method: RegistrationMethod) -> None:
    scenes = [_scene(seed)[:2] for seed in (3, 4)]
    alone = [method.register(source, target) for source, target in scenes]
    (a, b), (c, d) = (method.prepare(pair) for pair in scenes)
    together = method.align([(c, d), (a, b)])
    _promise(len(together) == 2, f"align gives one result a pair, got {len(together)} for 2")
    _promise(
        _same(together[0], alone[1]) and _same(together[1], alone[0]),
        "pairs of a batch do not influence each other, and register is the one-pair case",
    )
    _promise(list(method.align([])) == [], "an empty batch gives an empty list")


def _accepts_a_prior(method: RegistrationMethod) -> None:
    source, target, T = _scene(seed=5)
    prior = MotionPrior(_motion(T, source), np.diag([0.1, 0.1, 0.05]) ** 2)
    _check_result(method.register(source, target, prior), source)


def _survives_poor_clouds(method: RegistrationMethod) -> None:
    good, _, _ = _scene(seed=6)
    one, pair, same = good[:1], good[:2], np.repeat(good[:1], 20, axis=0)
    line = np.linspace([10.0, 0.0, 0.5], [12.0, 0.0, 0.5], 30)
    for cloud in (good[:0], one, pair, same, line):
        for source, target in ((cloud, cloud), (cloud, good), (good, cloud)):
            result = method.register(source, target)
            _check_result(result, source)
            n = min(len(source), len(target))
            _promise(n > 0 or result.status is not Status.CONVERGED, "an empty cloud is no success")
            reach = np.hypot(*result.motion_about(_center(source))[:2])
            _promise(reach < 10.0, f"poor clouds cause no leap, got one of {reach:.0f} m")


def _refuses_wrong_input(method: RegistrationMethod) -> None:
    good, _, _ = _scene(seed=7)
    bent = good.copy()
    bent[3, 1] = np.nan
    for wrong, what in ((bent, "NaN"), (good.T, "shape (3, N)"), (good[:, :2], "shape (N, 2)")):
        for source, target in ((wrong, good), (good, wrong)):
            _promise_raises(partial(method.register, source, target), what)


_CHECKS: tuple[Callable[[RegistrationMethod], None], ...] = (
    _finds_a_small_motion,
    _repeats_itself,
    _aligns_batches,
    _accepts_a_prior,
    _survives_poor_clouds,
    _refuses_wrong_input,
)


def _check_result(result: Any, source: Points) -> None:
    _promise(isinstance(result, RegistrationResult), f"results are RegistrationResult, got {type(result)}")
    T, covariance = result.T_target_source, result.covariance
    _promise(T.shape == (4, 4) and np.isfinite(T).all(), "T_target_source is a finite 4x4 matrix")
    R = T[:3, :3]
    _promise(np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0, "its rotation is one")
    _promise(abs(R[2, 2] - 1.0) < 1e-12, "it turns about z only")
    _promise(covariance.shape == (3, 3) and np.isfinite(covariance).all(), "covariance is a finite 3x3")
    _promise(np.allclose(covariance, covariance.T), "the covariance is symmetric")
    _promise(np.linalg.eigvalsh(covariance).min() > -1e-12, "the covariance is positive semi-definite")
    _promise(np.linalg.eigvalsh(covariance[:2, :2]).min() > 0.0, "no shift is known exactly, in any direction")
    _promise(isinstance(result.status, Status), f"status is a Status, got {result.status!r}")
    if len(source):
        at_centroid = np.allclose(result.source_centroid, source.mean(axis=0), atol=1e-6)
        _promise(at_centroid, "source_centroid is the mean of the source")


def _scene(seed: int) -> tuple[Points, Points, np.ndarray]:
    """Sample two sides of a car-sized box twice, the second time moved by 0.4 m and 2 degrees."""
    rng = np.random.default_rng(seed)
    T_target_source = se3.from_yaw(np.deg2rad(2.0), np.zeros(3))
    start = np.array([12.0, 4.0, 0.0])
    T_target_source[:3, 3] = start + [0.35, 0.2, 0.0] - T_target_source[:3, :3] @ start

    def sample() -> Points:
        n = 400
        side = rng.integers(0, 2, n)[:, None]
        along, up = rng.uniform(-1, 1, (n, 1)), rng.uniform(0, 1.4, (n, 1))
        long_side = np.hstack([2.2 * along, np.full((n, 1), -0.9), up])
        rear = np.hstack([np.full((n, 1), -2.2), 0.9 * along, up])
        return np.where(side == 0, long_side, rear) + rng.normal(0.0, 0.01, (n, 3)) + start

    return sample(), se3.transform(T_target_source, sample()), T_target_source


def _motion(T: np.ndarray, source: Points) -> np.ndarray:
    center = source.mean(axis=0)
    return np.array([*(T[:3, :3] @ center + T[:3, 3] - center)[:2], se3.yaw(T)])


def _center(source: Points) -> np.ndarray:
    return source.mean(axis=0) if len(source) else np.zeros(3)


def _same(a: RegistrationResult, b: RegistrationResult) -> bool:
    return (
        np.allclose(a.T_target_source, b.T_target_source, atol=1e-12)
        and np.allclose(a.covariance, b.covariance, atol=1e-12)
        and a.status is b.status
    )


def _promise(kept: bool | np.bool_, promise: str) -> None:
    if not kept:
        raise MethodContractError(f"broken promise: {promise}")


def _promise_raises(action: Callable[[], object], what: str) -> None:
    try:
        action()
    except InvalidCloudError:
        return
    raise MethodContractError(f"broken promise: {what} raises InvalidCloudError")
