"""`regmot train` reads sets, trains, prints the paper's table, and leaves weights that are a method."""

import json

import numpy as np
import pytest
from regmot.cli import main

import registration
from registration.alignnet import checkpoint
from registration.pair_set import write_pair_set
from tests import learned

SMALL = [f"network.{name}={list(sizes)}" for name, sizes in learned.SMALL.items()]
SHORT = ["training.epochs=2", "training.batch_size=4", "training.max_points=16", "training.fewest_points=0"]


@pytest.fixture
def pair_set(tmp_path):
    rng = np.random.default_rng(0)
    pairs = [(part, learned.pair(rng)) for part in ("train",) * 9 + ("val",) * 3]
    return write_pair_set(tmp_path / "cars", pairs, {"name": "cars", "seed": 4}).folder


def command(pair_set, out, *more):
    settings = [word for setting in (*SMALL, *SHORT) for word in ("--set", setting)]
    return ["train", "cpu", "--data", str(pair_set), "--out", str(out), *settings, *more]


def run(arguments):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return ended.value.code


def test_training_from_the_command_line_makes_a_method(pair_set, tmp_path, capsys):
    assert run(command(pair_set, tmp_path / "out", "--data", str(pair_set))) == 0
    printed = capsys.readouterr().out
    assert "RMSE t [m]" in printed
    assert "< 80 m" in printed
    path = tmp_path / "out" / "weights.safetensors"
    _, about = checkpoint.read_weights(path)
    assert [(made["name"], made["seed"]) for made in about.data] == [("cars", 4)] * 2
    assert about.validation["n_80m"] == 6
    assert about.recipe.training.epochs == 2
    method = registration.create("alignnet", weights=str(path))
    cloud = np.random.default_rng(0).uniform(8.0, 10.0, (50, 3))
    assert np.isfinite(method.register(cloud, cloud).T_target_source).all()


def test_what_cannot_be_trained_is_one_line_and_exit_code_1(pair_set, tmp_path, capsys):
    assert run(command(pair_set, tmp_path / "out", "--set", "training.epoch=3")) == 1
    assert "regmot: cpu: training: unknown setting 'epoch'" in capsys.readouterr().err
    assert run(command(tmp_path, tmp_path / "out")) == 1
    assert "expected a set of pairs" in capsys.readouterr().err
    (pair_set / "split" / "train.txt").write_text(json.dumps("x"))
    assert run(command(pair_set, tmp_path / "out")) == 1
    assert "train.txt" in capsys.readouterr().err
