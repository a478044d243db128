"""What can go wrong between files and velocities: one family, each also a builtin kind."""

from collections.abc import Iterable
from pathlib import Path

from registration.errors import unknown_name


class TrackerError(Exception):
    """Base of every error that the package `tracker` raises on purpose."""


class DataError(TrackerError, ValueError):
    """A file holds something else than its format promises.

    The message starts with the path, and the line where there is one: `labels.txt:17: expected ..., got ...`.
    """

    def __init__(self, path: Path, message: str, line: int | None = None) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")


class MissingDataError(TrackerError, FileNotFoundError):
    """A file or folder that a data set must have is not there."""


class UnknownEstimatorError(TrackerError, LookupError):
    """An estimator was asked for by a name that is neither an estimator's nor a registration method's."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(unknown_name("estimator", name, known))


class InputError(TrackerError, ValueError):
    """An argument does not make sense; the message says what was expected and what came."""


class AbruptEndError(TrackerError, RuntimeError):
    """Processes that did the work were killed, or crashed in a library; what they finished is kept."""
