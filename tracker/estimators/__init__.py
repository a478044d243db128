"""Segments in, velocities out."""

from tracker.estimators.contract import Estimator
from tracker.estimators.registry import (
    CAUSAL,
    SMOOTHINGS,
    create_estimator,
    create_smoothing,
    estimator_names,
)

__all__ = ["CAUSAL", "SMOOTHINGS", "Estimator", "create_estimator", "create_smoothing", "estimator_names"]
