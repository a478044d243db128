"""Looks at objects, as the fused estimator keeps them, for its tests."""

from dataclasses import replace

import numpy as np

from tests.segments import segment
from tracker.estimators.contract import look
from tracker.estimators.fused.look import looked_at
from tracker.estimators.fused.sensor import Sensor
from tracker.estimators.fused.sources import Learned


def kept(points, encoding, lags=None):
    """Make a look, of a raw sweep where it is said how much later than the sensor's head each point was passed."""
    sighting = look(replace(segment(points, 1), is_swept=lags is not None), None, undoes_sweep=True)
    found = looked_at(sighting, Sensor(np.zeros(2), 0.0), encoding, knows_lasers=False)
    return replace(found, points=points, lags=lags)


def encoded(cloud, class_name="Car"):
    return Learned().encode([look(replace(segment(cloud, 1), class_name=class_name), None)])[0]
