"""Makes a failing schedule smaller: leaves out faults one at a time as long as it still fails."""

from __future__ import annotations

import time
from typing import Callable

from .plan import Schedule


def shrink(schedule: Schedule, fails: Callable[[Schedule], bool], seconds: float) -> Schedule:
    """The smallest failing schedule found within `seconds`. `fails` runs one."""
    until = time.monotonic() + seconds
    at = 0
    # The last faults first: what comes after the failure goes away soonest.
    while at < len(schedule.faults) and time.monotonic() < until:
        smaller = schedule.without(len(schedule.faults) - 1 - at)
        if fails(smaller):
            schedule = smaller
        else:
            at += 1
    return schedule
