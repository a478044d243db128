"""Beam models by name, and the table files that describe them."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.lidar.beams import BeamModel, Jitter, Turn

_FOLDER = Path(__file__).parent / "tables"
_SETTING = re.compile(r"#\s*(\w+)\s*=\s*(.*)")

# Columns of a table: the attribute each one fills, and the factor to its unit.
_COLUMNS = {
    "elevation_deg": ("elevations", np.pi / 180.0),
    "azimuth_offset_deg": ("azimuth_offsets", np.pi / 180.0),
    "beam_height": ("beam_heights", 1.0),
    "range_offset": ("range_offsets", 1.0),
}
_ANGLES = ("azimuth_step", "cut_azimuth", "divergence", "min_grazing")


def _switch(text: str) -> bool:
    """Read `true` or `false`."""
    if text not in ("true", "false"):
        raise ValueError("true or false")
    return text == "true"


def _turn(text: str) -> Turn:
    """Read the way a sensor turns."""
    if text not in tuple(Turn):
        raise ValueError(" or ".join(Turn))
    return Turn(text)


def _number(text: str) -> float:
    """Read a finite number."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError("a number") from None
    if not np.isfinite(value):
        raise ValueError("a finite number")
    return value


def _angle(text: str) -> float:
    """Read degrees."""
    return float(np.deg2rad(_number(text)))


def _settings() -> dict[str, tuple[str, Callable[[str], object]]]:
    """List what a table may set: the attribute of each key, and how to read it.  Angles are in degrees there."""
    readers: dict[type, Callable[[str], object]] = {str: str, float: _number, bool: _switch, Turn: _turn}
    settings: dict[str, tuple[str, Callable[[str], object]]] = {}
    for field in dataclasses.fields(BeamModel):
        if field.name in _ANGLES:
            settings[f"{field.name}_deg"] = (field.name, _angle)
        elif field.type in readers:
            settings[field.name] = (field.name, readers[field.type])
    return settings


def read_beam_table(path: Path) -> BeamModel:
    """Read a beam model from a table: a CSV file with a row for each beam, and settings in its comments.

    `# max_range = 100` sets an attribute of `BeamModel`, angles in degrees (`# azimuth_step_deg = 0.2`); `name` and
    `azimuth_step_deg` must be there.  Other lines that start with # are remarks.  Then comes a header with
    `elevation_deg` and any of `azimuth_offset_deg` (counter-clockwise), `beam_height` [m] and `range_offset` [m],
    then the beams.

    Args:
        path: the file.

    Raises:
        SimulationError: the file cannot be read, or does not say what a beam model needs; names file and line.
    """
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise SimulationError(f"{path}: a beam table cannot be read: {error}") from None
    values: dict[str, object] = {}
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        setting = _SETTING.fullmatch(line)
        if setting is not None:
            attribute, value = _read_setting(f"{path}:{number}", *setting.groups())
            values[attribute] = value
        elif line and not line.startswith("#"):
            rows.append((number, [cell.strip() for cell in line.split(",")]))
    for attribute, key in (("name", "name"), ("azimuth_step", "azimuth_step_deg")):
        if attribute not in values:
            raise SimulationError(f"{path}: expected a line '# {key} = ...', got none")
    try:
        return BeamModel(**values, **_read_beams(path, rows))  # type: ignore[arg-type]
    except SimulationError as error:
        raise error if str(path) in str(error) else SimulationError(f"{path}: {error}") from None


def _read_setting(where: str, key: str, text: str) -> tuple[str, object]:
    """Read one `# key = value`."""
    settings = _settings()
    if key not in settings:
        raise SimulationError(f"{where}: {unknown_name('setting', key, settings)}")
    attribute, read = settings[key]
    try:
        return attribute, read(text)
    except ValueError as error:
        raise SimulationError(f"{where}: {key} must be {error}, got {text!r}") from None


def _read_beams(path: Path, rows: list[tuple[int, list[str]]]) -> dict[str, object]:
    """Read header and beams into arrays."""
    if len(rows) < 2:
        raise SimulationError(f"{path}: expected a header line and a line for each beam, got {len(rows)} lines")
    number, header = rows[0]
    for name in header:
        if name not in _COLUMNS:
            raise SimulationError(f"{path}:{number}: {unknown_name('column', name, _COLUMNS)}")
    if "elevation_deg" not in header or len(set(header)) != len(header):
        raise SimulationError(f"{path}:{number}: expected elevation_deg once among the columns, got {','.join(header)}")
    table = np.array([_read_beam(f"{path}:{number}", cells, len(header)) for number, cells in rows[1:]])
    return {_COLUMNS[name][0]: table[:, k] * _COLUMNS[name][1] for k, name in enumerate(header)}


def _read_beam(where: str, cells: list[str], n_columns: int) -> list[float]:
    """Read the numbers of one beam."""
    if len(cells) != n_columns:
        raise SimulationError(f"{where}: expected {n_columns} numbers, got {len(cells)}")
    try:
        return [_number(cell) for cell in cells]
    except ValueError as error:
        raise SimulationError(f"{where}: each cell must be {error}, got {','.join(cells)!r}") from None


# A specimen of the kind that KITTI's car carries, and that one as far as it was measured.
HDL_64E = read_beam_table(_FOLDER / "hdl-64e.csv").as_built(seed=64)
HDL_64E_KITTI = read_beam_table(_FOLDER / "hdl-64e-kitti.csv").as_built(seed=64, azimuth_spread=0.0)
VLP_16 = read_beam_table(_FOLDER / "vlp-16.csv")
VLP_32C = read_beam_table(_FOLDER / "vlp-32c.csv")
OS1_128 = read_beam_table(_FOLDER / "os1-128.csv")

# The sensor of AlignNet-3D's synthetic sets (3DV 2019): it loses nothing, and its noise is on the coordinates.
SYMMETRIC_64 = BeamModel(
    name="symmetric-64",
    elevations=np.deg2rad(np.linspace(-13.45, 13.45, 64)),
    azimuth_step=2.0 * np.pi / 4500.0,
    is_free_running=False,
    height=0.0,
    min_range=0.0,
    max_range=1000.0,
    range_noise=0.0,
    jitter=Jitter(),
    reach=np.inf,
    min_grazing=0.0,
    misfire=0.0,
    loss_scale=0.0,
    intensity_noise=0.0,
)

_MODELS = {model.name.lower(): model for model in (HDL_64E, HDL_64E_KITTI, SYMMETRIC_64, VLP_16, VLP_32C, OS1_128)}


def beam_models() -> list[str]:
    """List the names of the beam models that we have."""
    return sorted(_MODELS)


def beam_model(name_or_path: str | Path) -> BeamModel:
    """Give a beam model by its name, in any case, or read one from a table file (`read_beam_table`).

    Raises:
        SimulationError: no model has this name, or the file is not a beam table.
    """
    name = str(name_or_path)
    if name.lower() in _MODELS:
        return _MODELS[name.lower()]
    path = Path(name_or_path)
    if path.suffix == ".csv" or path.exists():
        return read_beam_table(path)
    raise SimulationError(f"{unknown_name('beam model', name.lower(), _MODELS)} Or the path of a table (.csv).")
