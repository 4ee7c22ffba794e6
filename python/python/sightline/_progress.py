"""Progress of a bake, a job or a measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Optional


@dataclass(frozen=True)
class Progress:
    """The argument of a `progress` function, which is called at most several times per second."""

    #: The number of finished units.
    done: int
    #: The number of all units; 0 while it is unknown.
    total: int
    #: The unit: cells, tiles or frames.
    what: str
    #: The state of the job: queued, running, paused, cancelled, failed or done.
    state: str
    #: The estimated time left in seconds, or None while it is unknown.
    seconds_left: Optional[float]

    @property
    def fraction(self) -> float:
        """The finished part, from 0 to 1."""
        return self.done / self.total if self.total else 0.0

    def __str__(self) -> str:
        left = "" if self.seconds_left is None else f", about {self.seconds_left:.0f} s left"
        return f"{self.done}/{self.total} {self.what}, {self.state}{left}"


OnProgress = Callable[[Progress], object]


def caller(
    progress: Optional[OnProgress],
) -> Optional[Callable[[int, int, str, str, Optional[float]], object]]:
    """Returns the function that the native part calls, or None."""
    if progress is None:
        return None
    if not callable(progress):
        raise TypeError(f"progress must be a function of one Progress, not {type(progress).__name__}")
    return lambda *of: progress(Progress(*of))
