"""A training recipe: every setting of a training, read from TOML, with overrides from the command line."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, get_origin, get_type_hints

from registration.alignnet.augment import AugmentSettings
from registration.alignnet.errors import RecipeError
from registration.alignnet.loss import LossSettings
from registration.alignnet.network import Architecture

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

OPTIMISERS = ("adam", "adamw")
SCHEDULES = ("halving", "cosine", "one-cycle")
PRECISIONS = ("float32", "bfloat16")


@dataclass(frozen=True)
class OptimiserSettings:
    """How weights follow gradients; the defaults are the published ones."""

    name: str = "adam"
    rate: float = 0.005  # learning rate; the largest of a schedule
    schedule: str = "halving"  # every `period` epochs; or cosine, one-cycle over the whole training
    period: int = 30  # of halving, of the rate and of the running averages' momentum [epochs]
    least_rate: float = 1e-5
    warm_up: float = 0.1  # share of a one-cycle training before the largest rate
    weight_decay: float = 0.0
    clip: float = 0.0  # largest norm of the gradient; 0: any
    norm_momentum: float = 0.0  # share of the batch in batch norm's running averages; 0: halved as published

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.name not in OPTIMISERS:
            raise ValueError(f"name must be one of {', '.join(OPTIMISERS)}, got {self.name!r}")
        if self.schedule not in SCHEDULES:
            raise ValueError(f"schedule must be one of {', '.join(SCHEDULES)}, got {self.schedule!r}")
        if not self.rate > 0.0:
            raise ValueError(f"rate must be positive, got {self.rate}")


@dataclass(frozen=True)
class TrainingSettings:
    """How long, on how much at a time, and how precisely."""

    epochs: int = 200
    batch_size: int = 128  # pairs
    max_points: int = 512  # of a cloud; more are left out at random
    fewest_points: int = 0  # if not 0, each batch draws its own limit between this and max_points
    near: float = 0.0  # objects nearer than this are rare in many sets: their pairs come `near_times` an epoch [m]
    near_times: int = 1
    validation_points: int = 512
    precision: str = "float32"  # or bfloat16, but for coordinates, statistics and losses
    seed: int = 0
    validate_every: int = 5  # epochs; also after the last
    save_minutes: float = 5.0  # a training that is killed loses no more than this
    threads: int = 0  # on a CPU; 0: as many as there are

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.precision not in PRECISIONS:
            raise ValueError(f"precision must be one of {', '.join(PRECISIONS)}, got {self.precision!r}")
        for name in ("epochs", "batch_size", "max_points", "validation_points", "validate_every", "near_times"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class Recipe:
    """All settings of a training."""

    network: Architecture = field(default_factory=Architecture)
    loss: LossSettings = field(default_factory=LossSettings)
    augment: AugmentSettings = field(default_factory=AugmentSettings)
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    training: TrainingSettings = field(default_factory=TrainingSettings)


def read_recipe(recipe: str | Path, overrides: Sequence[str] = ()) -> Recipe:
    """Read a recipe from a TOML file, or one of ours by its name.

    Args:
        recipe: a path, or a name out of `recipe_names()`.
        overrides: settings such as `training.epochs=3`, values as in TOML; text may go without quotes.

    Raises:
        RecipeError: no such recipe, a damaged file, a setting nobody knows or that cannot work.
    """
    path = Path(recipe)
    try:
        if path.suffix == ".toml":
            text = path.read_text()
        elif str(recipe) in recipe_names():
            text = (files(__package__) / "recipes" / f"{recipe}.toml").read_text()
        else:
            raise RecipeError(f"{recipe}: expected a .toml file or one of {', '.join(recipe_names())}")
        table = tomllib.loads(text)
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise RecipeError(f"{recipe}: cannot be read as TOML ({error})") from None
    for override in overrides:
        _override(table, override)
    return from_table(table, str(recipe))


def recipe_names() -> list[str]:
    """List the recipes that come with the package."""
    folder = files(__package__) / "recipes"
    return sorted(path.name.removesuffix(".toml") for path in folder.iterdir() if path.name.endswith(".toml"))


def from_table(table: Mapping[str, Any], where: str) -> Recipe:
    """Make a recipe of nested tables.

    Raises:
        RecipeError: a setting that nobody knows or that cannot work; the message names it and `where`.
    """
    return _build(Recipe, table, where)


def to_table(recipe: Recipe) -> dict[str, Any]:
    """Give a recipe as nested tables, such as `from_table` takes and JSON knows."""
    return asdict(recipe)


def _build(kind: type, table: Mapping[str, Any], where: str) -> Any:
    hints = get_type_hints(kind)
    known = {f.name: hints[f.name] for f in fields(kind)}
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name not in known:
            raise RecipeError(f"{where}: unknown setting {name!r}; expected one of {', '.join(known)}")
        if is_dataclass(known[name]):
            if not isinstance(value, Mapping):
                raise RecipeError(f"{where}: {name} must be a table, got {value!r}")
            values[name] = _build(known[name], value, f"{where}: {name}")
        else:
            values[name] = _value(value, known[name], f"{where}: {name}")
    try:
        return kind(**values)
    except ValueError as error:
        raise RecipeError(f"{where}: {error}") from None


def _value(value: Any, kind: Any, where: str) -> Any:
    """Check a value's type; whole numbers do for others, lists for tuples."""
    if get_origin(kind) is tuple:
        if not isinstance(value, list | tuple) or not all(type(item) is int for item in value):
            raise RecipeError(f"{where} must be a list of whole numbers, got {value!r}")
        return tuple(value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise RecipeError(f"{where} must be {kind.__name__}, got {value!r}")
    return value


def _override(table: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    *path, name = key.strip().split(".")
    if not equals or not path:
        raise RecipeError(f"expected section.name=value, as training.epochs=3, got {override!r}")
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise RecipeError(f"{override!r}: {part} is a setting and no section")
    try:
        table[name] = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        table[name] = text.strip()
