"""A training that is killed and goes on ends where one that is not killed ends; and it learns."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch

from registration.alignnet import checkpoint
from registration.alignnet.augment import AugmentSettings
from registration.alignnet.errors import TrainingError, WeightsError
from registration.alignnet.loss import LossSettings
from registration.alignnet.network import Architecture
from registration.alignnet.recipe import OptimiserSettings, Recipe, TrainingSettings, to_table
from registration.alignnet.train import STATE, Training
from registration.alignnet.validate import validate
from tests import learned

RECIPE = Recipe(
    network=Architecture(**learned.SMALL),
    loss=LossSettings(unit=0.2, translation=2.0),
    augment=AugmentSettings(jitter=0.01, turn=True, swap=0.5, occlusion=0.5, clutter=0.5),
    optimiser=OptimiserSettings("adamw", 0.01, "one-cycle", weight_decay=0.01, clip=10.0, norm_momentum=0.1),
    training=TrainingSettings(epochs=3, batch_size=8, max_points=32, fewest_points=16, validation_points=32),
)


def columns(held):
    return {"rmse_t": float(np.sqrt((held.errors[:, 0] ** 2).mean()))}


def training(out, recipe=RECIPE, **more):
    return Training(recipe, learned.packed(28), learned.packed(8, seed=9), out, columns, **more)


def weights_of(path):
    return checkpoint.read_weights(path)[0].state_dict()


@pytest.mark.parametrize(
    ("precision", "step", "near"), [("float32", 2, 0.0), ("float32", 3, 15.0), ("bfloat16", 7, 15.0)]
)
def test_a_training_that_is_killed_ends_with_the_same_weights(tmp_path, precision, step, near):
    recipe = replace(RECIPE, training=replace(RECIPE.training, precision=precision, near=near, near_times=3))
    whole = weights_of(training(tmp_path / "whole", recipe).run())
    training(tmp_path / "killed", recipe).run(stop_after=step)
    assert not (tmp_path / "killed" / "weights.safetensors").exists()
    resumed = weights_of(training(tmp_path / "killed", recipe).run())
    for name, tensor in whole.items():
        assert torch.equal(tensor, resumed[name]), name


def test_pairs_of_near_objects_make_an_epoch_longer(tmp_path):
    pairs = learned.packed(28)
    n_near = int((np.hypot(*pairs.center[::2, :2].T) < 15.0).sum())
    assert 0 < n_near < 28
    recipe = replace(RECIPE, training=replace(RECIPE.training, near=15.0, near_times=3))
    assert training(tmp_path / "a").n_steps == 28 // 8
    assert training(tmp_path / "b", recipe).n_steps == (28 + 2 * n_near) // 8


def test_another_seed_ends_elsewhere(tmp_path):
    recipe = replace(RECIPE, training=replace(RECIPE.training, seed=1))
    one, other = weights_of(training(tmp_path / "0").run()), weights_of(training(tmp_path / "1", recipe).run())
    assert not torch.equal(one["fine.layers.0.weight"], other["fine.layers.0.weight"])


def test_the_log_has_a_line_an_epoch_and_the_table_goes_with_the_weights(tmp_path):
    path = training(tmp_path, about={"data": ({"name": "set"},), "commit": "abc"}).run()
    rows = list(csv.DictReader((tmp_path / "log.csv").open(newline="")))
    assert [row["epoch"] for row in rows] == ["1", "2", "3"]
    about = checkpoint.read_weights(path)[1]
    assert float(rows[-1]["rmse_t"]) == pytest.approx(about.validation["rmse_t"], rel=1e-5)
    assert about.covariance_scale > 0.0
    assert (about.recipe, about.data, about.commit) == (RECIPE, ({"name": "set"},), "abc")


def test_a_few_steps_on_a_few_pairs_learn_them(tmp_path):
    recipe = replace(
        RECIPE,
        network=Architecture(**learned.FEW),
        augment=AugmentSettings(),
        training=replace(RECIPE.training, epochs=60, fewest_points=0, max_points=64, validate_every=60),
    )
    pairs = learned.packed(24)
    made = Training(recipe, pairs, pairs, tmp_path, columns)
    before = np.median(validate(made.network, pairs, 64).errors[:, 0])
    path = made.run()
    after = np.median(validate(checkpoint.read_weights(path)[0], pairs, 64).errors[:, 0])
    assert after < 0.3 * before


def test_another_recipe_does_not_go_on_with_a_training(tmp_path):
    training(tmp_path).run(stop_after=1)
    other = replace(RECIPE, optimiser=replace(RECIPE.optimiser, rate=0.02))
    with pytest.raises(TrainingError, match="another recipe or on other pairs"):
        training(tmp_path, other).run()


def test_how_often_it_is_saved_may_change(tmp_path):
    training(tmp_path).run(stop_after=1)
    other = replace(RECIPE, training=replace(RECIPE.training, save_minutes=1.0, threads=1, validate_every=1))
    assert training(tmp_path, other).run().is_file()


def test_a_damaged_state_is_refused(tmp_path):
    training(tmp_path).run(stop_after=1)
    state = tmp_path / STATE
    state.write_bytes(state.read_bytes()[:-10])
    with pytest.raises(WeightsError, match="state.safetensors: no whole safetensors file"):
        training(tmp_path).run()


def test_too_few_pairs_are_refused(tmp_path):
    recipe = replace(RECIPE, training=replace(RECIPE.training, batch_size=64))
    with pytest.raises(TrainingError, match="28 pairs make no batch of 64"):
        training(tmp_path, recipe)


def test_a_loss_that_explodes_is_an_error(tmp_path):
    recipe = replace(RECIPE, optimiser=replace(RECIPE.optimiser, rate=1e30, clip=0.0))
    with pytest.raises(TrainingError, match=r"the loss is .* lower optimiser.rate"):
        training(tmp_path, recipe).run()


def test_fine_tuning_starts_from_weights(tmp_path):
    first = training(tmp_path / "first").run()
    second = training(tmp_path / "second", start_from=first)
    for name, tensor in weights_of(first).items():
        assert torch.equal(second.network.state_dict()[name], tensor)
    about = checkpoint.read_weights(second.run())[1]
    assert about.started_from["recipe"]["training"] == to_table(RECIPE)["training"]
    assert about.started_from["commit"] == checkpoint.read_weights(first)[1].commit
    with pytest.raises(TrainingError, match="network of another kind"):
        training(tmp_path / "third", replace(RECIPE, network=Architecture()), start_from=first)
