"""Rows of a comparison's tables, from estimates that are made up: each figure can be redone by hand."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from evaluation import report, tables
from evaluation.compare import CompareConfig, Comparison, SequenceSummary
from evaluation.scored import pair_with_truth
from evaluation.truth import TrueVelocity
from tracker.types import EstimateStatus, VelocityEstimate


def estimate(track_id, frame, velocity, status=EstimateStatus.CONVERGED):
    place, cov = np.zeros(2), 0.25 * np.eye(2)
    return VelocityEstimate(track_id, frame, 0.1 * frame, "world", place, np.array(velocity), cov, 0.0, 9.0, 50, status)


def life(track_id, velocities, first=0):
    """Estimate a velocity for each frame of a gap-free life; the first one is that of a new track."""
    return [
        estimate(track_id, first + i, v, EstimateStatus.CONVERGED if i else EstimateStatus.NEW_TRACK)
        for i, v in enumerate(velocities)
    ]


def comparison_of(lives, true, frame="world", truth="exact", ranges=(80.0, 20.0)):
    """Compare lives with (velocity, range, is parked, class) by track and frame, or by track where it never changes."""
    keys = [(e.track_id, e.frame) for a_life in lives for e in a_life[1:]]
    truths = {
        key: TrueVelocity(np.array(v), range_m, is_parked, name)
        for key in keys
        for v, range_m, is_parked, name in [true.get(key) or true[key[0]]]
    }
    scored = pair_with_truth(("0000", "icp", "causal"), lives, keys, truths, 0.5)
    config = CompareConfig(estimators=("icp",), smoothing=("causal",), frame=frame, truth=truth, ranges=ranges)
    summary = SequenceSummary(
        name="0000", n_frames=9, missing_scans=(), clock="nominal", ego="oxts", n_without_points=0, n_tracks=2,
        n_parked=1, flagged_poses=(), ego_path=np.zeros((1, 2)),
    )  # fmt: skip
    return Comparison(Path("root"), config, truth, (summary,), (scored,))


PARKED = (7, [(0.0, 0.0), (0.2, 0.0), (0.4, 0.0), (0.0, 0.5), (0.0, 0.0)])
LOST = (8, [(0.0, 0.0)] * 8)
TRUE = {7: ((0.0, 0.0), 10.0, True, "Car"), 8: ((5.0, 0.0), 30.0, False, "Van")}


@pytest.fixture
def both():
    return comparison_of([life(*PARKED), life(*LOST)], TRUE)


def test_false_motion_counts_the_steps_of_parked_objects_only(both):
    far, near = tables.rows(both)
    assert (far["n"], far["n_parked"], far["false_motion"]) == (4 + 7, 4, pytest.approx(2 / 4))
    assert (near["n"], near["n_parked"], near["false_motion"]) == (4, 4, pytest.approx(2 / 4))


def test_a_slow_object_that_does_not_stand_for_its_whole_life_is_none():
    found = comparison_of([life(*PARKED)], {7: ((0.0, 0.0), 10.0, False, "Car")})
    assert tables.rows(found)[0]["n_parked"] == 0
    assert np.isnan(tables.rows(found)[0]["false_motion"])


def test_in_the_sensors_frame_false_motion_is_not_defined():
    found = comparison_of([life(*PARKED)], TRUE, frame="sensor")
    assert tables.rows(found)[0]["n_parked"] == 0
    assert np.isnan(tables.rows(found)[0]["false_motion"])


def test_a_lost_track_counts_at_the_ranges_that_it_enters_and_is_judged_over_all(both):
    far, near = tables.rows(both)
    assert (far["n_tracks"], far["lost_tracks"]) == (1, 1)  # the parked one has only five frames
    assert (near["n_tracks"], near["lost_tracks"]) == (0, 0)
    comes_near = {**TRUE, (8, 6): ((0.1, 0.0), 19.0, False, "Van")}  # followed in one frame, near by
    assert [row["lost_tracks"] for row in tables.rows(comparison_of([life(*LOST)], comes_near))] == [0, 0]
    assert [row["n_tracks"] for row in tables.rows(comparison_of([life(*LOST)], comes_near))] == [1, 1]
    goes_wrong = {**TRUE, (8, 6): ((5.0, 0.0), 19.0, False, "Van")}
    assert [row["lost_tracks"] for row in tables.rows(comparison_of([life(*LOST)], goes_wrong))] == [1, 1]


def test_a_life_with_a_gap_is_two_tracks_and_the_second_starts_anew():
    lives = [life(8, [(0.0, 0.0)] * 8), life(8, [(0.0, 0.0)] * 4, first=20)]
    assert tables.rows(comparison_of(lives, TRUE))[0]["n_tracks"] == 1


def brake(times):
    return np.column_stack([15.0 - 5.0 * np.clip(times - 4.0, 0.0, 2.0), 0.0 * times])


def late_car(late, n=80):
    times = 0.1 * np.arange(n)
    true = {(7, k): (v, 15.0 if k < 50 else 30.0, False, "Car") for k, v in enumerate(brake(times))}
    return [life(7, brake(times - late))], true


def test_delays_are_those_of_the_steps_that_begin_within_the_range():
    far, near = tables.rows(comparison_of(*late_car(0.3)))
    assert (far["n_delays"], far["delay_s"]) == (2, pytest.approx(0.3, abs=0.02))
    assert (near["n_delays"], near["delay_s"]) == (1, pytest.approx(0.3, abs=0.02))


@pytest.mark.parametrize("truth", ["labels", "smoothed"])
def test_delays_need_exact_truth(truth):
    row = tables.rows(comparison_of(*late_car(0.3), truth=truth))[0]
    assert row["n_delays"] == 0
    assert np.isnan(row["delay_s"])


def test_a_gap_in_what_is_scored_is_not_looked_across():
    (whole,), true = late_car(0.3)
    pieces = [whole[:45], whole[47:]]
    assert tables.rows(comparison_of(pieces, true))[0]["n_delays"] == 0


def test_classes_have_rows_of_their_own_that_sum_to_the_whole(both):
    found = {(row["class_name"], row["range_m"]): row for row in tables.class_rows(both)}
    assert set(found) == {("Car", 80.0), ("Car", 20.0), ("Van", 80.0)}  # no van within 20 m
    assert found["Car", 80.0]["n"] + found["Van", 80.0]["n"] == tables.rows(both)[0]["n"]
    assert found["Car", 80.0]["nees"] == pytest.approx((0.2**2 + 0.4**2 + 0.5**2 + 0.0) / 0.25 / 4)
    assert found["Van", 80.0]["nees"] == pytest.approx(5.0**2 / 0.25)
    assert (found["Car", 80.0]["coverage_95"], found["Van", 80.0]["coverage_95"]) == (1.0, 0.0)
    assert (found["Car", 80.0]["false_motion"], found["Van", 80.0]["lost_tracks"]) == (0.5, 1)


def test_the_printed_tables_show_dashes_for_what_is_not_defined(both):
    found = report.results(both)
    body = [report.table_cells(row, report.USE_TABLE) for row in report.use_rows(found)]
    headings = [name for name, _, _ in report.USE_TABLE]
    shown = [dict(zip(headings, cells, strict=True)) for cells in body]
    assert [(row["class"], row["range"]) for row in shown] == [
        ("all", "< 80 m"), ("all", "< 20 m"), ("Car", "< 80 m"), ("Van", "< 80 m"),
    ]  # fmt: skip
    assert [row["false motion"] for row in shown] == ["50.0%", "50.0%", "50.0%", "-"]
    assert {row["delay [s]"] for row in shown} == {"-"}


def test_one_class_alone_is_not_shown_twice():
    found = report.results(comparison_of([life(*PARKED)], TRUE))
    assert [row["class_name"] for row in report.use_rows(found)] == ["all", "all"]


def test_the_brief_table_shows_the_live_smoothing_and_no_empty_ranges(both):
    found = report.results(dataclasses.replace(both, config=dataclasses.replace(both.config, ranges=(80.0, 5.0))))
    also = [{**row, "smoothing": "rts"} for row in found["rows"]]
    twice = {**found, "rows": also + found["rows"]}
    assert [(row["smoothing"], row["class_name"], row["range_m"]) for row in report.use_rows(twice, is_brief=True)] == [
        ("causal", "all", 80.0), ("causal", "Car", 80.0), ("causal", "Van", 80.0),
    ]  # fmt: skip
    assert len(report.use_rows(twice)) == 2 + 2 + 2
    assert {row["smoothing"] for row in report.use_rows({**twice, "rows": also}, is_brief=True)} == {"rts"}


def test_results_hold_the_new_figures_and_null_for_what_is_not_defined(both, tmp_path):
    found = json.loads(report.write(both, tmp_path).read_text())
    new = {"p99_velocity_error", "n_parked", "false_motion", "n_tracks", "lost_tracks", "n_delays", "delay_s"}
    assert all(new <= row.keys() for row in found["rows"] + found["classes"])
    assert found["rows"][0]["delay_s"] is None
    text = (tmp_path / "report.md").read_text()
    assert "| icp | causal | Van | < 80 m | 7 | 100.00 | 0.0% | - | 1 | 1 | 0 | - |" in text
    assert "## By range, NEES (95 % coverage)" in text
    assert "| 30-40 m | 7 | 100.00 (0.0%) |" in text
