"""How far estimated velocities are off: RMSE of vector and speed, medians, and whether the covariance is honest."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.stats import chi2

Vectors = Float64[np.ndarray, "n 2"]
Covariances = Float64[np.ndarray, "n 2 2"]

COVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class VelocityScore:
    """A row of the velocity table; NaN where n is 0.

    Attributes:
        n: number of steps scored, abstentions included.
        rmse_velocity: root-mean-square length of the error vector [m/s].
        rmse_speed: root-mean-square difference of the magnitudes [m/s], the papers' figure.
        median_velocity_error: median length of the error vector [m/s].
        p99_velocity_error: 99 % of the error vectors are not longer [m/s]; percentiles between two steps' errors are
            interpolated.
        abstained: number of steps whose velocity is a fallback.
        nees: mean normalised estimation error squared; 2 for an honest covariance, more when overconfident.
        coverage_95: share of errors inside the covariance's 95 % ellipse.
    """

    n: int
    rmse_velocity: float
    rmse_speed: float
    median_velocity_error: float
    p99_velocity_error: float
    abstained: int
    nees: float
    coverage_95: float


def score(
    estimated: Vectors, true: Vectors, covariance: Covariances, abstained: Bool[np.ndarray, " n"]
) -> VelocityScore:
    """Sum up the errors of many steps.

    Args:
        estimated: velocities [m/s].
        true: their truth, row by row [m/s].
        covariance: of the estimates [m^2/s^2].
        abstained: which of them are fallbacks; they count like the others.
    """
    if len(estimated) == 0:
        nan = float("nan")
        return VelocityScore(0, nan, nan, nan, nan, 0, nan, nan)
    error = estimated - true
    length = np.hypot(error[:, 0], error[:, 1])
    speed_error = np.hypot(*estimated.T) - np.hypot(*true.T)
    normalised = normalised_squared_error(error, covariance)
    return VelocityScore(
        n=len(error),
        rmse_velocity=float(np.sqrt(np.mean(length**2))),
        rmse_speed=float(np.sqrt(np.mean(speed_error**2))),
        median_velocity_error=float(np.median(length)),
        p99_velocity_error=float(np.percentile(length, 99.0)),
        abstained=int(abstained.sum()),
        nees=float(np.mean(normalised)),
        coverage_95=float(np.mean(normalised <= chi2.ppf(COVERAGE, df=2))),
    )


def normalised_squared_error(error: Vectors, covariance: Covariances) -> Float64[np.ndarray, " n"]:
    """Give e' C^-1 e of each error; its expectation is 2 where the covariance is honest."""
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
