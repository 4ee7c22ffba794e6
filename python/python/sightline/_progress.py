"""How far a bake, a job or a measurement is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Optional


@dataclass(frozen=True)
class Progress:
    """What a `progress` function is called with, several times a second at most."""

    #: How many are done.
    done: int
    #: How many there are; 0 while that is not known.
    total: int
    #: What is counted: cells, tiles or frames.
    what: str
    #: The state of the job: queued, running, paused, cancelled, failed or done.
    state: str
    #: The time left, where it can be told.
    seconds_left: Optional[float]

    @property
    def fraction(self) -> float:
        """The part that is done, from 0 to 1."""
        return self.done / self.total if self.total else 0.0

    def __str__(self) -> str:
        left = "" if self.seconds_left is None else f", about {self.seconds_left:.0f} s left"
        return f"{self.done}/{self.total} {self.what}, {self.state}{left}"


OnProgress = Callable[[Progress], object]


def caller(
    progress: Optional[OnProgress],
) -> Optional[Callable[[int, int, str, str, Optional[float]], object]]:
    """The function that the native part calls."""
    if progress is None:
        return None
    if not callable(progress):
        raise TypeError(f"progress is a function of a Progress, and not {type(progress).__name__}")
    return lambda *of: progress(Progress(*of))
