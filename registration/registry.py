"""Names to registration methods: ours, and those that outside packages announce by entry point."""

import importlib
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from registration.errors import BrokenMethodError, DuplicateMethodError, UnknownMethodError
from registration.types import RegistrationMethod

ENTRY_POINT_GROUP = "registration.methods"

# name -> where it lives; imported when asked for, so that no method's library is loaded in vain
BUILT_IN = {
    "centroid": "registration.methods.centroid:Centroid",
    "icp": "registration.methods.icp:PointToPointICP",
}


def create(method: str | RegistrationMethod, **settings: Any) -> RegistrationMethod:
    """Make a registration method from its name and settings; an instance is passed through.

    Args:
        method: a name out of `names()`, or a ready instance.
        settings: fields of the method's dataclass, e.g. `max_distance=0.1`.

    Raises:
        UnknownMethodError: nobody registered that name.
        DuplicateMethodError: two packages claim that name.
        BrokenMethodError: its package cannot be imported.
        MissingLibraryError: it needs an optional library that is not installed.
        TypeError: a setting that the method does not have, or settings for an instance.
    """
    if not isinstance(method, str):
        if settings:
            raise TypeError(f"settings {sorted(settings)} go with a method's name, not with an instance")
        return method
    return load_class(method)(**settings)


def names() -> list[str]:
    """List the names of all methods, our own and outside ones, also those that turn out to be broken."""
    return sorted({*BUILT_IN, *(point.name for point in _outside())})


def load_class(name: str) -> type:
    """Import the class behind a method's name.

    Raises:
        UnknownMethodError, DuplicateMethodError, BrokenMethodError: see `create`.
    """
    claims = [point for point in _outside() if point.name == name]
    owners = [describe(point) for point in claims]
    if name in BUILT_IN and claims:
        raise DuplicateMethodError(f"method {name!r} is regmot's own, and claimed by {owners[0]} too")
    if len(claims) > 1:
        raise DuplicateMethodError(f"method {name!r} is claimed by {' and by '.join(owners)}")
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    if not claims:
        raise UnknownMethodError(name, names())
    try:
        return claims[0].load()
    except (ImportError, AttributeError, SyntaxError) as error:
        raise BrokenMethodError(f"method {name!r} of {owners[0]} cannot be imported: {error}") from error


def source_of(name: str) -> str:
    """Say who provides a method: `regmot`, or the outside package."""
    if name in BUILT_IN:
        return "regmot"
    return " and ".join(describe(point) for point in _outside() if point.name == name)


def describe(point: EntryPoint) -> str:
    """Name an entry point as `package (module:attribute)`."""
    package = point.dist.name if point.dist is not None else "an unnamed package"
    return f"{package} ({point.value})"


def _outside() -> Iterator[EntryPoint]:
    seen = set()
    for point in entry_points(group=ENTRY_POINT_GROUP):
        key = (point.name, describe(point))
        if key not in seen:  # one package found twice on the path is still one claim
            seen.add(key)
            yield point
