"""Injected defects, with which `--self-check` proves that the checks of the harness detect problems."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from typing import Callable

from . import disk, faults
from .drawing import Fault
from .farm import Farm
from .nodes import COORDINATOR, FIRST_WORKER
from .plan import Errand, Schedule
from .processes import wait_until
from .worlds import Calm


@dataclass(frozen=True)
class Act:
    """An injected defect, and a part of the problem that a check must report."""

    do: Callable[[Farm], None]
    said: str
    # The time of the injection, in seconds after the start of the schedule.
    at: float = 3.0


# The time limit for the three submissions, in seconds.
WAIT = 60.0


def _lose_commits(farm: Farm) -> None:
    """Truncates the journal, so that acknowledged changes are lost."""
    if not wait_until(lambda: len(farm.ask(["jobs"]) or []) == 3, WAIT, every=0.5):
        raise RuntimeError("the coordinator did not acknowledge the three jobs in time")
    farm.take_down(COORDINATOR)
    # Only the header of the journal remains.
    os.truncate(farm.disk.journal, disk.JOURNAL_HEADER)
    farm.let_up(COORDINATOR)


def _change_calm_run(farm: Farm) -> None:
    """Flips a bit of the calm run, in a copy for this farm."""
    mine = farm.folder / "calm"
    mine.mkdir()
    for kind in ("*.glb", "*.pvs"):
        for file in farm.calm.folder.glob(kind):
            shutil.copy(file, mine)
    farm.calm = Calm(farm.calm.program, mine)
    if disk.flip(farm.calm.result(farm.world, 0), 0.5, 0) is None:
        raise RuntimeError("the file of the calm run is empty or missing")


def _tell_a_secret(farm: Farm) -> None:
    """Writes the secret of a token into a log."""
    if farm.keys is None:
        raise RuntimeError("the farm has no keys, so it has no secrets")
    with (farm.logs / "worker-2.log").open("ab") as log:
        log.write(b"authorization: " + farm.keys.secrets()[-1] + b"\n")


def _panic(farm: Farm) -> None:
    """Writes a panic into a log."""
    with (farm.logs / "coordinator.log").open("ab") as log:
        log.write(b"thread 'store-writer' panicked at somewhere.rs:1:1:\n")


def _leave_a_process(farm: Farm) -> None:
    """Starts a process that outlives the farm."""
    # The process ends with the namespaces of the command.
    subprocess.Popen(["sleep", "86400"],
                     env={"XDG_CACHE_HOME": str(farm.folder / "cache"), "PATH": os.environ["PATH"]})


def _believe_a_liar(farm: Farm) -> None:
    """Replaces an honest worker by a liar.

    The world has no spot checks, so the coordinator accepts wrong outputs.
    """
    farm.liars.add(FIRST_WORKER)
    farm.take_down(FIRST_WORKER)
    farm.let_up(FIRST_WORKER)


ACTS = {
    # The coordinator detects this defect itself, and does not start.
    "lose_commits": Act(_lose_commits, "the latest acknowledged changes of jobs are lost"),
    "change_calm_run": Act(_change_calm_run, "the first that differs"),
    "tell_a_secret": Act(_tell_a_secret, "contains a secret"),
    "panic": Act(_panic, "panicked at"),
    "leave_a_process": Act(_leave_a_process, "still runs"),
    "believe_a_liar": Act(_believe_a_liar, "the first that differs", at=0.0),
}


def needs_liar(schedule: Schedule) -> bool:
    """Returns true if a defect of the schedule makes a worker a liar."""
    return any(fault.kind == "believe_a_liar" for fault in schedule.faults)


def schedules() -> list[Schedule]:
    """Returns a schedule for each defect, with the defect as its only fault."""
    for name, act in ACTS.items():
        faults.BEGIN[name] = lambda farm, _, act=act: (act.do(farm), lambda: None)[1]
    errands = (Errand(0.0, "submit", 0), Errand(0.2, "submit", 1), Errand(0.4, "submit", 2))
    return [Schedule(at, "lines", 2, True, False, False, 1, errands, (Fault(act.at, name, COORDINATOR, 0.0),))
            for at, (name, act) in enumerate(ACTS.items())]
