"""The checks after all faults: bytes, totals, logs and acknowledged changes.

Each check returns its problems.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from .clients import Acknowledged
from .commands import LIAR
from .farm import LEADS, Farm
from .processes import wait_until

# A pattern for panics and internal errors, which no log may contain. Arguments and reasons of failures do not
# match.
WRONG = re.compile(rb"panicked|internal error|code: Internal|status: Internal|\binternal\b:", re.IGNORECASE)

# The time limit for the deletion of temporary data after the end of a job, in seconds.
LEFT = 10.0


def job(farm: Farm, number: int, variant: int) -> list[str]:
    """Checks that a job is done, that its bytes equal the calm run's, and that all totals agree."""
    shown = farm.ask(["show", str(number)])
    if shown is None:
        return [f"sightline show {number} failed"]
    if shown["state"] != "done":
        return [f"job {number} is {shown['state']}: {shown['reason']}"]
    wrong = []
    if shown["tiles_done"] != shown["tiles_total"] or shown["tiles_set_aside"] or shown["tiles_running"]:
        wrong.append(f"job {number} is done, but its numbers of tiles disagree: {json.dumps(shown)}")
    if shown["cells_done"] != shown["cells_total"]:
        wrong.append(f"job {number} is done with {shown['cells_done']} of {shown['cells_total']} cells")
    result = farm.folder / f"job-{number}.pvs"
    code, _, err = farm.call(["fetch", str(number), "-o", str(result)], limit=60.0)
    if code != 0:
        return [*wrong, f"sightline fetch {number} ended with exit code {code}: {err.strip()[-300:]}"]
    calm, got = farm.calm.result(farm.world, variant).read_bytes(), result.read_bytes()
    if got != calm:
        first = next((at for at, (a, b) in enumerate(zip(got, calm)) if a != b), min(len(got), len(calm)))
        wrong.append(f"the result of job {number} has {len(got)} bytes, and the calm run has {len(calm)} "
                     f"bytes; byte {first} is the first that differs")
    if shown["result_bytes"] != len(got):
        wrong.append(f"sightline show {number} reports {shown['result_bytes']} bytes, and the result has "
                     f"{len(got)}")
    code, out, err = farm.call(["show", str(number), "--tiles", "--json"])
    tiles = [json.loads(line) for line in out.splitlines()]
    if code != 0:
        return [*wrong, f"sightline show {number} --tiles ended with exit code {code}: {err.strip()[-300:]}"]
    if [tile["tile"] for tile in tiles] != list(range(shown["tiles_total"])):
        wrong.append(f"sightline show {number} --tiles lists {len(tiles)} tiles, and the job has "
                     f"{shown['tiles_total']}")
    if any(tile["state"] != "done" for tile in tiles):
        wrong.append(f"job {number} is done, but sightline show --tiles lists tiles that are not done")
    for total, of_tile in (("samples", "samples"), ("cells_done", "cells_done")):
        told = sum(tile[of_tile] for tile in tiles if not (of_tile == "cells_done" and tile["is_pack"]))
        if told != shown[total]:
            wrong.append(f"the sum of {of_tile} over the tiles of job {number} is {told}, and the job "
                         f"reports {shown[total]}")
    return wrong + _result(farm, number, result, shown["cells_total"])


def _result(farm: Farm, number: int, result: Path, cells: int) -> list[str]:
    """Checks the number of cells that `sightline info` reports for a result."""
    code, out, err = farm.call_alone(["info", str(result), "--json"])
    if code != 0:
        return [f"sightline info of the result of job {number} ended with exit code {code}: "
                f"{err.strip()[-300:]}"]
    said = json.loads(out)["cells"]
    return [] if said == cells else [f"the result of job {number} has {said} cells, and the job has {cells}"]


def acknowledged(farm: Farm, told: Acknowledged) -> list[str]:
    """Checks that all acknowledged jobs exist in their acknowledged states, and that no other jobs exist.

    Also checks that the numbers of the events ascend.
    """
    listed = farm.ask(["jobs"])
    if listed is None:
        return ["sightline jobs failed"]
    wrong = []
    states = {shown["job"]: shown["state"] for shown in listed}
    for number, job_number in sorted(told.jobs.items()):
        if job_number not in states:
            wrong.append(f"job {job_number} of errand {number} was acknowledged, and sightline jobs does not "
                         f"list it")
    for job_number in told.cancelled:
        if states.get(job_number) != "cancelled":
            wrong.append(f"job {job_number} was cancelled, and its state is {states.get(job_number)}")
    extra = len(states) - len(set(told.jobs.values()))
    if extra > 0:
        wrong.append(f"{extra} jobs exist that the coordinator acknowledged to no errand: {sorted(states)}")
    events = farm.call(["logs", "--json"])[1].splitlines()
    numbers = [json.loads(line)["number"] for line in events]
    # Each of two coordinators has separate events, so only the order of the numbers is checked.
    if any(later <= before for before, later in zip(numbers, numbers[1:])):
        wrong.append("the numbers of the events do not ascend")
    return wrong


def disk_left(farm: Farm) -> tuple[list[str], int]:
    """Checks that no unfinished blob and no outcome of a phase remains after the end of all jobs.

    Also returns the number of blobs that are neither scenes nor results. Such blobs remain if the coordinator
    is killed between the end of a job and the deletion of the job's outputs.
    """
    def left() -> list[str]:
        """Returns the names of remaining outcomes and unfinished blobs."""
        return sorted(path.name for path in [*farm.disk.outcomes(), *farm.disk.unfinished()])

    wrong = []
    # The coordinator reports a job as done before it deletes the last outputs. With two coordinators, data of
    # a killed coordinator stays until it leads again.
    if not farm.database and not wait_until(lambda: not left(), LEFT):
        wrong.append(f"unfinished blobs or outcomes remain: {left()[:5]}")
    return wrong, len(farm.disk.blobs(farm.scenes)[1])


def traces(farm: Farm) -> list[str]:
    """Checks logs, files and argument lists for panics and secrets, and the exit codes of ended processes.

    The files of keys may contain secrets. A process may end by itself only for the reasons of `_may_end`.
    """
    wrong = []
    secrets = farm.secrets()
    keys = farm.folder / "keys"
    for path in sorted(farm.folder.rglob("*")):
        if not path.is_file() or keys in path.parents:
            continue
        content = path.read_bytes()
        if any(secret in content for secret in secrets):
            wrong.append(f"{path.relative_to(farm.folder)} contains a secret")
        if path.parent == farm.logs:
            for line in content.splitlines():
                if WRONG.search(line):
                    wrong.append(f"{path.name}: {line.decode(errors='replace')[:400]}")
                    break
    for arguments in farm.arguments:
        if any(secret.decode() in arguments for secret in secrets):
            wrong.append(f"an argument list contains a secret: {arguments[:40]}…")
    for name, code, said in farm.endings:
        if not _may_end(farm, name, code, said):
            wrong.append(f"{name} ended by itself with exit code {code}: {said[-400:]}")
    return wrong


def left_over(farm: Farm) -> list[str]:
    """Checks that no process of the farm and no child of such a process remains after the end of the farm."""
    mark = f"XDG_CACHE_HOME={farm.folder}/".encode()
    wrong = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (process / "environ").read_bytes():
                wrong.append(f"process {process.name} still runs: "
                             f"{(process / 'cmdline').read_bytes().replace(bytes(1), b' ')!r}")
        except OSError:
            # The process has ended.
            continue
    return wrong


# Patterns for the last message of a coordinator that lost its leadership, and of a coordinator whose database
# or object store does not answer.
DEPOSED = re.compile(
    r"could not renew its leadership|no longer leads|could not become the leader: .*does not answer")
UNREACHABLE = re.compile(r"does not answer|cannot be reached")


def _may_end(farm: Farm, name: str, code: int, said: str) -> bool:
    """Returns true if a coordinator may end by itself with this exit code and these last messages.

    Permitted reasons are a full disk, a lost leadership, and a database or object store that does not answer.
    """
    if name not in ("coordinator", "second"):
        return False
    if code in (3, 4) and any(f.kind == "disk_full" for f in farm.schedule.faults):
        return True
    if farm.database and code == 1 and DEPOSED.search(said):
        return True
    return bool(farm.services and code in (3, 4) and UNREACHABLE.search(said))


# Parts of the coordinator's events about a spot check that did not take place, and about one with other
# bytes.
UNCHECKED = "but was not computed again"
DIFFERS = "was computed again, with different bytes"
# A pattern for the lines of `sightline workers` about quarantined workers.
QUARANTINED = re.compile(r"^(\S+) IS QUARANTINED", re.MULTILINE)


def notes(farm: Farm, text: str) -> set[int]:
    """Returns the jobs with an event that contains a text."""
    code, out, _ = farm.call(["logs", "--json"])
    events = [json.loads(line) for line in out.splitlines()] if code == 0 else []
    return {event["job"] for event in events if text in json.dumps(event) and event.get("job")}


def quarantined(farm: Farm) -> set[str] | None:
    """Returns the names of the quarantined workers, or None if the call fails."""
    code, out, _ = farm.call(["workers"])
    # Each line begins with the name and the identity of a worker, separated by #.
    return {found.partition("#")[0] for found in QUARANTINED.findall(out)} if code == 0 else None


def liars(farm: Farm) -> list[str]:
    """Checks that the coordinator quarantined the liar after outputs differed, and no honest worker.

    If workers share tiles, the coordinator may also quarantine honest workers, because the bytes of a shared
    tile do not show which of its workers was wrong.
    """
    named = quarantined(farm)
    if named is None:
        return ["sightline workers failed"]
    honest = set() if farm.shares_tiles else named - {LIAR}
    wrong = [f"the honest worker {name} is quarantined" for name in sorted(honest)]
    if notes(farm, DIFFERS) and LIAR not in named:
        wrong.append("outputs differed, and the liar is not quarantined")
    return wrong


def besides(farm: Farm) -> str:
    """Returns the additional text of the report for a farm with two coordinators or with a liar."""
    if farm.database:
        logs = (farm.logs / f"{name}.log" for name in ("coordinator", "second"))
        return f"{sum(log.read_text(errors='replace').count(LEADS) for log in logs)} leaderships"
    if farm.world.liar:
        return f"the liar was {'' if LIAR in (quarantined(farm) or set()) else 'not '}detected"
    return ""
