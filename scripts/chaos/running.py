"""One schedule from its calm begin to the checks after its end."""

from __future__ import annotations

import heapq
import shutil
import threading
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from . import checks, clients, faults
from .clients import Acknowledged, Observer
from .commands import LIAR
from .farm import Farm
from .plan import Errand, Schedule
from .worlds import Calm

# How much more memory and how many more handles a coordinator may have after its last round than after its second.
MORE_MEMORY = 32 << 20
MORE_HANDLES = 8
# Connections whose other end has vanished are noticed after this many seconds.
QUIET = 45.0
# A scene that may be damaged is sent again so often, in seconds: all jobs of a schedule have the same.
SEND = 4.0


@dataclass
class Outcome:
    """What came of a schedule."""

    seed: int
    world: str
    problems: list[str] = field(default_factory=list)
    seconds: float = 0.0
    # From the end of the last fault to the end of the last job.
    healed: float = 0.0
    faults: list[str] = field(default_factory=list)
    # Blobs that no job needs any more.
    blobs_left: int = 0
    packets: int = 0
    lost: int = 0
    # What only some worlds have: how often a coordinator began to lead, and whether a liar was found.
    besides: str = ""


def run(calm: Calm, schedule: Schedule, folder: Path, bound: float) -> Outcome:
    """Runs a schedule in `folder`, whose jobs must end within `bound` seconds after the last fault."""
    outcome = Outcome(schedule.seed, schedule.world, faults=[fault.kind for fault in schedule.faults])
    began = time.monotonic()
    folder.mkdir(parents=True)
    (folder / "schedule.json").write_text(schedule.dump())
    farm = Farm(calm, schedule, folder)
    try:
        if schedule.rounds == 1:
            _once(farm, outcome, bound)
        else:
            _rounds(farm, outcome, bound)
        outcome.besides = checks.besides(farm)
        outcome.problems += farm.end()
        outcome.problems += checks.traces(farm) + checks.left_over(farm)
    except Exception:
        # The harness's own fault; the folder is kept as after a failure of the program.
        outcome.problems.append(f"the harness failed: {traceback.format_exc()}")
    finally:
        if outcome.problems:
            _keep(farm)
        farm.remove()
    outcome.packets, outcome.lost = farm.switch.counts.sent, farm.switch.counts.lost
    outcome.seconds = time.monotonic() - began
    return outcome


def _keep(farm: Farm) -> None:
    """Copies the data directory off the file system that goes with the schedule."""
    shutil.copytree(farm.disk.at, farm.folder / "data", symlinks=True, ignore=shutil.ignore_patterns("filler-*"))


def _once(farm: Farm, outcome: Outcome, bound: float) -> None:
    """All errands and all faults, then the end of all jobs."""
    told = Acknowledged()
    farm.start()
    observer = Observer(farm, told)
    observer.start()
    last = max([0.0, *(fault.at + faults.duration(fault) for fault in farm.schedule.faults)])
    until = farm.began + last + bound
    errands = _send(farm, told, farm.schedule.errands, until)
    _weather(farm, farm.began)
    over = time.monotonic()
    farm.note("all faults are over")
    while any(errand.is_alive() for errand in errands):
        farm.tend()
        time.sleep(0.05)
    observer.end()
    _settle(farm, told, outcome, until)
    if farm.liars and not outcome.problems and _compute_again(farm):
        _settle(farm, told, outcome, until)
    outcome.healed = time.monotonic() - over
    outcome.problems += told.problems
    if outcome.problems:
        return
    _check(farm, told, outcome)
    if not told.cancelled:
        wrong, outcome.blobs_left = checks.disk_left(farm)
        outcome.problems += wrong
    # What is acknowledged is on the disk, also when the last thing that happens is a kill.
    for number in farm.coordinators:
        farm.take_down(number)
    for number in farm.coordinators:
        farm.let_up(number)
    if _answers(farm, bound):
        _check(farm, told, outcome)
    else:
        outcome.problems.append("the coordinator does not answer after its last start")


def _check(farm: Farm, told: Acknowledged, outcome: Outcome) -> None:
    for number, job in sorted(told.jobs.items()):
        if job not in told.cancelled:
            outcome.problems += checks.job(farm, job, farm.schedule.errands[number].variant)
    outcome.problems += checks.acknowledged(farm, told)
    if farm.liars:
        outcome.problems += checks.liars(farm)


def _send(farm: Farm, told: Acknowledged, errands: tuple[Errand, ...], until: float) -> list[threading.Thread]:
    threads = [threading.Thread(target=clients.run_errand, args=(farm, told, number, errand, until), daemon=True)
               for number, errand in enumerate(errands)]
    for thread in threads:
        thread.start()
    return threads


def _weather(farm: Farm, began: float) -> None:
    """Begins and ends all faults at their times."""
    # A number in each entry, for functions have no order.
    due: list[tuple[float, int, faults.Undo]] = []
    waiting = list(farm.schedule.faults)
    while waiting or due:
        now = time.monotonic() - began
        while waiting and waiting[0].at <= now:
            fault = waiting.pop(0)
            undo = faults.begin(farm, fault)
            heapq.heappush(due, (fault.at + faults.duration(fault), len(waiting), undo))
        while due and due[0][0] <= now:
            at, _, undo = heapq.heappop(due)
            undo()
            farm.note(f"the fault that was to end at {at:.2f} has ended")
        farm.tend()
        time.sleep(0.01)


def _answers(farm: Farm, bound: float) -> bool:
    until = time.monotonic() + bound
    while time.monotonic() < until:
        if farm.ask(["jobs"]) is not None:
            return True
        farm.tend()
        time.sleep(0.1)
    return False


def _settle(farm: Farm, told: Acknowledged, outcome: Outcome, until: float) -> None:
    """Waits until all jobs have ended. Does what docs say that a person does about damaged scenes and paused jobs."""
    wanted = {job: number for number, job in told.jobs.items() if job not in told.cancelled}
    sent = 0.0
    while wanted and time.monotonic() < until:
        farm.tend()
        listed = farm.ask(["jobs"])
        if listed is None:
            time.sleep(0.4)
            continue
        shown = {one["job"]: one for one in listed}
        if farm.liars and farm.shares_tiles:
            _release_honest(farm)
        for job, number in list(wanted.items()):
            if job not in shown:
                outcome.problems.append(f"job {job} was acknowledged and is not listed")
                return
            state, reason = shown[job]["state"], shown[job]["reason"]
            if state == "done":
                del wanted[job]
            elif state == "paused" and job in told.paused:
                farm.call(["resume", str(job)])
            elif state in ("failed", "cancelled"):
                outcome.problems.append(f"job {job} has ended as {state}: {reason}")
                return
            elif farm.damaged & {"scene", "tile"} and time.monotonic() > sent + SEND:
                # Which blob was a scene is not always known when it is damaged.
                sent = time.monotonic()
                farm.call(clients.submission(farm, number, farm.schedule.errands[number].variant))
                if state == "paused":
                    # For its scene, by a coordinator that has been killed since: no other knows why.
                    farm.call(["resume", str(job)])
        time.sleep(0.4)
    if wanted:
        outcome.problems.append(f"jobs {sorted(wanted)} have not ended in time:\n{farm.call(['jobs'])[1]}")


def _release_honest(farm: Farm) -> None:
    """Lets workers work again that are quarantined for what a liar did to a tile that they shared. A person would find
    that nothing is wrong with them."""
    for name in (checks.quarantined(farm) or set()) - {LIAR}:
        farm.note(f"releases {name}")
        farm.call(["workers", "--release", name])


def _compute_again(farm: Farm) -> bool:
    """Does what a person does where the log says that a tile was left unchecked: has the liar's tiles of that job computed
    again. Whether there were any."""
    meant = False
    for job in sorted(checks.notes(farm, checks.UNCHECKED)):
        code, out, _ = farm.call(["invalidate", str(job), "--worker", LIAR, "--json"])
        farm.note(f"invalidates what the liar did in job {job}: {out.strip()}")
        meant = meant or (code == 0 and out.strip() != "[]")
    return meant


def _rounds(farm: Farm, outcome: Outcome, bound: float) -> None:
    """The same coordinator through many rounds of a job and the faults around it: it must not grow."""
    farm.start()
    grown: list[tuple[int, int]] = []
    for at in range(farm.schedule.rounds):
        told = Acknowledged()
        variant = at % len(farm.world.variants)
        began = time.monotonic()
        number, errand = 1000 + at, Errand(0.0, "submit", variant)
        thread = threading.Thread(target=clients.run_errand, args=(farm, told, number, errand, began + bound), daemon=True)
        thread.start()
        _weather(farm, began)
        thread.join()
        jobs = list(told.jobs.values())
        if not jobs or farm.call(["watch", str(jobs[0])], limit=bound)[0] != 0:
            outcome.problems += [f"round {at} has no end", *told.problems]
            return
        outcome.problems += checks.job(farm, jobs[0], variant)
        # Otherwise the next job of the same parameters is this one.
        if farm.call(["delete", str(jobs[0])])[0] != 0:
            outcome.problems.append(f"round {at}: the job cannot be deleted")
        # From the second round on everything has happened once.
        grown.append(_measure(farm, grown[1][0] if len(grown) > 1 else None))
        farm.note(f"round {at}: {grown[-1][0]} handles, {grown[-1][1] >> 20} MiB")
    (_, before), (handles, after) = grown[1], grown[-1]
    if handles > grown[1][0] + MORE_HANDLES:
        outcome.problems.append(f"the coordinator's handles grow: {[handles for handles, _ in grown]}")
    if after > before + MORE_MEMORY:
        outcome.problems.append(f"the coordinator's memory grows: {[memory for _, memory in grown]}")


def _measure(farm: Farm, wanted: int | None) -> tuple[int, int]:
    """Handles and memory of the coordinator once they are down to what is wanted, or after a while."""
    coordinator = farm.coordinator()
    if coordinator is None or not coordinator.runs():
        raise RuntimeError("the coordinator has ended in a schedule that does not end it")
    until = time.monotonic() + (QUIET if wanted is not None else 2.0)
    while time.monotonic() < until:
        farm.tend()
        if wanted is not None and coordinator.handles() <= wanted + MORE_HANDLES:
            break
        time.sleep(0.2)
    return coordinator.handles(), coordinator.resident()
