"""What can go wrong with the network's files."""

from registration.errors import RegistrationError


class WeightsError(RegistrationError, ValueError):
    """A weights file is missing, damaged, or not one of ours; the message names it."""


class RecipeError(RegistrationError, ValueError):
    """A training recipe holds something unknown or impossible; the message names the setting."""


class TrainingError(RegistrationError, RuntimeError):
    """Training cannot start or go on; the message says why."""
