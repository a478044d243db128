"""Which laser saw a point, and when: on simulated sweeps, which know it, and on the real sensor's encoder steps."""

import numpy as np
import pytest
from regmot.kitti_lasers import shift, short_steps

from registration.neighbours import pack_arrays
from registration.synthetic.lidar import HDL_64E, HDL_64E_KITTI, VLP_16, firing_lags, level_ground, ring_of, rings, scan


@pytest.fixture(scope="module")
def sweep():
    return scan([], HDL_64E_KITTI, np.random.default_rng(0), level_ground(HDL_64E_KITTI))


def lags_of(clouds, beam_model):
    """Give the lags of each cloud; None where they are not known."""
    points, begin = pack_arrays(clouds)
    lags, is_known = firing_lags(points, begin, rings(beam_model))
    return [lags[a:b] if known else None for a, b, known in zip(begin, begin[1:], is_known, strict=False)]


def test_a_point_tells_its_laser_and_when_it_fired(sweep):
    ring, off = ring_of(sweep.points_lidar, HDL_64E_KITTI)
    np.testing.assert_array_equal(ring, sweep.beam_index)
    assert np.abs(off).max() < np.deg2rad(0.01)
    x, y, _ = sweep.points_lidar.T
    in_front = np.abs(np.arctan2(y, x)) < 2.8  # lasers that look past the cut fire half a turn before or after
    (lags,) = lags_of([sweep.points_lidar], HDL_64E_KITTI)
    times = -np.arctan2(y, x) / (2.0 * np.pi) * HDL_64E_KITTI.period + lags
    np.testing.assert_allclose(times[in_front], sweep.time[in_front], atol=1e-6)
    assert np.ptp(lags) > 4e-3


def test_points_that_lie_on_no_rings_of_a_sensor_have_no_lags(sweep):
    foreign = scan([], VLP_16, np.random.default_rng(0), level_ground(VLP_16)).points_lidar
    own, other = lags_of([sweep.points_lidar[:100], foreign], HDL_64E_KITTI)
    assert other is None
    np.testing.assert_array_equal(own, lags_of([sweep.points_lidar], HDL_64E_KITTI)[0][:100])
    assert np.abs(lags_of([foreign], VLP_16)[0]).max() < 1e-4
    noisy = sweep.points_lidar + np.random.default_rng(1).normal(0.0, 0.05, sweep.points_lidar.shape)
    assert lags_of([noisy], HDL_64E_KITTI) == [None]
    assert len(lags_of([np.empty((0, 3))], HDL_64E_KITTI)[0]) == 0


def test_offsets_of_lasers_are_found_from_single_steps_of_the_encoder():
    """A head that turns by 0.168 to 0.178 degrees a firing, recorded in steps of 0.09; two lasers 6.3 degrees apart."""
    rng, scans = np.random.default_rng(0), []
    for rate in np.linspace(0.168, 0.178, 10):
        head = np.round((rng.uniform() + np.arange(-60.0, 60.0, rate)) / 0.09) * 0.09
        points = []
        for beam, offset in ((16, 2.0), (21, -4.3)):
            azimuth, elevation = np.deg2rad(head + offset), HDL_64E.elevations[beam]
            z = 10.0 * np.tan(elevation) + HDL_64E.per_beam("beam_heights")[beam]
            points.append(np.column_stack([10.0 * np.cos(azimuth), 10.0 * np.sin(azimuth), np.full(len(azimuth), z)]))
        scans.append(short_steps(np.concatenate(points)))
    found, share = shift(scans, 21, 16)
    assert found == pytest.approx(-6.3, abs=0.02)
    assert share > 0.8
