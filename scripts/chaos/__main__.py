"""The command of the chaos harness: draws schedules, runs several at a time, and reports the problems."""

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
Injects faults into a farm of real processes and checks the results. A schedule consists of jobs, of workers
in separate network namespaces, and of faults. The seed alone determines the schedule. Faults are: killed,
stopped and drained processes, a coordinator that is killed during a commit, lost, late, duplicate and
reordered packets, cut connections, a full disk, a changed clock, flipped bits in stored blobs, and files that
end too early. In some worlds two coordinators share a PostgreSQL database, or an object store contains the
blobs, and the harness restarts, stops, slows down or disconnects these services. In other worlds a worker
returns wrong bytes. After all faults, each job must end within a time limit with the bytes of a calm run. All
acknowledged changes must exist, totals must agree, and no log may contain a secret or a panic.

The harness needs root, network namespaces with TUN devices, faketime, PostgreSQL and a C compiler
(scripts/setup.sh --for test), and the programs of `cargo build --workspace`. If a requirement is missing, the
command prints the requirement and ends with exit code 2. If a schedule finds a problem, the command prints
the command for a repetition and ends with exit code 1. docs/chaos.md describes the harness.
"""
EXAMPLES = """\
examples:
  scripts/chaos.sh --schedules 100 --jobs 3           run seeds 1 to 100
  scripts/chaos.sh --seed 17                          run only seed 17
  scripts/chaos.sh --seed 17 --print                  print the schedule of seed 17 as JSON
  scripts/chaos.sh --replay failed/17/schedule.json   run a schedule from a file, which you may edit
  scripts/chaos.sh --regressions --schedules 12       run the seeds that found defects, and seeds 1 to 12
  scripts/chaos.sh --self-check                       check that the checks detect injected defects
"""


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser("scripts/chaos.sh", description=HELP, epilog=EXAMPLES,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, metavar="N", help="first seed. Default: 1")
    parser.add_argument("--schedules", type=int, metavar="N",
                        help="number of schedules, with consecutive seeds. Default: 1, with --regressions 0")
    parser.add_argument("--world", choices=[world.name for world in WORLDS],
                        help="world of all schedules. Default: the seed selects the world")
    parser.add_argument("--jobs", type=int, metavar="N", default=2,
                        help="number of schedules that run at a time. Default: 2")
    parser.add_argument("--bound", type=float, metavar="S", default=180.0,
                        help="time limit for jobs after the last fault, in seconds. Default: 180")
    parser.add_argument("--regressions", action="store_true",
                        help="first run the schedules of scripts/chaos/regressions.json")
    parser.add_argument("--self-check", action="store_true",
                        help="inject defects, and fail unless the checks detect each of them")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="run only the schedule in this file")
    parser.add_argument("--print", action="store_true", help="print the schedules instead of running them")
    parser.add_argument("--keep", type=Path, metavar="DIR", default=Path("chaos-failed"),
                        help="folder that receives the folders of failed schedules. Default: chaos-failed")
    parser.add_argument("--keep-all", action="store_true",
                        help="also keep the folders of schedules without problems")
    parser.add_argument("--shrink", type=float, metavar="S", default=120.0,
                        help="time limit for the reduction of the first failure, in seconds; 0 for no "
                             "reduction. Default: 120")
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
    built = [root / "target" / kind / "sightline" for kind in ("release", "debug")]
    for path in [Path(named)] if named else built:
        if path.is_file():
            return path.resolve()
    raise NoNamespaces("the program does not exist; run cargo build --workspace, or name it in SIGHTLINE_BIN")


def _needs() -> None:
    """Checks the requirements of all schedules.

    Raises NoNamespaces with the missing requirement.
    """
    if os.geteuid() != 0:
        raise NoNamespaces("network namespaces need root")
    for tool in ("ip", "nsenter", "openssl", "mount"):
        if shutil.which(tool) is None:
            raise NoNamespaces(f"{tool} is not installed (scripts/setup.sh --for test)")
    if FAKETIME is None:
        raise NoNamespaces("faketime is not installed (scripts/setup.sh --for test)")
    # A separate /run/netns and /dev/shm contain the names of namespaces and the shared data of faketime, and
    # end with this command.
    for folder in ("/run/netns", "/dev/shm"):
        Path(folder).mkdir(exist_ok=True)
        mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", folder], capture_output=True, text=True,
                                 check=False)
        if mounted.returncode != 0:
            raise NoNamespaces(mounted.stderr.strip())
    # A calm run connects to itself through the loopback device.
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    space = Space("trial", 1)
    os.close(space.device)
    space.remove()


def _prepare(calm: Calm, schedules: list[Schedule]) -> None:
    """Creates the database, the bucket and the faulty Embree that the worlds of the schedules need.

    Raises NoNamespaces with the missing requirement.
    """
    worlds = [named(schedule.world) for schedule in schedules]
    if any(world.store == "database" for world in worlds):
        Database.prepare(calm.database)
    if any(world.store == "bucket" for world in worlds):
        Bucket.check(calm.program)
    if any(world.liar for world in worlds) or any(sabotage.needs_liar(schedule) for schedule in schedules):
        liars.make(calm.lying)


def _report(outcome: Outcome) -> None:
    """Prints the outcome of a schedule and its problems."""
    what = "FAILED" if outcome.problems else "ok"
    print(f"seed {outcome.seed} {outcome.world}: {what} after {outcome.seconds:.1f} s, faults "
          f"{', '.join(outcome.faults)}, jobs ended {outcome.healed:.1f} s after the last fault, "
          f"{outcome.packets} packets, {outcome.lost} lost{', ' if outcome.besides else ''}{outcome.besides}",
          flush=True)
    for problem in outcome.problems:
        print(f"  {problem}", flush=True)


def _keep(arguments: argparse.Namespace, schedule: Schedule, folder: Path) -> Path:
    """Copies the folder of a schedule without keys, so that you can share the copy.

    Returns the copy's path.
    """
    kept = arguments.keep / f"{schedule.world}-{schedule.seed}"
    shutil.rmtree(kept, ignore_errors=True)
    kept.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(folder, kept, ignore=shutil.ignore_patterns("keys", "disk"),
                    ignore_dangling_symlinks=True)
    return kept


def _failed(arguments: argparse.Namespace, calm: Calm, work: Path, schedule: Schedule, folder: Path,
            shrinking: float) -> None:
    """Keeps the folder of a failed schedule, and reduces the schedule."""
    kept = _keep(arguments, schedule, folder)
    print(f"  stored in {kept}\n  repeat with: scripts/chaos.sh --seed {schedule.seed} "
          f"--world {schedule.world}", flush=True)
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
    print(f"  {len(small.faults)} of {len(schedule.faults)} faults are sufficient for a failure; repeat "
          f"with: scripts/chaos.sh --replay {kept / 'smaller.json'}", flush=True)


def _self_check(calm: Calm, work: Path, bound: float) -> int:
    """Runs a schedule for each injected defect. Returns 1 if the checks miss a defect, otherwise 0."""
    blind = 0
    for schedule in sabotage.schedules():
        act = schedule.faults[0].kind
        outcome = run(calm, schedule, work / act, bound)
        found = any(sabotage.ACTS[act].said in problem for problem in outcome.problems)
        blind += not found
        print(f"{act}: {'detected' if found else 'NOT DETECTED'}", flush=True)
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
            of_world = [schedule.variants(len(world.variants)) for schedule in schedules
                        if schedule.world == world.name]
            if of_world:
                calm.prepare(world, set().union(*of_world))
        if arguments.self_check:
            return _self_check(calm, work, arguments.bound)
        print(f"chaos: {len(schedules)} schedules, {arguments.jobs} at a time; the calm runs took "
              f"{time.monotonic() - began:.1f} s", flush=True)
        pool = ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn"),
                                   max_tasks_per_child=1)
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
    print(f"chaos: {len(outcomes)} schedules with {sum(len(outcome.faults) for outcome in outcomes)} faults "
          f"in {time.monotonic() - began:.0f} s, {bad} failed; the slowest job ended {slowest:.1f} s after "
          f"the last fault; {sum(outcome.blobs_left for outcome in outcomes)} blobs that no job needs remain")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
