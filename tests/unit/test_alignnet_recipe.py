"""Recipes are read, overridden and refused setting by setting; schedules follow the paper."""

import pytest

from registration.alignnet.errors import RecipeError
from registration.alignnet.optimisation import learning_rate, norm_momentum
from registration.alignnet.recipe import OptimiserSettings, from_table, read_recipe, recipe_names, to_table


@pytest.mark.parametrize("name", recipe_names())
def test_our_recipes_are_whole(name):
    recipe = read_recipe(name)
    assert from_table(to_table(recipe), "again") == recipe


def test_the_papers_recipe_is_the_papers():
    recipe = read_recipe("paper")
    assert (recipe.training.epochs, recipe.training.batch_size, recipe.training.max_points) == (200, 128, 512)
    assert (recipe.optimiser.name, recipe.optimiser.rate) == ("adam", 0.005)
    assert recipe.loss.residual == 20.0
    switches = (recipe.network.view_axes, recipe.network.sensor_context, recipe.network.branch_norms)
    assert switches == (False, False, False)


def test_overrides_win(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[training]\nepochs = 7\n")
    recipe = read_recipe(path, ["training.epochs=3", "loss.heading=full", "network.head=[8, 4]", "loss.unit=1"])
    assert recipe.training.epochs == 3
    assert recipe.loss.heading == "full"
    assert recipe.network.head == (8, 4)
    assert recipe.loss.unit == 1.0


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["training.epoch=3"], "training: unknown setting 'epoch'; expected one of epochs"),
        (["trainin.epochs=3"], "unknown setting 'trainin'"),
        (["training.epochs=many"], "training: epochs must be int, got 'many'"),
        (["training.epochs=0"], "epochs must be at least 1, got 0"),
        (["training.precision=half"], "precision must be one of float32, bfloat16"),
        (["optimiser.name=sgd"], "name must be one of adam, adamw"),
        (["optimiser.schedule=step"], "halving, cosine, one-cycle"),
        (["optimiser.rate=0.0"], "rate must be positive"),
        (["loss.heading=min"], "heading must be one of"),
        (["network.head=512"], "head must be a list of whole numbers"),
        (["network=3"], "expected section.name=value"),
        (["training"], "expected section.name=value"),
        (["training.epochs.more=3"], "epochs is a setting and no section"),
    ],
)
def test_what_a_recipe_cannot_mean_is_refused(overrides, message):
    with pytest.raises(RecipeError, match=message):
        read_recipe("paper", overrides)


def test_a_recipe_that_is_not_there_names_ours():
    with pytest.raises(RecipeError, match=r"fast: expected a .toml file or one of cpu, fine-tune, gpu, paper"):
        read_recipe("fast")


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[training\n")
    with pytest.raises(RecipeError, match="mine.toml: cannot be read as TOML"):
        read_recipe(path)
    with pytest.raises(RecipeError, match="none.toml: cannot be read"):
        read_recipe(tmp_path / "none.toml")


def test_the_papers_rate_halves_every_thirty_epochs():
    paper = OptimiserSettings()
    assert [learning_rate(paper, epoch, 200) for epoch in (0.0, 29.9, 30.0, 60.0)] == [0.005, 0.005, 0.0025, 0.00125]
    assert learning_rate(paper, 199.0, 200) == 0.005 / 2**6


def test_the_papers_averages_forget_ever_more_slowly():
    decay = [1.0 - norm_momentum(OptimiserSettings(), epoch) for epoch in (0, 30, 60, 90, 120, 150, 180)]
    assert decay == [0.5, 0.75, 0.875, 0.9375, 0.96875, 0.984375, 0.99]


def test_one_cycle_rises_and_falls():
    settings = OptimiserSettings(schedule="one-cycle", rate=1.0, least_rate=0.0, warm_up=0.2)
    rates = [learning_rate(settings, epoch, 10) for epoch in (0.0, 1.0, 2.0, 6.0, 10.0)]
    assert rates == pytest.approx([0.04, 0.52, 1.0, 0.5, 0.0])
