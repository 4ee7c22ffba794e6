"""What can go wrong. Every exception of the package is a SightlineError, except TypeError for arguments of a
wrong type, IndexError for cells that are not there, and what numpy and the system raise."""


class SightlineError(Exception):
    """Something failed; the message says what, where, and what to do."""


class OptionError(SightlineError, ValueError):
    """An option has a value that it cannot have, or does not go with another one. `option` is its name, where
    one option is at fault."""

    def __init__(self, text: str, option: "str | None" = None) -> None:
        super().__init__(text)
        self.option = option


class InputError(SightlineError, ValueError):
    """A mesh, a file or stored data cannot be used."""


class Error(InputError):
    """A result is refused: it is no whole, unaltered .pvs file."""


class Refused(SightlineError):
    """A claim of a result does not hold (`verify`)."""

    def __init__(self, reason: str, cell: "int | None" = None) -> None:
        where = "" if cell is None else f"cell {cell}: "
        super().__init__(f"{where}{reason}; the result is damaged or was altered, bake it again")
        self.reason = reason
        self.cell = cell


class CoordinatorError(SightlineError):
    """The coordinator cannot be reached, or refuses."""


class JobError(SightlineError):
    """A job ended without a result."""
