"""Beam models: the sensors that we have, their rays and firing times, and the tables they are read from."""

import dataclasses

import numpy as np
import pytest

from registration.errors import SimulationError
from registration.synthetic.lidar import (
    HDL_64E,
    OS1_128,
    SYMMETRIC_64,
    VLP_16,
    VLP_32C,
    BeamModel,
    Turn,
    beam_model,
    beam_models,
    fire,
    ray_directions,
    read_beam_table,
)

PLAIN = BeamModel("plain", np.deg2rad(np.array([2.0, 0.0, -10.0])), np.deg2rad(0.5))
TABLE = """# A sensor of two beams.
# name = tiny
# azimuth_step_deg = 0.5
# turn = counter-clockwise
# is_free_running = false
# max_range = 42

elevation_deg, azimuth_offset_deg, beam_height, range_offset
1, -2, 0.1, 0.01
-3, 4, 0.2, -0.02
"""


@pytest.fixture
def table(tmp_path):
    """Write the text of a table, and give its path."""

    def write(text):
        path = tmp_path / "sensor.csv"
        path.write_text(text)
        return path

    return write


def test_the_hdl_64e_has_two_blocks_of_32_beams_above_the_frame():
    elevations_deg = np.rad2deg(HDL_64E.elevations)
    assert elevations_deg[[0, 31, 32, 63]] == pytest.approx([1.9, -8.7, -9.0, -25.0], abs=0.05)
    assert -np.diff(elevations_deg[:32]).mean() == pytest.approx(1 / 3, abs=0.02)
    assert -np.diff(elevations_deg[32:]).mean() == pytest.approx(1 / 2, abs=0.02)
    heights = HDL_64E.per_beam("beam_heights")
    assert heights[:32].min() > 0.19 > 0.13 > heights[32:].max() > heights.min() > 0.11
    assert HDL_64E.n_azimuths == round(360 / 0.1796)
    assert HDL_64E.divergence == pytest.approx(2e-3, rel=1e-3)


def test_rays_leave_at_the_beams_elevations_and_cover_the_circle_evenly():
    directions = ray_directions(PLAIN, phase=0.001).reshape(3, 720, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(np.arcsin(directions[:, 7, 2]), PLAIN.elevations)
    azimuth = np.unwrap(np.arctan2(directions[1, :, 1], directions[1, :, 0]))
    np.testing.assert_allclose(azimuth, 0.001 + 2 * np.pi * np.arange(720) / 720)


def test_azimuth_offsets_turn_a_beam_but_not_its_time():
    offsets = np.deg2rad([4.2, 0.0, -1.4])
    shifted = dataclasses.replace(PLAIN, azimuth_offsets=offsets)
    rays, straight = fire(shifted, 0.001), fire(PLAIN, 0.001)
    np.testing.assert_array_equal(rays.time, straight.time)
    directions = rays.directions.reshape(3, 720, 3)
    azimuth = np.arctan2(directions[..., 1], directions[..., 0])
    np.testing.assert_allclose(azimuth[:, 100] - azimuth[1, 100], offsets, atol=1e-12)


@pytest.mark.parametrize(
    ("turn", "cut_deg", "left", "right", "first"),
    [
        (Turn.CLOCKWISE, 180, -0.025, 0.025, -0.05),
        (Turn.COUNTER_CLOCKWISE, 180, 0.025, -0.025, -0.05),
        (Turn.CLOCKWISE, 0, 0.075, 0.025, 0.0),
        (Turn.CLOCKWISE, -90, -0.025, -0.075, -0.075),
    ],
)
def test_the_head_points_forward_at_time_0_and_jumps_a_period_at_the_cut(turn, cut_deg, left, right, first):
    model = dataclasses.replace(PLAIN, turn=turn, cut_azimuth=np.deg2rad(cut_deg))
    time = fire(model).time.reshape(3, 720)
    assert time[:, 0] == pytest.approx(0.0, abs=1e-12)
    assert time[0, 180] == pytest.approx(left)
    just_past = 1 if cut_deg == -90 else 0  # the cut itself counts to the next sweep
    assert time[0, 540 - just_past] == pytest.approx(right, abs=2e-4)
    assert time.min() == pytest.approx(first, abs=2e-4)
    assert np.ptp(time) == pytest.approx(0.1 * (1 - 1 / 720))


def test_a_specimen_is_the_same_whenever_it_is_drawn_and_another_seed_is_another_one():
    one, same, other = PLAIN.as_built(1), PLAIN.as_built(1), PLAIN.as_built(2)
    np.testing.assert_array_equal(one.range_offsets, same.range_offsets)
    np.testing.assert_array_equal(one.azimuth_offsets, same.azimuth_offsets)
    assert not np.array_equal(one.range_offsets, other.range_offsets)
    many = BeamModel("many", np.linspace(-0.4, 0.4, 2000), 0.01).as_built(0)
    assert many.range_offsets.std() == pytest.approx(0.01, rel=0.05)
    assert 0.0049 < np.abs(many.azimuth_offsets).max() <= 0.005


def test_the_sensors_of_the_manuals_are_there():
    assert beam_models() == ["hdl-64e", "hdl-64e-kitti", "os1-128", "symmetric-64", "vlp-16", "vlp-32c"]
    for name, model in {"VLP-16": VLP_16, "vlp-32c": VLP_32C, "os1-128": OS1_128, "hdl-64e": HDL_64E}.items():
        assert beam_model(name) is model
    np.testing.assert_allclose(np.rad2deg(VLP_16.elevations), np.arange(15, -16, -2))
    elevations_deg, offsets_deg = (np.rad2deg(values) for values in (VLP_32C.elevations, VLP_32C.azimuth_offsets))
    assert elevations_deg[[0, -1]] == pytest.approx([15.0, -25.0])
    assert sorted(set(np.round(offsets_deg, 3))) == [-4.2, -1.4, 1.4, 4.2]
    assert (np.diff(elevations_deg) < -0.3).all()
    # Table 9-6 of the manual: laser 29 at 15 degrees in column 3, laser 20 at -3.333 in column 1; clockwise there.
    assert offsets_deg[[0, np.abs(elevations_deg + 3.333).argmin()]] == pytest.approx([1.4, -4.2])
    assert (OS1_128.n_beams, OS1_128.n_azimuths, OS1_128.is_free_running) == (128, 1024, False)
    assert np.rad2deg(np.ptp(OS1_128.elevations)) == pytest.approx(42.9, abs=0.3)


def test_the_papers_sensor_is_symmetric():
    elevations_deg = np.rad2deg(SYMMETRIC_64.elevations)
    np.testing.assert_allclose(elevations_deg, -13.45 + 26.9 / 63 * np.arange(64))
    assert SYMMETRIC_64.n_azimuths == 4500
    assert SYMMETRIC_64.divergence == 0.0


def test_a_table_says_all_of_a_sensor(table):
    model = beam_model(table(TABLE))
    assert (model.name, model.turn, model.is_free_running, model.max_range) == (
        "tiny", Turn.COUNTER_CLOCKWISE, False, 42.0,
    )  # fmt: skip
    assert model.azimuth_step == pytest.approx(np.deg2rad(0.5))
    np.testing.assert_allclose(model.elevations, np.deg2rad([1.0, -3.0]))
    np.testing.assert_allclose(model.azimuth_offsets, np.deg2rad([-2.0, 4.0]))
    np.testing.assert_allclose(model.beam_heights, [0.1, 0.2])
    np.testing.assert_allclose(model.range_offsets, [0.01, -0.02])
    assert model.range_noise == PLAIN.range_noise


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max_range", "max_rnge", r"sensor.csv:6: no setting 'max_rnge'. Did you mean 'max_range'"),
        ("= 42", "= far", r"sensor.csv:6: max_range must be a number, got 'far'"),
        ("= 42", "= inf", r"sensor.csv:6: max_range must be a finite number"),
        ("= false", "= no", r"sensor.csv:5: is_free_running must be true or false, got 'no'"),
        ("counter-clockwise", "left", r"sensor.csv:4: turn must be clockwise or counter-clockwise, got 'left'"),
        ("# name = tiny\n", "", r"sensor.csv: expected a line '# name = ...', got none"),
        ("# azimuth_step_deg = 0.5\n", "", r"expected a line '# azimuth_step_deg = ...'"),
        ("beam_height", "beam_hieght", r"sensor.csv:8: no column 'beam_hieght'. Did you mean 'beam_height'"),
        ("elevation_deg,", "beam_height,", r"sensor.csv:8: expected elevation_deg once among the columns"),
        ("-3, 4,", "-3,", r"sensor.csv:10: expected 4 numbers, got 3"),
        ("-3, 4,", "-3, up,", r"sensor.csv:10: each cell must be a number"),
        ("0.1, 0.01\n-3", "0.1, 0.01\n95", r"sensor.csv: a beam model needs elevations between"),
        (TABLE[TABLE.index("1, -2") :], "", r"expected a header line and a line for each beam, got 1 lines"),
    ],
)
def test_a_faulty_table_is_refused_with_file_line_and_reason(table, old, new, message):
    assert TABLE.count(old) >= 1
    with pytest.raises(SimulationError, match=message):
        read_beam_table(table(TABLE.replace(old, new, 1)))


def test_unknown_sensors_and_missing_or_binary_tables_are_refused(tmp_path):
    with pytest.raises(SimulationError, match="no beam model 'vlp-61'. Did you mean 'vlp-16'"):
        beam_model("VLP-61")
    with pytest.raises(SimulationError, match=r"missing.csv: a beam table cannot be read"):
        beam_model(tmp_path / "missing.csv")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(SimulationError, match=r"binary.csv: a beam table cannot be read"):
        beam_model(binary)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"elevations": np.zeros(0)}, "at least one beam"),
        ({"min_range": 5.0, "max_range": 4.0}, "min_range < max_range"),
        ({"elevations": np.array([0.0, 1.6])}, "between -90 and 90 degrees"),
        ({"azimuth_offsets": np.zeros(2)}, "one finite number a beam in azimuth_offsets: 3 of them"),
        ({"range_offsets": np.array([0.0, np.nan, 0.0])}, "one finite number a beam in range_offsets"),
        ({"divergence": -1e-3}, "divergence"),
        ({"period": 0.0}, "period and reach > 0"),
    ],
)
def test_impossible_sensors_are_refused_with_the_reason(changes, message):
    with pytest.raises(SimulationError, match=message):
        dataclasses.replace(PLAIN, **changes)
