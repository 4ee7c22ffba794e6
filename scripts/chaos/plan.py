"""Schedules: the errands and faults of a farm with their times.

A seed determines a schedule. The format is JSON.
"""

from __future__ import annotations

import json
import random
from dataclasses import asdict, dataclass, replace

from . import drawing
from .drawing import Fault
from .worlds import WORLDS, named


@dataclass(frozen=True)
class Errand:
    """A request that a client repeats until the coordinator acknowledges it: submit, pause or cancel."""

    at: float
    kind: str
    variant: int


@dataclass(frozen=True)
class Schedule:
    """A farm with its errands and faults."""

    seed: int
    world: str
    workers: int
    # True if the farm uses encryption, workers' certificates and tokens.
    closed: bool
    # True if a restarted worker has the same name as before.
    same_names: bool
    # True for detailed logs, which are more likely to contain a secret by mistake.
    talkative: bool
    # The number of jobs that one coordinator computes without a restart, to check its memory and open files.
    # With 1, the schedule may contain all kinds of faults.
    rounds: int
    errands: tuple[Errand, ...]
    faults: tuple[Fault, ...]

    def without(self, number: int) -> Schedule:
        """Returns the schedule without the fault with this number."""
        return replace(self, faults=(*self.faults[:number], *self.faults[number + 1:]))

    def variants(self, of_world: int) -> set[int]:
        """Returns the variants of the schedule's jobs with results, for a world with `of_world` variants."""
        if self.rounds > 1:
            return set(range(min(self.rounds, of_world)))
        # A cancelled job has no result.
        return {errand.variant for errand in self.errands if errand.kind != "cancel"}

    def dump(self) -> str:
        """Returns the schedule as JSON."""
        return json.dumps(asdict(self), indent=1)

    @staticmethod
    def load(text: str) -> Schedule:
        """Reads a schedule from the JSON text of `dump`.

        Raises TypeError, KeyError or ValueError for other text.
        """
        read = json.loads(text)
        read["errands"] = tuple(Errand(**errand) for errand in read["errands"])
        read["faults"] = tuple(Fault(**fault) for fault in read["faults"])
        return Schedule(**read)


def draw(seed: int, world: str | None = None) -> Schedule:
    """Returns the schedule of a seed, in the given world or in a random world."""
    rng = random.Random(f"schedule {seed}")
    drawn = rng.choices(WORLDS, [w.weight for w in WORLDS])[0].name
    workers = rng.choice((2, 3, 3, 4))
    closed, same_names, talkative = rng.random() < 0.35, rng.random() < 0.15, rng.random() < 0.5
    rounds = 5 if rng.random() < 0.06 else 1
    chosen = named(world or drawn)
    if chosen.store == "database" or chosen.liar:
        # With two coordinators, either can lead, so no single process can be measured. With a liar, workers
        # compute tiles of earlier jobs again.
        rounds = 1
    if chosen.liar:
        # With four workers, two honest workers can agree while a third one is down.
        workers = 4
    errands = [Errand(0.0, "submit", 0)]
    if rounds == 1:
        # The jobs start one after the other, so that a job runs at the time of each fault.
        errands += [Errand(round(rng.uniform(at, at + 1.0), 2), "submit", at + 1) for at in range(3)]
        if rng.random() < 0.4:
            errands.append(Errand(round(rng.uniform(0.5, 4.0), 2), rng.choice(("pause", "cancel")), 4))
    # In a schedule with several rounds, faults must not end the coordinator's process.
    faults = [drawing.fault(rng, chosen, workers, spare=rounds > 1) for _ in range(rng.randrange(3, 9))]
    faults.sort(key=lambda fault: fault.at)
    return Schedule(seed, chosen.name, workers, closed, same_names, talkative, rounds, tuple(errands),
                    tuple(faults))
