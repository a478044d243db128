"""What can be used here: of estimators and registration methods, those whose libraries are installed."""

from collections.abc import Iterable


def state_of(name: str) -> str:
    """Say whether an estimator, or a registration method, can be created here, or why not."""
    from registration.errors import RegistrationError
    from tracker.estimators import create_estimator

    try:
        create_estimator(name)
    except (RegistrationError, TypeError, ValueError) as error:
        return str(error)
    return "ready"


def ready(names: Iterable[str]) -> tuple[str, ...]:
    """Keep the names of what can be created here."""
    return tuple(name for name in names if state_of(name) == "ready")
