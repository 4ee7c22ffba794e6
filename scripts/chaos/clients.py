"""The clients of a farm: errands, which repeat a call until the coordinator acknowledges it, and an observer.

The observer compares each answer with earlier answers, because clients rely on acknowledged changes.
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from .farm import Farm
from .plan import Errand

# The time between two queries of the observer, in seconds.
LOOK = 1.0


class Acknowledged:
    """The changes that the coordinator has acknowledged, and contradictions between its answers."""

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
        """Adds a problem once."""
        with self.lock:
            if text not in self.problems:
                self.problems.append(text)


def submission(farm: Farm, number: int, variant: int) -> list[str]:
    """Returns the arguments that submit an errand's job. A repeated submission gives the same job."""
    scene, flags = farm.calm.scene(farm.world), farm.calm.flags(farm.world, variant)
    name = f"errand-{number}"
    return ["submit", str(scene), *flags, "--request-id", name, "--user", "chaos", "--name", name]


def run_errand(farm: Farm, told: Acknowledged, number: int, errand: Errand, until: float) -> None:
    """Submits the job of an errand, and pauses or cancels it.

    Repeats each call until the coordinator acknowledges it, or until the time `until`.
    """
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
        told.problem(f"the coordinator did not acknowledge the submission of errand {number} in time")
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
            farm.note(f"job {job}: the coordinator acknowledged {errand.kind}")
            return
        if "cannot be" in err:
            # The job ended before the call, so the call has no effect.
            return
        _expected(told, [errand.kind], code, err)
        time.sleep(0.3)


def _expected(told: Acknowledged, words: list[str], code: int, err: str) -> None:
    """Adds a problem if a call failed, except if the coordinator did not answer or rejected the call."""
    if code not in (4, -9):
        told.problem(f"sightline {words[0]} ended with exit code {code}: {err.strip()[-300:]}")


class Observer(threading.Thread):
    """A thread that queries all jobs repeatedly and compares each answer with the earlier answers."""

    def __init__(self, farm: Farm, told: Acknowledged) -> None:
        super().__init__(daemon=True, name="observer")
        self._farm = farm
        self._told = told
        self._over = threading.Event()

    def end(self) -> None:
        """Stops the observer and waits for its end."""
        self._over.set()
        self.join()

    def run(self) -> None:
        """Queries the jobs until `end`."""
        turn = 0
        while not self._over.wait(LOOK):
            # The answer must contain all changes that were acknowledged before the query.
            with self._told.lock:
                jobs = set(self._told.jobs.values())
                cancelled, paused = set(self._told.cancelled), set(self._told.paused)
            listed = self._farm.ask(["jobs"])
            if listed is None:
                continue
            for job in jobs - {shown["job"] for shown in listed}:
                self._told.problem(f"job {job} was acknowledged, and sightline jobs does not list it")
            for shown in listed:
                self.judge(shown, shown["job"] in cancelled, shown["job"] in paused)
            if jobs:
                turn += 1
                self._look_at_tiles(sorted(jobs)[turn % len(jobs)])

    def _look_at_tiles(self, job: int) -> None:
        """Queries and checks the tiles of a job."""
        code, out, err = self._farm.call(["show", str(job), "--tiles", "--json"])
        if code == 0:
            self._tiles(job, [json.loads(line) for line in out.splitlines()])
        elif code not in (4, -9):
            self._told.problem(f"sightline show {job} --tiles ended with exit code {code}: "
                               f"{err.strip()[-300:]}")

    def judge(self, shown: dict[str, Any], cancelled: bool, paused: bool) -> None:
        """Compares the state of a job with the changes that were acknowledged before the query."""
        told, job = self._told, shown["job"]
        self._farm.scenes.add(shown["scene"])
        # During a spot check, a tile is done and running.
        running = 0 if self._farm.liars else shown["tiles_running"]
        if shown["tiles_done"] + shown["tiles_set_aside"] + running > shown["tiles_total"]:
            told.problem(f"the tiles of job {job} exceed its total number of tiles: {json.dumps(shown)}")
        if cancelled and shown["state"] != "cancelled":
            told.problem(f"job {job} was cancelled, and its state is {shown['state']}")
        if paused and shown["state"] not in ("paused", "done"):
            told.problem(f"job {job} was paused, and its state is {shown['state']}")
        with told.lock:
            ended = told.ended.get(job)
            if shown["state"] in ("done", "cancelled"):
                told.ended[job] = shown["state"]
        # Workers compute the tiles of a liar again, also in jobs that are done.
        if ended and shown["state"] != ended and not self._farm.liars:
            told.problem(f"job {job} had ended as {ended}, and its state is {shown['state']}")

    def _tiles(self, job: int, tiles: list[dict[str, Any]]) -> None:
        """Checks that done tiles stay done, and that no tile has conflicting results."""
        done = {tile["tile"] for tile in tiles if tile["state"] == "done"}
        before = self._told.done_tiles.get(job, set())
        if tiles and before - done and not self._farm.damaged & {"tile"} and not self._farm.liars:
            self._told.problem(f"tiles {sorted(before - done)} of job {job} were done and are no longer done")
        self._told.done_tiles[job] = before | done
        for tile in tiles:
            if tile["conflicts"] and not self._farm.liars:
                self._told.problem(f"tile {tile['tile']} of job {job}: the coordinator rejected different "
                                   f"results")
