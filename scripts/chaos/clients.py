"""The clients of a farm: errands that are repeated until they are acknowledged, and an observer who remembers answers.

What was acknowledged once must hold in every later answer: that is what a client relies on.
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from .farm import Farm
from .plan import Errand

# Between two looks at the jobs, in seconds.
LOOK = 1.0


class Acknowledged:
    """What the coordinator has told its clients, and where it has contradicted itself."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        # The job of each errand, by the errand's number.
        self.jobs: dict[int, int] = {}
        self.cancelled: set[int] = set()
        self.paused: set[int] = set()
        self.done_tiles: dict[int, set[int]] = {}
        self.ended: dict[int, str] = {}
        self.problems: list[str] = []

    def problem(self, text: str) -> None:
        with self.lock:
            if text not in self.problems:
                self.problems.append(text)


def submission(farm: Farm, number: int, variant: int) -> list[str]:
    """The command of an errand's job; repeated with the same request, it gives the same job."""
    scene, flags = farm.calm.scene(farm.world), farm.calm.flags(farm.world, variant)
    name = f"errand-{number}"
    return ["submit", str(scene), *flags, "--request-id", name, "--user", "chaos", "--name", name]


def run_errand(farm: Farm, told: Acknowledged, number: int, errand: Errand, until: float) -> None:
    """Submits the errand's job, then pauses or cancels it, each until it is acknowledged or `until` has come."""
    time.sleep(max(0.0, farm.began + errand.at - time.monotonic()))
    job = None
    while job is None and time.monotonic() < until:
        code, out, err = farm.call(submission(farm, number, errand.variant))
        if code == 0 and out.strip().isdigit():
            job = int(out)
        else:
            _expected(told, ["submit"], code, err)
            time.sleep(0.3)
    if job is None:
        told.problem(f"errand {number} could not be submitted")
        return
    with told.lock:
        told.jobs[number] = job
    farm.note(f"errand {number} is job {job}")
    if errand.kind == "submit":
        return
    while time.monotonic() < until:
        code, out, err = farm.call([errand.kind, str(job), "--json"])
        if code == 0:
            with told.lock:
                (told.cancelled if errand.kind == "cancel" else told.paused).add(job)
            farm.note(f"job {job}: {errand.kind} is acknowledged")
            return
        if "cannot be" in err:
            # It was done before.
            return
        _expected(told, [errand.kind], code, err)
        time.sleep(0.3)


def _expected(told: Acknowledged, words: list[str], code: int, err: str) -> None:
    """An unreachable or refusing coordinator is what faults lead to; other codes are not."""
    if code not in (4, -9):
        told.problem(f"sightline {words[0]} ended with {code}: {err.strip()[-300:]}")


class Observer(threading.Thread):
    """Looks at all jobs again and again, and compares each answer with those before."""

    def __init__(self, farm: Farm, told: Acknowledged) -> None:
        super().__init__(daemon=True, name="observer")
        self._farm = farm
        self._told = told
        self._over = threading.Event()

    def end(self) -> None:
        self._over.set()
        self.join()

    def run(self) -> None:
        turn = 0
        while not self._over.wait(LOOK):
            # What was acknowledged before the question must be in the answer.
            with self._told.lock:
                jobs, cancelled, paused = set(self._told.jobs.values()), set(self._told.cancelled), set(self._told.paused)
            listed = self._farm.ask(["jobs"])
            if listed is None:
                continue
            for job in jobs - {shown["job"] for shown in listed}:
                self._told.problem(f"job {job} was acknowledged and is not listed")
            for shown in listed:
                self.judge(shown, shown["job"] in cancelled, shown["job"] in paused)
            if jobs:
                turn += 1
                self._look_at_tiles(sorted(jobs)[turn % len(jobs)])

    def _look_at_tiles(self, job: int) -> None:
        code, out, err = self._farm.call(["show", str(job), "--tiles", "--json"])
        if code == 0:
            self._tiles(job, [json.loads(line) for line in out.splitlines()])
        elif code not in (4, -9):
            self._told.problem(f"show {job} --tiles ends with {code}: {err.strip()[-300:]}")

    def judge(self, shown: dict[str, Any], cancelled: bool, paused: bool) -> None:
        """A job as it is shown, against what was acknowledged before it was asked for."""
        told, job = self._told, shown["job"]
        self._farm.scenes.add(shown["scene"])
        # A tile that is computed again because of a spot check is done and at work.
        running = 0 if self._farm.liars else shown["tiles_running"]
        if shown["tiles_done"] + shown["tiles_set_aside"] + running > shown["tiles_total"]:
            told.problem(f"job {job} has more tiles than it has: {json.dumps(shown)}")
        if cancelled and shown["state"] != "cancelled":
            told.problem(f"job {job} was cancelled and is {shown['state']}")
        if paused and shown["state"] not in ("paused", "done"):
            told.problem(f"job {job} was paused and is {shown['state']}")
        with told.lock:
            ended = told.ended.get(job)
            if shown["state"] in ("done", "cancelled"):
                told.ended[job] = shown["state"]
        # What a liar did is computed again, also in jobs that are done.
        if ended and shown["state"] != ended and not self._farm.liars:
            told.problem(f"job {job} had ended as {ended} and is {shown['state']}")

    def _tiles(self, job: int, tiles: list[dict[str, Any]]) -> None:
        done = {tile["tile"] for tile in tiles if tile["state"] == "done"}
        before = self._told.done_tiles.get(job, set())
        if tiles and before - done and not self._farm.damaged & {"tile"} and not self._farm.liars:
            self._told.problem(f"tiles {sorted(before - done)} of job {job} were done and are not any more")
        self._told.done_tiles[job] = before | done
        for tile in tiles:
            if tile["conflicts"] and not self._farm.liars:
                self._told.problem(f"tile {tile['tile']} of job {job}: different results were refused")
