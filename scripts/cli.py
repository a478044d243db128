"""The command `regmot`: its commands in the order of its help, and how errors end it."""

import sys

import typer

from .commands.benchmark import benchmark
from .commands.registration import methods, pairs, register, splits, train
from .commands.simulation import realism, simulate
from .commands.velocity import compare, demo, track

COMMANDS = (demo, simulate, compare, track, register, pairs, train, methods, splits, realism, benchmark)

app = typer.Typer(
    help="How fast is that car? Velocities of tracked objects by registering their own LiDAR points.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in COMMANDS:
    app.command()(command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; our own errors end it with one line on stderr and exit code 1."""
    from registration.errors import RegistrationError
    from tracker.errors import TrackerError

    try:
        app(arguments)
    except (TrackerError, RegistrationError, OSError) as error:
        typer.echo(f"regmot: {error}", err=True)
        sys.exit(1)
