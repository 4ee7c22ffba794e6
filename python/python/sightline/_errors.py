"""Exceptions. Every exception of the package is a SightlineError, except TypeError for arguments of a wrong type,
IndexError for unknown cells, and exceptions of numpy and of the system."""


class SightlineError(Exception):
    """The base class. The message names the element, the reason and the remedy."""


class OptionError(SightlineError, ValueError):
    """An option has an invalid value, or conflicts with another option. `option` is the name of the option, or None
    if several options are involved."""

    def __init__(self, text: str, option: "str | None" = None) -> None:
        super().__init__(text)
        self.option = option


class InputError(SightlineError, ValueError):
    """A mesh, a file or stored data cannot be used."""


class Error(InputError):
    """A result is not a complete, unmodified .pvs file."""


class Refused(SightlineError):
    """A claim of a result does not hold (`verify`)."""

    def __init__(self, reason: str, cell: "int | None" = None) -> None:
        where = "" if cell is None else f"cell {cell}: "
        super().__init__(f"{where}{reason}; the result is damaged or was altered, bake it again")
        self.reason = reason
        self.cell = cell


class CoordinatorError(SightlineError):
    """The coordinator is unreachable or rejects the call."""


class JobError(SightlineError):
    """A job ended without a result."""
