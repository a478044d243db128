"""Velocity from many comparisons of an object with its own past, weighed together; see `estimator`."""

from tracker.estimators.fused.estimator import FusedEstimator, FusedSettings

__all__ = ["FusedEstimator", "FusedSettings"]
