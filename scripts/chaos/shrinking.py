"""The reduction of a failing schedule: removes faults one at a time while the schedule still fails."""

from __future__ import annotations

import time
from typing import Callable

from .plan import Schedule


def shrink(schedule: Schedule, fails: Callable[[Schedule], bool], seconds: float) -> Schedule:
    """Returns the smallest failing schedule found within `seconds`. `fails` runs a schedule."""
    until = time.monotonic() + seconds
    at = 0
    # Begin with the last faults, because faults after the failure are unnecessary.
    while at < len(schedule.faults) and time.monotonic() < until:
        smaller = schedule.without(len(schedule.faults) - 1 - at)
        if fails(smaller):
            schedule = smaller
        else:
            at += 1
    return schedule
