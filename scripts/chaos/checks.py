"""What must hold once all faults are over: the bytes, the totals, the logs, and what was acknowledged."""

from __future__ import annotations

import json
import re
from pathlib import Path

from .clients import Acknowledged
from .farm import Farm
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
    if any(later <= before for before, later in zip(numbers, numbers[1:])):
        wrong.append("the numbers of the events do not ascend")
    return wrong


def disk_left(farm: Farm) -> tuple[list[str], int]:
    """No unfinished blob and no outcome of a phase is left once all jobs have ended; and how many blobs are neither a
    scene nor a result. A crash between a job's end and the removal of its outputs leaves such."""
    def left() -> list[str]:
        unfinished = (farm.disk.data / "blobs" / "tmp").iterdir()
        return sorted(path.name for path in [*farm.disk.outcomes(), *unfinished])

    wrong = []
    # The last outputs are being removed when a job is said to be done.
    if not wait_until(lambda: not left(), LEFT):
        wrong.append(f"unfinished blobs or outcomes are left: {left()[:5]}")
    return wrong, len(farm.disk.blobs(farm.scenes)[1])


def traces(farm: Farm) -> list[str]:
    """No panic in a log, and no secret in any file but those of keys, nor in an argument list."""
    wrong = []
    secrets = farm.keys.secrets() if farm.keys else []
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
    for name, code in sorted(set(farm.endings)):
        if not _may_end(farm, name, code):
            wrong.append(f"{name} ended by itself with {code}, {farm.endings.count((name, code))} times")
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


def _may_end(farm: Farm, name: str, code: int) -> bool:
    """A coordinator that starts on a full disk ends and says why."""
    return name == "coordinator" and code in (3, 4) and any(f.kind == "disk_full" for f in farm.schedule.faults)
