"""Two clouds in, one motion out: knows no track, no clock, no KITTI.

>>> import numpy as np, registration
>>> source = np.random.default_rng(0).uniform([-2, -1, 0], [2, 1, 1.5], (200, 3))
>>> result = registration.create("icp").register(source, source + [0.3, 0.1, 0.0])
>>> result.T_target_source[:2, 3].round(3), str(result.status)
(array([0.3, 0.1]), 'converged')
"""

from registration.conformance import check_method
from registration.errors import RegistrationError
from registration.method import PairMethod
from registration.refined import refined
from registration.registry import create, names
from registration.types import MotionPrior, RegistrationMethod, RegistrationResult, Status

__all__ = [
    "MotionPrior",
    "PairMethod",
    "RegistrationError",
    "RegistrationMethod",
    "RegistrationResult",
    "Status",
    "check_method",
    "create",
    "names",
    "refined",
]
