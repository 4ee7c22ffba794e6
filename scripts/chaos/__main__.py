"""The command: draws schedules, runs them side by side, and says what they found."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from . import liars, sabotage
from .commands import FAKETIME
from .plan import Schedule, draw
from .running import Outcome, run
from .services import Bucket, Database
from .shrinking import shrink
from .spaces import NoNamespaces, Space
from .worlds import WORLDS, Calm, named

REGRESSIONS = Path(__file__).parent / "regressions.json"
HELP = """\
Breaks a farm of real processes and checks that nothing came of it. Each schedule is drawn from its seed alone: a job, a
few workers in network namespaces of their own, and faults (killed, stopped and drained processes, a coordinator killed
in the middle of a commit, lost, late, doubled and reordered packets, cuts in both ways or one, a full disk, a stepped
clock, flipped bits in stored blobs, torn files). In some worlds two coordinators share a PostgreSQL, or blobs are in a
bucket, and those are restarted, stopped, slow or cut off; in some a worker returns wrong bytes. When all faults are over,
the job must end within a bound, with the bytes of a calm run; what was acknowledged must be there; totals must agree; no
log may hold a secret or a panic.

Needs root, network namespaces with TUN devices, faketime, PostgreSQL and a C compiler (scripts/setup.sh --for test), and
what `cargo build --workspace` makes. Without them it says so and ends with 2. Ends with 1 when a schedule found
something, and says how to repeat it. docs/chaos.md says more.
"""
EXAMPLES = """\
examples:
  scripts/chaos.sh --schedules 100 --jobs 3           seeds 1 to 100
  scripts/chaos.sh --seed 17                          seed 17 alone
  scripts/chaos.sh --seed 17 --print                  what would happen, as JSON
  scripts/chaos.sh --replay failed/17/schedule.json   a schedule from a file, perhaps edited
  scripts/chaos.sh --regressions --schedules 12       the seeds that once found something, and twelve more
  scripts/chaos.sh --self-check                       whether the checks see anything
"""


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser("scripts/chaos.sh", description=HELP, epilog=EXAMPLES,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, metavar="N", help="the first seed (default: 1)")
    parser.add_argument("--schedules", type=int, metavar="N", help="how many, with seeds one after the other (default: 1)")
    parser.add_argument("--world", choices=[world.name for world in WORLDS], help="the same world for all of them")
    parser.add_argument("--jobs", type=int, metavar="N", default=2, help="so many at a time (default: 2)")
    parser.add_argument("--bound", type=float, metavar="S", default=180.0,
                        help="seconds that jobs may take once all faults are over (default: 180)")
    parser.add_argument("--regressions", action="store_true", help="first the schedules of scripts/chaos/regressions.json")
    parser.add_argument("--self-check", action="store_true", help="do what the checks must find, and see that they do")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="the schedule of a file")
    parser.add_argument("--print", action="store_true", help="print the schedules instead of running them")
    parser.add_argument("--keep", type=Path, metavar="DIR", default=Path("chaos-failed"),
                        help="where the folders of failures go (default: chaos-failed)")
    parser.add_argument("--keep-all", action="store_true", help="keep the folders of schedules that found nothing, too")
    parser.add_argument("--shrink", type=float, metavar="S", default=120.0,
                        help="seconds spent on leaving faults out of the first failure (default: 120; 0: none)")
    return parser.parse_args()


def _schedules(arguments: argparse.Namespace) -> list[Schedule]:
    if arguments.replay:
        return [Schedule.load(arguments.replay.read_text())]
    found = []
    if arguments.regressions:
        found += [draw(one["seed"], one["world"]) for one in json.loads(REGRESSIONS.read_text())]
    count = arguments.schedules if arguments.schedules is not None else 0 if arguments.regressions else 1
    first = arguments.seed if arguments.seed is not None else 1
    return found + [draw(seed, arguments.world) for seed in range(first, first + count)]


def _program() -> Path:
    root = Path(__file__).parents[2]
    named = os.environ.get("SIGHTLINE_BIN")
    for path in [Path(named)] if named else [root / "target" / kind / "sightline" for kind in ("release", "debug")]:
        if path.is_file():
            return path.resolve()
    raise NoNamespaces("there is no program: build it (cargo build --workspace), or name it in SIGHTLINE_BIN")


def _needs() -> None:
    """Tries what every schedule needs.

    Raises NoNamespaces with what this machine lacks.
    """
    if os.geteuid() != 0:
        raise NoNamespaces("network namespaces need root")
    for tool in ("ip", "nsenter", "openssl", "mount"):
        if shutil.which(tool) is None:
            raise NoNamespaces(f"{tool} is not installed (scripts/setup.sh --for test)")
    if FAKETIME is None:
        raise NoNamespaces("faketime is not installed (scripts/setup.sh --for test)")
    # Names of namespaces and what faketime shares are this command's alone, and go with it.
    for folder in ("/run/netns", "/dev/shm"):
        Path(folder).mkdir(exist_ok=True)
        mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", folder], capture_output=True, text=True, check=False)
        if mounted.returncode != 0:
            raise NoNamespaces(mounted.stderr.strip())
    # The calm runs speak with themselves.
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    space = Space("trial", 1)
    os.close(space.device)
    space.remove()


def _prepare(calm: Calm, schedules: list[Schedule]) -> None:
    """Makes what the worlds of the schedules need beside the program.

    Raises NoNamespaces with what this machine lacks.
    """
    worlds = [named(schedule.world) for schedule in schedules]
    if any(world.store == "database" for world in worlds):
        Database.prepare(calm.database)
    if any(world.store == "bucket" for world in worlds):
        Bucket.check(calm.program)
    if any(world.liar for world in worlds) or any(sabotage.needs_liar(schedule) for schedule in schedules):
        liars.make(calm.lying)


def _report(outcome: Outcome) -> None:
    what = "FAILED" if outcome.problems else "ok"
    print(f"seed {outcome.seed} {outcome.world}: {what}, {outcome.seconds:.1f} s, ended {outcome.healed:.1f} s after the last "
          f"fault ({', '.join(outcome.faults)}), {outcome.packets} packets, {outcome.lost} lost"
          f"{', ' if outcome.besides else ''}{outcome.besides}", flush=True)
    for problem in outcome.problems:
        print(f"  {problem}", flush=True)


def _keep(arguments: argparse.Namespace, schedule: Schedule, folder: Path) -> Path:
    """Keeps the folder of a schedule, without its keys, for it may be passed on."""
    kept = arguments.keep / f"{schedule.world}-{schedule.seed}"
    shutil.rmtree(kept, ignore_errors=True)
    kept.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(folder, kept, ignore=shutil.ignore_patterns("keys", "disk"), ignore_dangling_symlinks=True)
    return kept


def _failed(arguments: argparse.Namespace, calm: Calm, work: Path, schedule: Schedule, folder: Path, shrinking: float) -> None:
    """Keeps the folder of a failure, and makes its schedule smaller."""
    kept = _keep(arguments, schedule, folder)
    print(f"  kept in {kept}\n  again: scripts/chaos.sh --seed {schedule.seed} --world {schedule.world}", flush=True)
    if shrinking <= 0.0:
        return
    tries = 0

    def fails(smaller: Schedule) -> bool:
        nonlocal tries
        tries += 1
        at = work / f"smaller-{schedule.seed}-{tries}"
        outcome = run(calm, smaller, at, arguments.bound)
        shutil.rmtree(at, ignore_errors=True)
        return bool(outcome.problems)

    small = shrink(schedule, fails, shrinking)
    (kept / "smaller.json").write_text(small.dump())
    print(f"  with {len(small.faults)} of {len(schedule.faults)} faults it still fails: scripts/chaos.sh --replay "
          f"{kept / 'smaller.json'}", flush=True)


def _self_check(calm: Calm, work: Path, bound: float) -> int:
    """Whether each act of sabotage is found."""
    blind = 0
    for schedule in sabotage.schedules():
        act = schedule.faults[0].kind
        outcome = run(calm, schedule, work / act, bound)
        found = any(sabotage.ACTS[act].said in problem for problem in outcome.problems)
        blind += not found
        print(f"{act}: {'found' if found else 'NOT FOUND'}", flush=True)
        for problem in outcome.problems if not found else []:
            print(f"  {problem}", flush=True)
    return 1 if blind else 0


def main() -> int:
    arguments = _arguments()
    schedules = sabotage.schedules() if arguments.self_check else _schedules(arguments)
    if arguments.print:
        print("\n".join(schedule.dump() for schedule in schedules))
        return 0
    try:
        program = _program()
        _needs()
    except NoNamespaces as error:
        print(f"chaos: cannot run here: {error}", file=sys.stderr)
        return 2
    began = time.monotonic()
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="sightline-chaos-") as name:
        work = Path(name)
        calm = Calm(program, work)
        try:
            _prepare(calm, schedules)
        except NoNamespaces as error:
            print(f"chaos: cannot run here: {error}", file=sys.stderr)
            return 2
        for world in WORLDS:
            of_world = [schedule.variants(len(world.variants)) for schedule in schedules if schedule.world == world.name]
            if of_world:
                calm.prepare(world, set().union(*of_world))
        if arguments.self_check:
            return _self_check(calm, work, arguments.bound)
        print(f"chaos: {len(schedules)} schedules, {arguments.jobs} at a time; calm runs took {time.monotonic() - began:.1f} s",
              flush=True)
        pool = ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn"), max_tasks_per_child=1)
        shrinking = arguments.shrink
        with pool:
            running = {pool.submit(run, calm, schedule, work / f"run-{at}", arguments.bound): (at, schedule)
                       for at, schedule in enumerate(schedules)}
            for done in as_completed(running):
                at, schedule = running[done]
                outcome = done.result()
                outcomes.append(outcome)
                _report(outcome)
                if arguments.keep_all and not outcome.problems:
                    _keep(arguments, schedule, work / f"run-{at}")
                if outcome.problems:
                    _failed(arguments, calm, work, schedule, work / f"run-{at}", shrinking)
                    shrinking = 0.0
                shutil.rmtree(work / f"run-{at}", ignore_errors=True)
    bad = sum(bool(outcome.problems) for outcome in outcomes)
    slowest = max((outcome.healed for outcome in outcomes), default=0.0)
    print(f"chaos: {len(outcomes)} schedules with {sum(len(outcome.faults) for outcome in outcomes)} faults in "
          f"{time.monotonic() - began:.0f} s, {bad} found something; the slowest job ended {slowest:.1f} s after the last fault; "
          f"{sum(outcome.blobs_left for outcome in outcomes)} blobs are left "
          f"that no job needs")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
