"""What must hold once all faults are over: the bytes, the totals, the logs, and what was acknowledged."""

from __future__ import annotations

import json
import re
from pathlib import Path

from .clients import Acknowledged
from .commands import LIAR
from .farm import LEADS, Farm
from .processes import wait_until

# What no log of a sound program says. Arguments and reasons of failures contain neither.
WRONG = re.compile(rb"panicked|internal error|code: Internal|status: Internal|\binternal\b:", re.IGNORECASE)

# What is removed after a job's end is gone so soon, in seconds.
LEFT = 10.0


def job(farm: Farm, number: int, variant: int) -> list[str]:
    """A job that must be done: its bytes are those of the calm run, and all totals agree."""
    shown = farm.ask(["show", str(number)])
    if shown is None:
        return [f"job {number} cannot be shown"]
    if shown["state"] != "done":
        return [f"job {number} is {shown['state']}: {shown['reason']}"]
    wrong = []
    if shown["tiles_done"] != shown["tiles_total"] or shown["tiles_set_aside"] or shown["tiles_running"]:
        wrong.append(f"the tiles of job {number} do not add up: {json.dumps(shown)}")
    if shown["cells_done"] != shown["cells_total"]:
        wrong.append(f"job {number} is done with {shown['cells_done']} of {shown['cells_total']} cells")
    result = farm.folder / f"job-{number}.pvs"
    code, _, err = farm.call(["fetch", str(number), "-o", str(result)], limit=60.0)
    if code != 0:
        return [*wrong, f"fetch {number} ends with {code}: {err.strip()[-300:]}"]
    calm, got = farm.calm.result(farm.world, variant).read_bytes(), result.read_bytes()
    if got != calm:
        first = next((at for at, (a, b) in enumerate(zip(got, calm)) if a != b), min(len(got), len(calm)))
        wrong.append(f"job {number} has {len(got)} bytes, the calm run {len(calm)}; the first that differs is {first}")
    if shown["result_bytes"] != len(got):
        wrong.append(f"job {number} is said to have {shown['result_bytes']} bytes and has {len(got)}")
    code, out, err = farm.call(["show", str(number), "--tiles", "--json"])
    tiles = [json.loads(line) for line in out.splitlines()]
    if code != 0:
        return [*wrong, f"show {number} --tiles ends with {code}: {err.strip()[-300:]}"]
    if [tile["tile"] for tile in tiles] != list(range(shown["tiles_total"])):
        wrong.append(f"show {number} --tiles lists {len(tiles)} tiles, and the job has {shown['tiles_total']}")
    if any(tile["state"] != "done" for tile in tiles):
        wrong.append(f"job {number} is done, and not all of its tiles are")
    for total, of_tile in (("samples", "samples"), ("cells_done", "cells_done")):
        told = sum(tile[of_tile] for tile in tiles if not (of_tile == "cells_done" and tile["is_pack"]))
        if told != shown[total]:
            wrong.append(f"the {of_tile} of the tiles of job {number} are {told}, and the job has {shown[total]}")
    return wrong + _result(farm, number, result, shown["cells_total"])


def _result(farm: Farm, number: int, result: Path, cells: int) -> list[str]:
    """What `info` says about a result."""
    code, out, err = farm.call_alone(["info", str(result), "--json"])
    if code != 0:
        return [f"info of the result of job {number} ends with {code}: {err.strip()[-300:]}"]
    said = json.loads(out)["cells"]
    return [] if said == cells else [f"the result of job {number} has {said} cells, and the job has {cells}"]


def acknowledged(farm: Farm, told: Acknowledged) -> list[str]:
    """Every job whose submission was acknowledged is there, and the same request gives it again."""
    listed = farm.ask(["jobs"])
    if listed is None:
        return ["the jobs cannot be listed"]
    wrong = []
    states = {shown["job"]: shown["state"] for shown in listed}
    for number, job_number in sorted(told.jobs.items()):
        if job_number not in states:
            wrong.append(f"job {job_number} of errand {number} was acknowledged and is not listed")
    for job_number in told.cancelled:
        if states.get(job_number) != "cancelled":
            wrong.append(f"job {job_number} was cancelled and is {states.get(job_number)}")
    extra = len(states) - len(set(told.jobs.values()))
    if extra > 0:
        wrong.append(f"there are {extra} jobs that no errand is told of: {sorted(states)}")
    events = farm.call(["logs", "--json"])[1].splitlines()
    numbers = [json.loads(line)["number"] for line in events]
    # Of two coordinators each has events of its own.
    if any(later <= before for before, later in zip(numbers, numbers[1:])):
        wrong.append("the numbers of the events do not ascend")
    return wrong


def disk_left(farm: Farm) -> tuple[list[str], int]:
    """No unfinished blob and no outcome of a phase is left once all jobs have ended; and how many blobs are neither a
    scene nor a result. A crash between a job's end and the removal of its outputs leaves such."""
    def left() -> list[str]:
        return sorted(path.name for path in [*farm.disk.outcomes(), *farm.disk.unfinished()])

    wrong = []
    # The last outputs are being removed when a job is said to be done. What one of two coordinators had begun when it was
    # killed stays until it leads again.
    if not farm.database and not wait_until(lambda: not left(), LEFT):
        wrong.append(f"unfinished blobs or outcomes are left: {left()[:5]}")
    return wrong, len(farm.disk.blobs(farm.scenes)[1])


def traces(farm: Farm) -> list[str]:
    """No panic in a log, and no secret in any file but those of keys, nor in an argument list."""
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
            wrong.append(f"{name} ended by itself with {code}: {said[-400:]}")
    return wrong


def left_over(farm: Farm) -> list[str]:
    """No process of the farm, nor a child of one, is left after its end."""
    mark = f"XDG_CACHE_HOME={farm.folder}/".encode()
    wrong = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (process / "environ").read_bytes():
                wrong.append(f"process {process.name} is left: {(process / 'cmdline').read_bytes().replace(bytes(1), b' ')!r}")
        except OSError:
            # It ended meanwhile.
            continue
    return wrong


# What a coordinator says when it ends because it leads no more, or cannot begin to lead or start because what it relies on
# does not answer.
DEPOSED = re.compile(r"could not renew its leadership|does not lead any more|was to lead and cannot: .*does not answer")
UNREACHABLE = re.compile(r"does not answer|cannot be reached")


def _may_end(farm: Farm, name: str, code: int, said: str) -> bool:
    """A coordinator that starts on a full disk ends and says why; so does one that leads no more."""
    if name not in ("coordinator", "second"):
        return False
    if code in (3, 4) and any(f.kind == "disk_full" for f in farm.schedule.faults):
        return True
    if farm.database and code == 1 and DEPOSED.search(said):
        return True
    return bool(farm.services and code in (3, 4) and UNREACHABLE.search(said))


# What is noted about a tile that was to be computed again and could not be.
UNCHECKED = "was to be computed again and was not"
DIFFERS = "was computed again, with other bytes"
QUARANTINED = re.compile(r"^(\S+) IS QUARANTINED", re.MULTILINE)


def notes(farm: Farm, text: str) -> set[int]:
    """The jobs among whose events is one with a text."""
    code, out, _ = farm.call(["logs", "--json"])
    events = [json.loads(line) for line in out.splitlines()] if code == 0 else []
    return {event["job"] for event in events if text in json.dumps(event) and event.get("job")}


def quarantined(farm: Farm) -> set[str] | None:
    """The names of the workers that are quarantined; none when they cannot be listed."""
    code, out, _ = farm.call(["workers"])
    # A line begins with the name and the identity of a worker.
    return {found.partition("#")[0] for found in QUARANTINED.findall(out)} if code == 0 else None


def liars(farm: Farm) -> list[str]:
    """Who returned wrong bytes is quarantined, and nobody else, except that of a tile of lines whose bytes are wrong nobody
    can say who of those that had a hand in it was right."""
    named = quarantined(farm)
    if named is None:
        return ["the workers cannot be listed"]
    honest = set() if farm.shares_tiles else named - {LIAR}
    wrong = [f"{name} is quarantined and never lied" for name in sorted(honest)]
    if notes(farm, DIFFERS) and LIAR not in named:
        wrong.append("outputs differed, and the liar is not quarantined")
    return wrong


def besides(farm: Farm) -> str:
    """What a report says of a farm with two coordinators or with a liar."""
    if farm.database:
        logs = (farm.logs / f"{name}.log" for name in ("coordinator", "second"))
        return f"led {sum(log.read_text(errors='replace').count(LEADS) for log in logs)} times"
    if farm.world.liar:
        return "the liar was found" if LIAR in (quarantined(farm) or set()) else "the liar was not found"
    return ""
