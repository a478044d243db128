"""Looks at objects, as the fused estimator keeps them, for its tests."""

from dataclasses import replace

import numpy as np

from tests.segments import segment
from tracker.ego_motion.sweep import azimuth_times
from tracker.estimators.contract import look
from tracker.estimators.fused.look import looked_at
from tracker.estimators.fused.sensor import SWEEP, Sensor
from tracker.estimators.fused.sources import Laid, Learned
from tracker.estimators.fused.steps import Steps


def kept(points, encoding, lags=None):
    """Make a look, of a raw sweep where it is said how much later than the sensor's head each point was passed."""
    sighting = look(replace(segment(points, 1), is_swept=lags is not None), None, undoes_sweep=True)
    sensor = Sensor(np.zeros(2), 0.0)
    (found,) = looked_at([sighting], sensor, [encoding], knows_lasers=False)
    return found._replace(points=points, passed=None if lags is None else passed_at(sensor, points[:, :2], lags))


def passed_at(sensor, places, lags=0.0):
    """Give when the beams pass places, after the time of the frame; `lags` later than the sensor's head."""
    x, y = (places - sensor.place).T
    return azimuth_times(np.arctan2(y, x) - sensor.yaw - 2.0 * np.pi / SWEEP.period * lags, SWEEP)


def encoded(cloud, class_name="Car"):
    return Learned().encode([look(replace(segment(cloud, 1), class_name=class_name), None)])[0]


def laid_on(earlier, newer, place, shift, sd, turn_sd, contrary=None):
    """Say where one earlier look is expected in a newer one, which is the first: so far on, and unsure by so much."""
    return Laid(
        earlier=[earlier],
        newer=[0],
        places=np.array([place]),
        shifts=np.array([shift]),
        turns=np.zeros(1),
        covariances=sd**2 * np.eye(2)[None],
        is_expected=np.ones(1, dtype=np.bool_),
        turn_variances=np.array([turn_sd**2]),
        contraries=np.zeros((1, 2, 2)) if contrary is None else contrary[None],
    )


def seen(objects, n=3):
    """Give the latest n steps of objects: place half-way, velocity, its standard deviation, and maybe its slips (see
    `Steps`), the same in each step.
    """
    places, velocities, sds, slips = zip(*((*o, (0.0, 0.0))[:4] for o in objects), strict=True)
    k, frames = len(objects), np.tile(np.arange(1, n + 1), len(objects))
    places, velocities, slips = (
        np.repeat(np.array(x, dtype=np.float64), n, axis=0) for x in (places, velocities, slips)
    )
    return Steps(
        owners=np.repeat(np.arange(k), n),
        ends=np.arange(n, k * n + 1, n),
        frames=frames,
        numbers=frames,
        lengths=np.ones(k * n, dtype=np.int64),
        places=places,
        velocities=velocities,
        covariances=np.repeat(sds, n)[:, None, None] ** 2 * np.eye(2),
        doubts=np.zeros((k * n, 2, 2)),
        slips=slips,
        by_clock=np.ones(k * n),
        centers=places[n - 1 :: n],
        yaw_rates=np.zeros(k),
    )
