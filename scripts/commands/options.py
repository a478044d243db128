"""What several commands ask for in the same words, and how lists of words and of numbers are read."""

from pathlib import Path
from typing import Annotated

import typer

Root = Annotated[Path, typer.Argument(help="a KITTI tracking folder (label_02, velodyne, calib) or a raw drive")]
Sequences = Annotated[
    list[str], typer.Option("--sequence", help="name, or names with commas; may be repeated; default: all with scans")
]
Classes = Annotated[str, typer.Option(help="names, comma-separated")]
FrameName = Annotated[str, typer.Option("--frame", help="world, or sensor: relative to the ego")]
Clock = Annotated[str, typer.Option(help="auto: recorded times where there are any; nominal: 10 Hz")]
Ego = Annotated[
    str, typer.Option(help="auto, poses, oxts, odometry, refined, refined-smooth, none; refined:odometry starts there")
]
Deskew = Annotated[
    bool, typer.Option(help="raw sweeps: undo the ego's motion, and take the time between looks at an object")
]
BeamAngles = Annotated[bool, typer.Option(help="in odometry, correct KITTI's beams by 0.205 degrees")]
Split = Annotated[str, typer.Option(help="all, id-train|val|test (as published), sequence-train|val|test")]
Ranges = Annotated[str, typer.Option("--range", help="upper ends of the table's ranges [m]")]


def names_in(text: str) -> tuple[str, ...]:
    """Read names with commas between them; none in an empty text."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def numbers_in(option: str, text: str) -> tuple[float, ...]:
    """Read numbers with commas between them; other words are wrong usage of the option."""
    try:
        return tuple(float(word) for word in names_in(text))
    except ValueError:
        raise typer.BadParameter(f"{option} expects numbers, comma-separated, got {text!r}") from None
