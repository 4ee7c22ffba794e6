"""The execution of a schedule, from the start of its farm to the checks after its end."""

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

# The maximum growth of a coordinator's memory, in bytes, and of its open files, from the second to the last
# round.
MORE_MEMORY = 32 << 20
MORE_HANDLES = 8
# The time after which a coordinator closes connections to vanished clients, in seconds.
QUIET = 45.0
# The time between two uploads of a scene that may be damaged, in seconds. All jobs of a schedule have the
# same scene.
SEND = 4.0


@dataclass
class Outcome:
    """The outcome of a schedule."""

    seed: int
    world: str
    problems: list[str] = field(default_factory=list)
    seconds: float = 0.0
    # The time from the end of the last fault to the end of the last job, in seconds.
    healed: float = 0.0
    faults: list[str] = field(default_factory=list)
    # The number of remaining blobs that no job needs.
    blobs_left: int = 0
    packets: int = 0
    lost: int = 0
    # Additional text in some worlds: the number of leaderships, or the detection of the liar.
    besides: str = ""


def run(calm: Calm, schedule: Schedule, folder: Path, bound: float) -> Outcome:
    """Runs a schedule in `folder`. The jobs must end within `bound` seconds after the last fault."""
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
        # The harness has a defect. Report it like a failure of the program, so that the folder is kept.
        outcome.problems.append(f"the harness failed: {traceback.format_exc()}")
    finally:
        if outcome.problems:
            _keep(farm)
        farm.remove()
    outcome.packets, outcome.lost = farm.switch.counts.sent, farm.switch.counts.lost
    outcome.seconds = time.monotonic() - began
    return outcome


def _keep(farm: Farm) -> None:
    """Copies the data directory from the tmpfs, which ends with the schedule."""
    shutil.copytree(farm.disk.at, farm.folder / "data", symlinks=True,
                    ignore=shutil.ignore_patterns("filler-*"))


def _once(farm: Farm, outcome: Outcome, bound: float) -> None:
    """Runs all errands and faults, waits for the end of all jobs, and checks the results."""
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
    # The coordinator must have stored all acknowledged changes, so kill it and check them again.
    for number in farm.coordinators:
        farm.take_down(number)
    for number in farm.coordinators:
        farm.let_up(number)
    if _answers(farm, bound):
        _check(farm, told, outcome)
    else:
        outcome.problems.append("the coordinator does not answer after the last restart")


def _check(farm: Farm, told: Acknowledged, outcome: Outcome) -> None:
    """Checks the results of all jobs and the acknowledged changes."""
    for number, job in sorted(told.jobs.items()):
        if job not in told.cancelled:
            outcome.problems += checks.job(farm, job, farm.schedule.errands[number].variant)
    outcome.problems += checks.acknowledged(farm, told)
    if farm.liars:
        outcome.problems += checks.liars(farm)


def _send(farm: Farm, told: Acknowledged, errands: tuple[Errand, ...],
          until: float) -> list[threading.Thread]:
    """Starts a thread for each errand."""
    threads = [threading.Thread(target=clients.run_errand, args=(farm, told, number, errand, until),
                                daemon=True)
               for number, errand in enumerate(errands)]
    for thread in threads:
        thread.start()
    return threads


def _weather(farm: Farm, began: float) -> None:
    """Begins and ends all faults at their times."""
    # Each entry contains a unique number, because the heap cannot compare functions.
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
            farm.note(f"the fault with the planned end at {at:.2f} s has ended")
        farm.tend()
        time.sleep(0.01)


def _answers(farm: Farm, bound: float) -> bool:
    """Waits until the coordinator answers. Returns false after `bound` seconds."""
    until = time.monotonic() + bound
    while time.monotonic() < until:
        if farm.ask(["jobs"]) is not None:
            return True
        farm.tend()
        time.sleep(0.1)
    return False


def _settle(farm: Farm, told: Acknowledged, outcome: Outcome, until: float) -> None:
    """Waits for the end of all jobs.

    Uploads damaged scenes again and resumes paused jobs, as an administrator would.
    """
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
                outcome.problems.append(f"job {job} was acknowledged, and sightline jobs does not list it")
                return
            state, reason = shown[job]["state"], shown[job]["reason"]
            if state == "done":
                del wanted[job]
            elif state == "paused" and job in told.paused:
                farm.call(["resume", str(job)])
            elif state in ("failed", "cancelled"):
                outcome.problems.append(f"job {job} ended as {state}: {reason}")
                return
            elif farm.damaged & {"scene", "tile"} and time.monotonic() > sent + SEND:
                # The damaged blob can be a scene in both cases, because the harness does not always know the
                # scenes at the time of the damage.
                sent = time.monotonic()
                farm.call(clients.submission(farm, number, farm.schedule.errands[number].variant))
                if state == "paused":
                    # A coordinator paused the job because of the scene. If that coordinator was killed, the
                    # reason is lost, and only `resume` continues the job.
                    farm.call(["resume", str(job)])
        time.sleep(0.4)
    if wanted:
        outcome.problems.append(f"jobs {sorted(wanted)} did not end in time:\n{farm.call(['jobs'])[1]}")


def _release_honest(farm: Farm) -> None:
    """Releases honest workers from quarantine, as an administrator would.

    The coordinator quarantined these workers because they shared a tile with a liar.
    """
    for name in (checks.quarantined(farm) or set()) - {LIAR}:
        farm.note(f"releases {name}")
        farm.call(["workers", "--release", name])


def _compute_again(farm: Farm) -> bool:
    """Invalidates the liar's tiles of each job with an unchecked tile, as an administrator would.

    Returns true if the coordinator reopened any tiles.
    """
    meant = False
    for job in sorted(checks.notes(farm, checks.UNCHECKED)):
        code, out, _ = farm.call(["invalidate", str(job), "--worker", LIAR, "--json"])
        farm.note(f"invalidates the tiles of the liar in job {job}: {out.strip()}")
        meant = meant or (code == 0 and out.strip() != "[]")
    return meant


def _rounds(farm: Farm, outcome: Outcome, bound: float) -> None:
    """Runs several rounds of a job with faults on one coordinator, and checks its memory and open files."""
    farm.start()
    grown: list[tuple[int, int]] = []
    for at in range(farm.schedule.rounds):
        told = Acknowledged()
        variant = at % len(farm.world.variants)
        began = time.monotonic()
        number, errand = 1000 + at, Errand(0.0, "submit", variant)
        thread = threading.Thread(target=clients.run_errand,
                                  args=(farm, told, number, errand, began + bound), daemon=True)
        thread.start()
        _weather(farm, began)
        thread.join()
        jobs = list(told.jobs.values())
        if not jobs or farm.call(["watch", str(jobs[0])], limit=bound)[0] != 0:
            outcome.problems += [f"the job of round {at} did not end", *told.problems]
            return
        outcome.problems += checks.job(farm, jobs[0], variant)
        # If the job existed in the next rounds, a submission with the same parameters would return it.
        if farm.call(["delete", str(jobs[0])])[0] != 0:
            outcome.problems.append(f"sightline delete failed for the job of round {at}")
        # The first rounds fill caches, so the second round is the reference.
        grown.append(_measure(farm, grown[1][0] if len(grown) > 1 else None))
        farm.note(f"round {at}: {grown[-1][0]} open files, {grown[-1][1] >> 20} MiB")
    (_, before), (handles, after) = grown[1], grown[-1]
    if handles > grown[1][0] + MORE_HANDLES:
        outcome.problems.append(f"the coordinator's open files grow: {[handles for handles, _ in grown]}")
    if after > before + MORE_MEMORY:
        outcome.problems.append(f"the coordinator's memory grows: {[memory for _, memory in grown]} bytes")


def _measure(farm: Farm, wanted: int | None) -> tuple[int, int]:
    """Returns the number of the coordinator's open files, and its memory in bytes.

    First waits until the number of open files is close to `wanted`, or until a time limit.
    """
    coordinator = farm.coordinator()
    if coordinator is None or not coordinator.runs():
        raise RuntimeError("the coordinator ended, although the faults of the schedule do not end it")
    until = time.monotonic() + (QUIET if wanted is not None else 2.0)
    while time.monotonic() < until:
        farm.tend()
        if wanted is not None and coordinator.handles() <= wanted + MORE_HANDLES:
            break
        time.sleep(0.2)
    return coordinator.handles(), coordinator.resident()
