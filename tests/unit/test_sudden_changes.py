"""The table of what estimators say when a car's speed changes at once, or its box jumps."""

import sys

from regmot import sudden_changes


def test_each_event_has_a_row_for_each_estimator(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sudden_changes", "1"])
    monkeypatch.setattr(sudden_changes, "EVENTS", (sudden_changes.Event("stop", change=15.0),))
    chosen = {name: sudden_changes.ESTIMATORS[name] for name in ("adh-3d", "centroid-kf")}
    monkeypatch.setattr(sudden_changes, "ESTIMATORS", chosen)
    sudden_changes.main()
    rows = [line.split("│")[1:-1] for line in capsys.readouterr().out.splitlines() if "stop" in line]
    (_, first, n, *errors), (_, second, _, *late) = rows
    assert (first.strip(), second.strip()) == ("adh-3d", "centroid-kf")
    assert 1 <= int(n) <= sudden_changes.N_CARS
    assert float(errors[0]) < 1.0  # it has no opinion of how cars move
    assert float(late[0]) > 3.0
