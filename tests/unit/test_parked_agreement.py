"""How far velocities of what stands contradict each other: nothing where they do not, and their own errors else."""

import numpy as np
import pytest
from regmot.parked_agreement import residuals

PLACES = np.random.default_rng(0).uniform(-30.0, 30.0, (40, 2))


def steps_of_a_rigid_motion(turn, shift, dt=0.1):
    c, s = np.cos(turn), np.sin(turn)
    return (PLACES @ np.array([[c, s], [-s, c]]) + shift - PLACES) / dt


def test_a_rigid_motion_leaves_nothing():
    off, squared, expected = residuals(
        PLACES, steps_of_a_rigid_motion(0.05, [-1.5, 0.1]), np.tile(np.eye(2), (40, 1, 1))
    )
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    assert squared == pytest.approx(0.0, abs=1e-12)
    assert expected == 76


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_errors_are_told_by_how_much_larger_they_are_than_claimed(factor):
    rng, found = np.random.default_rng(1), []
    sd = rng.uniform(0.02, 0.2, 40)
    for _ in range(200):
        velocities = steps_of_a_rigid_motion(-0.02, [-1.0, 0.0]) + factor * sd[:, None] * rng.standard_normal((40, 2))
        _, squared, expected = residuals(PLACES, velocities, sd[:, None, None] ** 2 * np.eye(2))
        found.append(squared / expected)
    assert np.mean(found) == pytest.approx(factor**2, rel=0.05)
