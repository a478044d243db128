"""Names to registration methods: ours, and those that outside packages announce by entry point."""

import importlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import reduce
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from registration.errors import BrokenMethodError, DuplicateMethodError, UnknownMethodError
from registration.types import RegistrationMethod

ENTRY_POINT_GROUP = "registration.methods"

# name -> where it lives; imported when asked for, so that no method's library is loaded in vain
BUILT_IN = {
    "adh-2d": "registration.methods.adh:AnnealedHistograms2D",
    "adh-3d": "registration.methods.adh:AnnealedHistograms3D",
    "adh-3d-tuned": "registration.methods.adh:TunedHistograms3D",
    "alignnet": "registration.alignnet.method:AlignNetCars",
    "alignnet-persons": "registration.alignnet.method:AlignNetPersons",
    "centroid": "registration.methods.centroid:Centroid",
    "icp": "registration.methods.icp:PointToPointICP",
    "plane-icp": "registration.methods.plane_icp:PointToPlaneICP",
    "fused": "registration.methods.fused:FusedRegistration",
    "fgr": "registration.methods.fgr:FastGlobalRegistration",
    "gicp": "registration.methods.gicp:GeneralizedICP",
    "global-icp": "registration.methods.global_icp:GlobalICP",
}


# compositions worth a line in every list; any two names work
COMPOSED = ("alignnet+gicp", "alignnet+icp", "fgr+icp", "global-icp+icp")


def create(method: str | RegistrationMethod, **settings: Any) -> RegistrationMethod:
    """Make a registration method from its name and settings; an instance is passed through.

    Two names with a plus between them, as `gicp+icp`, make a method whose answer the second refines
    (`registration.refined`).  Its settings go by the parts' names: `create("fgr+icp", icp={"max_distance": 0.2})`,
    `create("global-icp+icp", **{"global-icp": {"seed": 1}})`.

    Args:
        method: a name out of `names()`, a composition of names, or a ready instance.
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
    leaves = parts(method)
    if len(leaves) > 1:
        return _compose(leaves, settings)
    return load_class(method)(**settings)


def with_seed(method: RegistrationMethod, seed: int) -> RegistrationMethod:
    """Give a method, or the parts of a composed one, a seed, where there is such a setting; others stay as they are."""
    if not is_dataclass(method):
        return method
    changes: dict[str, Any] = {}
    for field in fields(method):
        value = getattr(method, field.name)
        if field.name == "seed":
            changes["seed"] = seed
        elif isinstance(value, RegistrationMethod):
            changes[field.name] = with_seed(value, seed)
    return replace(method, **changes) if changes else method


def parts(name: str) -> list[str]:
    """Split the name of a composition into those of its parts, in the order of work; other names are left whole.

    >>> parts("fgr+icp"), parts("icp")
    (['fgr', 'icp'], ['icp'])
    """
    return [name] if "+" not in name or name in _single_names() else name.split("+")


def is_known(name: str) -> bool:
    """Say whether `create` knows a name: a method's, or that of a composition of methods, listed or not."""
    return _single_names().issuperset(parts(name))


def names() -> list[str]:
    """List the names of all methods, our own and outside ones, also those that turn out to be broken."""
    return sorted({*_single_names(), *COMPOSED})


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
    except Exception as error:  # whatever an outside module does when it is imported must harm nobody else
        raise BrokenMethodError(f"method {name!r} of {owners[0]} cannot be imported: {error}") from error


def source_of(name: str) -> str:
    """Say who provides a method: `regmot`, or the outside package."""
    if len(parts(name)) > 1:
        return " and ".join(dict.fromkeys(source_of(part) for part in parts(name)))
    if name in BUILT_IN:
        return "regmot"
    return " and ".join(describe(point) for point in _outside() if point.name == name)


def describe(point: EntryPoint) -> str:
    """Name an entry point as `package (module:attribute)`."""
    package = point.dist.name if point.dist is not None else "an unnamed package"
    return f"{package} ({point.value})"


def _single_names() -> set[str]:
    return {*BUILT_IN, *(point.name for point in _outside())}


def _compose(names_of_parts: list[str], settings: dict[str, Any]) -> RegistrationMethod:
    """Create the parts, each with the settings that go by its name, and let each refine the one before."""
    from registration.refined import refined  # here: it needs `create`

    for part, values in settings.items():
        if part not in names_of_parts or not isinstance(values, dict):
            raise TypeError(
                f"settings of {'+'.join(names_of_parts)} are dictionaries by the names of its parts, "
                f"as icp={{...}}; got {part}={values!r}"
            )
    return reduce(refined, (create(part, **settings.get(part, {})) for part in names_of_parts))


def _outside() -> Iterator[EntryPoint]:
    seen = set()
    for point in entry_points(group=ENTRY_POINT_GROUP):
        key = (point.name, describe(point))
        if key not in seen:  # one package found twice on the path is still one claim
            seen.add(key)
            yield point
