"""How sets of pairs are made, continued, and refused; and the command that does it."""

import errno
import json

import numpy as np
import pytest
from regmot.cli import main

from registration.errors import PairSetError, SimulationError
from registration.pair_set import PairSet
from registration.synthetic import production
from registration.synthetic.catalogue import create_recipe, generated_names
from registration.synthetic.kitti_like import kitti_like_scenes
from registration.synthetic.production import Order, make_pair, make_pair_set, unfinished_folder
from tests.pair_recipes import Dots, synth


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("recipe", [synth(), kitti_like_scenes("kitti-like-cars")], ids=["synth", "kitti-like"])
def test_a_pair_depends_on_its_seed_part_and_index_only(recipe):
    order = Order(recipe, seed=4, counts=(5, 3, 2))
    later, first = order.make(6), order.make(1)
    again = make_pair(recipe, 4, "val", 1)
    assert later.source.tobytes() == again.source.tobytes()
    assert later.extra == again.extra
    assert first.source.tobytes() != make_pair(recipe, 5, "train", 1).source.tobytes()
    assert first.source.tobytes() != later.source.tobytes()


def test_a_set_has_its_parts_its_truth_and_its_description(tmp_path):
    order = Order(Dots(empty_share=0.3), seed=1, counts=(5, 2, 3))
    found = make_pair_set(order, tmp_path / "set")
    assert [found.ids(part) for part in ("train", "val", "test")] == [[0, 1, 2, 3, 4], [5, 6], [7, 8, 9]]
    about = json.loads((tmp_path / "set" / "about.json").read_text())
    assert (about["name"], about["seed"], about["counts"]) == ("dots", 1, [5, 2, 3])
    assert about["redraws"] == sum(found.read(i).extra["redraws"] for i in range(10)) > 0
    assert found.read(5).extra["part_drawn"] == "val"
    np.testing.assert_array_equal(np.load(found.folder / "transform" / "00000003.npy"), found.read(3).T_target_source)
    assert [p.name for p in tmp_path.iterdir()] == ["set"]


def test_several_processes_make_the_same_bits_as_one(tmp_path):
    order = Order(synth(), seed=2, counts=(10, 2, 2))
    reported = []
    make_pair_set(order, tmp_path / "one", 1, lambda what, n, n_all: reported.append((n, n_all)))
    make_pair_set(order, tmp_path / "two", 2)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert reported[0] == (0, 14)
    assert reported[-1] == (14, 14)


def test_an_interrupted_set_goes_on_and_comes_out_the_same(tmp_path, monkeypatch):
    order = Order(Dots(), seed=3, counts=(20, 5, 5))
    make_pair_set(order, tmp_path / "whole")

    def killed(what, n, n_all):
        if n >= 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_pair_set(order, tmp_path / "set", progress=killed)
    unfinished = unfinished_folder(tmp_path / "set")
    assert not (tmp_path / "set").exists()
    n_kept = len(list((unfinished / "meta").glob("*.json")))
    assert 10 <= n_kept < 30
    # a kill amid a pair leaves clouds without a record, half a cloud, half a record
    (unfinished / "pointcloud1" / "00000029.npy").write_bytes(b"\x93NUM")
    (unfinished / "meta" / "00000029.unfinished").write_text("{")

    made = []
    monkeypatch.setattr(production, "write_pair", lambda f, i, p, w=production.write_pair: (made.append(i), w(f, i, p)))
    make_pair_set(order, tmp_path / "set")
    assert made == list(range(n_kept, 30))
    assert contents(tmp_path / "set") == contents(tmp_path / "whole")


def test_an_unfinished_set_with_other_settings_is_not_continued(tmp_path):
    def killed(what, n, n_all):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_pair_set(Order(Dots(), 3, (20, 5, 5)), tmp_path / "set", progress=killed)
    with pytest.raises(PairSetError, match=r"other settings \(seed is 3, not 4\)"):
        make_pair_set(Order(Dots(), 4, (20, 5, 5)), tmp_path / "set")
    (unfinished_folder(tmp_path / "set") / "about.json").write_text("{")
    with pytest.raises(PairSetError, match="expected an unfinished set of pairs"):
        make_pair_set(Order(Dots(), 3, (20, 5, 5)), tmp_path / "set")


def test_a_full_disk_leaves_no_half_set_and_the_message_says_how_to_go_on(tmp_path, monkeypatch):
    write = production.write_pair

    def full(folder, id_, pair):
        if id_ == 9:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(folder, id_, pair)

    monkeypatch.setattr(production, "write_pair", full)
    order = Order(Dots(), counts=(12, 0, 0))
    with pytest.raises(PairSetError, match=r"not complete: No space left on device\.  8 of 12 pairs are kept in .*set"):
        make_pair_set(order, tmp_path / "set")
    assert not (tmp_path / "set").exists()
    monkeypatch.setattr(production, "write_pair", write)
    assert make_pair_set(order, tmp_path / "set").ids("train") == list(range(12))


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine").write_text("precious")
    with pytest.raises(PairSetError, match="holds something already"):
        make_pair_set(Order(Dots(), counts=(1, 0, 0)), tmp_path / "set")
    assert contents(tmp_path) == {"set/mine": b"precious"}


def test_a_recipe_that_yields_nothing_ends_with_the_reason():
    with pytest.raises(SimulationError, match="dots, train 0: no pair with points in 1000 scenes"):
        make_pair(Dots(empty_share=1.0), 0, "train", 0)


@pytest.mark.parametrize("counts", [(0, 0, 0), (1, -1, 0)])
def test_counts_that_cannot_be_are_refused(counts):
    with pytest.raises(PairSetError, match="counts of pairs"):
        Order(Dots(), counts=counts)


def test_unknown_sets_and_meshes_that_a_set_cannot_use_are_refused(tmp_path):
    with pytest.raises(PairSetError, match=r"no set of pairs 'synth-car'. Did you mean 'synth-cars'\?"):
        create_recipe("synth-car")
    with pytest.raises(PairSetError, match="takes no folder of meshes"):
        create_recipe("kitti-like-cars", tmp_path)
    assert len(generated_names()) == 8


def command(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    return ended.value.code


def test_the_command_makes_a_set_that_registers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--counts", "2,0,1", "--seed", 7, "--jobs", 1]
    assert command("pairs", "kitti-like-cars", "--out", "set", *options) == 0
    found = PairSet(tmp_path / "set")
    assert [len(found.ids(part)) for part in ("train", "val", "test")] == [2, 0, 1]
    again = make_pair(kitti_like_scenes("kitti-like-cars"), 7, "test", 0)
    np.testing.assert_array_equal(found.read(2).source, again.source.astype(np.float32))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["synth-car"], 1, "Did you mean 'synth-cars'"),
        (["kitti-tracklets-cars"], 2, "needs --root"),
        (["kitti-looks-cars"], 2, "needs --root"),
        (["kitti-like-cars", "--root", "."], 2, "takes no --root"),
        (["kitti-like-cars", "--meshes", "."], 1, "takes no folder of meshes"),
        (["kitti-like-cars", "--counts", "1,2"], 1, "expected three counts of pairs"),
        (["kitti-like-cars", "--counts", "1,2,x"], 1, "expected three counts of pairs"),
        (["kitti-like-cars", "--seed", "-1"], 1, "expected a seed >= 0"),
    ],
)
def test_the_command_refuses_what_cannot_be_and_writes_nothing(arguments, code, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command("pairs", *arguments, "--out", "set") == code
    assert message in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []
