"""Schedules: what is done to a farm and when, drawn from a seed alone, written and read as JSON."""

from __future__ import annotations

import json
import random
from dataclasses import asdict, dataclass, replace

from . import drawing
from .drawing import Fault
from .worlds import WORLDS, named


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
    chosen = named(world or drawn)
    if chosen.store == "database" or chosen.liar:
        # Which of two coordinators lives on is not known before, and what a liar did is computed again in jobs of before.
        rounds = 1
    if chosen.liar:
        # Two who agree when a third one is away.
        workers = 4
    errands = [Errand(0.0, "submit", 0)]
    if rounds == 1:
        # One after the other, so that there is always work that can be disturbed.
        errands += [Errand(round(rng.uniform(at, at + 1.0), 2), "submit", at + 1) for at in range(3)]
        if rng.random() < 0.4:
            errands.append(Errand(round(rng.uniform(0.5, 4.0), 2), rng.choice(("pause", "cancel")), 4))
    # In a schedule of many rounds the same process has to be there at the end.
    faults = [drawing.fault(rng, chosen, workers, spare=rounds > 1) for _ in range(rng.randrange(3, 9))]
    faults.sort(key=lambda fault: fault.at)
    return Schedule(seed, chosen.name, workers, closed, same_names, talkative, rounds, tuple(errands), tuple(faults))
