"""Sequences written frame by frame: resumed after a kill, the same from any number of processes, whole or not there."""

import json
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tracker.errors import AbruptEndError, DataError, InputError
from tracker.kitti.scans import read_scan
from tracker.simulation.recorder import record
from tracker.simulation.recording import Take, TakenFrame


@dataclass(frozen=True)
class Plain:
    """A sequence of a few points, which ends its process at a frame until `fuse` is burnt."""

    n_frames: int = 5
    seed: int = 0
    fuse: Path | None = None
    burns: bool = True

    @property
    def settings(self):
        return {"seed": self.seed, "n_frames": self.n_frames}

    @property
    def heads(self):
        return {"calib": "P0: 1\n", "truth": "frame\n", "label_02": ""}

    def frame(self, index):
        if self.fuse is not None and index == 3 and not self.fuse.exists():
            if self.burns:
                self.fuse.touch()
            os._exit(1)
        points = np.random.default_rng([self.seed, index]).normal(size=(4, 3))
        return TakenFrame(points, np.full(4, 0.5), {"label_02": f"{index} car\n", "truth": f"{index}\n"})


def files_below(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


class StopError(Exception):
    pass


def stop_after(n):
    """Count frames, and stop a run after n of them."""
    told = []

    def progress(name, done, total):
        told.append((name, done))
        if len(told) == n:
            raise StopError

    return progress, told


def test_frames_become_files_in_their_order(tmp_path):
    assert isinstance(Plain(), Take)
    record({"0007": Plain}, tmp_path / "out")
    training = tmp_path / "out/training"
    assert (training / "label_02/0007.txt").read_text() == "0 car\n1 car\n2 car\n3 car\n4 car\n"
    assert (training / "truth/0007.csv").read_text() == "frame\n0\n1\n2\n3\n4\n"
    assert (training / "calib/0007.txt").read_text() == "P0: 1\n"
    expected = np.random.default_rng([0, 2]).normal(size=(4, 3))
    np.testing.assert_allclose(read_scan(training / "velodyne/0007/000002.bin"), expected, atol=1e-6)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["simulation.json", "training"]


def test_a_stopped_run_goes_on_where_it_stopped_and_ends_like_one_that_was_not(tmp_path):
    recipes = {"0000": Plain, "0001": partial(Plain, seed=3)}
    progress, _ = stop_after(7)
    with pytest.raises(StopError):
        record(recipes, tmp_path / "out", progress)
    assert [path.name for path in (tmp_path / "out/training/label_02").iterdir()] == ["0000.txt"]
    progress, told = stop_after(99)
    record(recipes, tmp_path / "out", progress)
    assert told == [("0001", 3), ("0001", 4), ("0001", 5)]
    record(recipes, tmp_path / "whole")
    assert files_below(tmp_path / "out") == files_below(tmp_path / "whole")


def test_other_settings_start_over(tmp_path):
    progress, _ = stop_after(3)
    with pytest.raises(StopError):
        record({"0000": Plain}, tmp_path / "out", progress)
    progress, told = stop_after(99)
    record({"0000": partial(Plain, seed=1)}, tmp_path / "out", progress)
    assert len(told) == 5
    record({"0000": partial(Plain, seed=1)}, tmp_path / "whole")
    assert files_below(tmp_path / "out") == files_below(tmp_path / "whole")


def test_a_frame_whose_rows_are_missing_is_made_again(tmp_path):
    progress, _ = stop_after(3)
    with pytest.raises(StopError):
        record({"0000": Plain}, tmp_path / "out", progress)
    (tmp_path / "out/.unfinished-0000/rows/000001.json").unlink()
    (tmp_path / "out/.unfinished-0000/velodyne/000001.bin").write_bytes(b"half")
    progress, told = stop_after(99)
    record({"0000": Plain}, tmp_path / "out", progress)
    assert [done for _, done in told] == [2, 4, 5]
    assert len(read_scan(tmp_path / "out/training/velodyne/0000/000001.bin")) == 4


def test_a_new_sequence_leaves_nothing_of_the_old_one_of_its_name(tmp_path):
    record({"0000": Plain}, tmp_path / "out")
    stale = tmp_path / "out/training/oxts/0000.txt"
    stale.parent.mkdir()
    stale.write_text("poses of another drive\n")
    record({"0000": partial(Plain, n_frames=2)}, tmp_path / "out")
    assert not stale.exists()
    assert len(list((tmp_path / "out/training/velodyne/0000").iterdir())) == 2
    assert json.loads((tmp_path / "out/simulation.json").read_text())["sequences"]["0000"]["n_frames"] == 2


def test_several_processes_write_the_same_and_survive_the_crash_of_one(tmp_path, caplog):
    recipes = {"0000": partial(Plain, fuse=tmp_path / "fuse"), "0001": partial(Plain, seed=3)}
    record(recipes, tmp_path / "out", n_jobs=2)
    assert "ended abruptly" in caplog.text
    record(recipes, tmp_path / "alone")  # the fuse is burnt
    assert files_below(tmp_path / "out") == files_below(tmp_path / "alone")


def test_crash_after_crash_is_an_error_that_keeps_what_is_done(tmp_path, monkeypatch):
    monkeypatch.setattr("tracker.simulation.recorder.MAX_CRASHES", 1)
    with pytest.raises(AbruptEndError, match="run the same again to go on"):
        record({"0000": partial(Plain, fuse=tmp_path / "fuse", burns=False)}, tmp_path / "out", n_jobs=2)
    assert len(list((tmp_path / "out/.unfinished-0000/rows").iterdir())) == 3
    assert not (tmp_path / "out/training").exists()


def test_a_folder_of_somebody_else_strange_names_and_no_process_are_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(DataError, match="no simulation has written"):
        record({"0000": Plain}, tmp_path)
    with pytest.raises(InputError, match="letters and digits"):
        record({"../0000": Plain}, tmp_path / "out")
    with pytest.raises(InputError, match="at least 1 process"):
        record({"0000": Plain}, tmp_path / "out", n_jobs=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["thesis.tex"]
