"""Schedules: what is done to a farm and when, drawn from a seed alone, written and read as JSON.

A fault that needs what exists only at its time, such as a stored blob, has fractions that choose from what is there.
"""

from __future__ import annotations

import json
import random
from dataclasses import asdict, dataclass, field, replace

from .worlds import WORLDS

# Workers are numbered from 2: number 1 is the coordinator, 100 the client.
COORDINATOR = 1
FIRST_WORKER = 2
CLIENT = 100

# How often each kind of fault is drawn, in comparison with the others.
KINDS = {
    "kill": 6, "kill_at_commit": 5, "term": 2, "stop": 4, "weather": 6, "cut": 5, "unplug": 2,
    "disk_full": 3, "clock": 2, "flip": 3, "torn": 3,
}
# What a fault of kind `flip` damages while all runs, and `torn` while the coordinator is down.
FLIPPED = ("scene", "tile", "tile", "outcome")
TORN = ("journal", "events", "view", "outcome")


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong at a time and lasts. Times are seconds from the begin of the schedule."""

    at: float
    kind: str
    node: int
    lasts: float
    # What else the kind needs; see faults.py.
    details: dict[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Errand:
    """Something that a client asks for, until it is acknowledged: submit, pause, cancel."""

    at: float
    kind: str
    variant: int


@dataclass(frozen=True)
class Schedule:
    """A farm and all that happens to it."""

    seed: int
    world: str
    workers: int
    # Encryption, workers' certificates and tokens.
    closed: bool
    # A worker that is started again takes its name again.
    same_names: bool
    # Ask for the log in detail, where secrets would be seen sooner.
    talkative: bool
    # Rounds on one coordinator, which is not killed, to see whether it grows; 1 for schedules of all faults.
    rounds: int
    errands: tuple[Errand, ...]
    faults: tuple[Fault, ...]

    def without(self, number: int) -> Schedule:
        """The schedule without its fault of that number."""
        return replace(self, faults=(*self.faults[:number], *self.faults[number + 1:]))

    def variants(self, of_world: int) -> set[int]:
        """The variants of the jobs of a schedule, whose world has so many."""
        if self.rounds > 1:
            return set(range(min(self.rounds, of_world)))
        # A cancelled job has no result.
        return {errand.variant for errand in self.errands if errand.kind != "cancel"}

    def dump(self) -> str:
        return json.dumps(asdict(self), indent=1)

    @staticmethod
    def load(text: str) -> Schedule:
        """Reads what `dump` has written.

        Raises TypeError, KeyError or ValueError for other text.
        """
        read = json.loads(text)
        read["errands"] = tuple(Errand(**errand) for errand in read["errands"])
        read["faults"] = tuple(Fault(**fault) for fault in read["faults"])
        return Schedule(**read)


def draw(seed: int, world: str | None = None) -> Schedule:
    """The schedule of a seed, in the world given or in one that is drawn."""
    rng = random.Random(f"schedule {seed}")
    drawn = rng.choices(WORLDS, [w.weight for w in WORLDS])[0].name
    workers = rng.choice((2, 3, 3, 4))
    closed, same_names, talkative = rng.random() < 0.35, rng.random() < 0.15, rng.random() < 0.5
    rounds = 5 if rng.random() < 0.06 else 1
    errands = [Errand(0.0, "submit", 0)]
    if rounds == 1:
        # One after the other, so that there is always work that can be disturbed.
        errands += [Errand(round(rng.uniform(at, at + 1.0), 2), "submit", at + 1) for at in range(3)]
        if rng.random() < 0.4:
            errands.append(Errand(round(rng.uniform(0.5, 4.0), 2), rng.choice(("pause", "cancel")), 4))
    kinds = dict(KINDS)
    if rounds > 1:
        # The same process has to be there at the end.
        kinds = {kind: weight for kind, weight in kinds.items() if kind in ("kill", "stop", "weather", "cut")}
    faults = []
    for _ in range(rng.randrange(3, 9)):
        faults.append(_fault(rng, rng.choices(list(kinds), list(kinds.values()))[0], workers, spare=rounds > 1))
    faults.sort(key=lambda fault: fault.at)
    return Schedule(seed, world or drawn, workers, closed, same_names, talkative, rounds, tuple(errands), tuple(faults))


def _fault(rng: random.Random, kind: str, workers: int, spare: bool) -> Fault:
    """A fault of a kind; with `spare` not of the coordinator's process."""
    at = round(rng.uniform(0.0, 5.0), 2)
    worker = rng.randrange(FIRST_WORKER, FIRST_WORKER + workers)
    anybody = worker if spare or rng.random() < 0.5 else COORDINATOR
    shortly = round(rng.uniform(0.1, 3.0), 2)
    details: dict[str, float | str] = {}
    match kind:
        case "kill" | "term":
            return Fault(at, kind, anybody, shortly)
        case "kill_at_commit":
            # The so many-th growth of the journal from then on, and so much later.
            return Fault(at, kind, COORDINATOR, shortly,
                         {"commits": rng.randrange(1, 9), "after": rng.choice((0.0, 0.0, 0.001, 0.004))})
        case "stop":
            # A lease lives ten seconds.
            lasts = round(rng.uniform(10.5, 15.0) if rng.random() < 0.25 else rng.uniform(0.5, 6.0), 2)
            return Fault(at, kind, anybody, lasts)
        case "weather":
            worst = rng.choice((0.02, 0.1, 0.3))
            details = {
                "loss": round(rng.uniform(0.0, worst), 3), "delay": round(rng.choice((0.0, 0.02, 0.1, 0.5)) * rng.random(), 3),
                "duplicate": round(rng.choice((0.0, 0.1, 0.5)) * rng.random(), 3),
                "reorder": round(rng.choice((0.0, 0.2, 0.5)) * rng.random(), 3),
                "way": rng.choice(("in", "out", "both")),
            }
            details["jitter"] = round(float(details["delay"]) * rng.random(), 3)
            node = rng.choice((worker, worker, COORDINATOR, CLIENT))
            return Fault(at, kind, node, round(rng.uniform(1.0, 8.0), 2), details)
        case "cut":
            lasts = round(rng.uniform(10.5, 14.0) if rng.random() < 0.2 else rng.uniform(0.5, 6.0), 2)
            return Fault(at, kind, rng.choice((worker, worker, COORDINATOR, CLIENT)), lasts,
                         {"way": rng.choice(("in", "out", "both"))})
        case "unplug":
            return Fault(at, kind, rng.choice((worker, COORDINATOR)), round(rng.uniform(0.5, 5.0), 2))
        case "disk_full":
            return Fault(at, kind, COORDINATOR, round(rng.uniform(0.5, 5.0), 2),
                         {"left": rng.choice((0, 0, 4096, 20000, 200000))})
        case "clock":
            step = rng.choice((-1, 1)) * rng.choice((0.5, 5, 60, 3600, 40 * 86400))
            return Fault(at, kind, COORDINATOR, round(rng.uniform(1.0, 5.0), 2), {"step": step})
        case "flip":
            return Fault(at, kind, COORDINATOR, 0.0, {"what": rng.choice(FLIPPED), **_spot(rng)})
        case "torn":
            return Fault(at, kind, COORDINATOR, shortly, {"what": rng.choice(TORN), **_spot(rng)})
    raise ValueError(f"no fault is called {kind}")


def _spot(rng: random.Random) -> dict[str, float | str]:
    """Which file, which byte of it, and which bit."""
    return {"file": round(rng.random(), 6), "byte": round(rng.random(), 6), "bit": rng.randrange(8)}
