"""What can go wrong on the way to a registration: one family, each also a builtin kind."""

import difflib
from collections.abc import Iterable


class RegistrationError(Exception):
    """Base of every error that the package `registration` raises on purpose."""


class InvalidCloudError(RegistrationError, ValueError):
    """A cloud is no finite (N, 3) array of numbers."""


class UnknownMethodError(RegistrationError, LookupError):
    """A registration method was asked for by a name nobody registered."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(unknown_name("registration method", name, known))


class DuplicateMethodError(RegistrationError, ValueError):
    """Two packages claim one method name."""


class BrokenMethodError(RegistrationError, ImportError):
    """A plug-in is listed but cannot be imported."""


class MissingLibraryError(RegistrationError, ImportError):
    """An optional library is needed; the message says which extra installs it."""


class MethodContractError(RegistrationError, AssertionError):
    """A method breaks the plug-in contract; the message says which promise."""


class PairSetError(RegistrationError, ValueError):
    """A set of cloud pairs on disk cannot be read or written; the message names the file."""


class SimulationError(RegistrationError, ValueError):
    """A mesh or a beam model cannot be used; the message says what was expected."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Word the error for a name that is not among the known ones, with the nearest as a hint."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return f"no {kind} {name!r}.{hint} Available: {', '.join(names)}."
