"""Random faults: the faults of all farms, and the faults of farms with a database, a bucket or a liar.

Some faults need data that exists only at their time, such as a stored blob. These faults contain fractions
that select from the data.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace

from .nodes import BUCKET, CLIENT, COORDINATOR, DATABASE, FIRST_WORKER, SECOND
from .worlds import World

# The relative frequency of each kind of fault.
KINDS = {
    "kill": 6, "kill_at_commit": 5, "term": 2, "stop": 4, "weather": 6, "cut": 5, "unplug": 2,
    "disk_full": 3, "clock": 2, "flip": 3, "torn": 3,
}
# The kinds of faults that can leave the coordinator's process running.
SPARING = ("kill", "stop", "weather", "cut")
# The data that a fault of the kind `flip` damages while all processes run, and that a fault of the kind
# `torn` damages while the coordinator is down.
FLIPPED = ("scene", "tile", "tile", "outcome")
TORN = ("journal", "events", "view", "outcome")
# The probability that a fault in a world with a database, a bucket or a liar is specific to the world.
OWN = 0.55
# The maximum duration of a fault of an honest worker in a farm with a liar, in seconds. If no other worker
# can check a tile for ten seconds, the coordinator leaves the tile unchecked and reports this.
AWAY = 6.0


@dataclass(frozen=True)
class Fault:
    """A fault with its time, in seconds after the start of the schedule, and its duration in seconds."""

    at: float
    kind: str
    node: int
    lasts: float
    # Additional parameters of the kind; see faults.py.
    details: dict[str, float | str] = field(default_factory=dict)


def fault(rng: random.Random, world: World, workers: int, spare: bool) -> Fault:
    """Draws a fault for a world. With `spare`, the fault does not end or stop the coordinator's process."""
    own = {"database": _of_database, "bucket": _of_bucket}.get(world.store)
    own = own or (_of_liar if world.liar else None)
    if own and rng.random() < OWN:
        return own(rng)
    kinds = {kind: weight for kind, weight in KINDS.items() if not spare or kind in SPARING}
    drawn = _of_kind(rng, rng.choices(list(kinds), list(kinds.values()))[0], workers, spare)
    if world.store == "database":
        return _of_either(rng, drawn)
    if world.liar and drawn.node >= FIRST_WORKER:
        return replace(drawn, lasts=min(drawn.lasts, AWAY))
    return drawn


def _of_either(rng: random.Random, drawn: Fault) -> Fault:
    """Moves a fault to one of two coordinators, and replaces damage of files that they do not have."""
    if drawn.node == COORDINATOR and drawn.kind not in ("kill_at_commit", "clock") and rng.random() < 0.5:
        drawn = replace(drawn, node=SECOND)
    if drawn.kind == "torn" and drawn.details["what"] in ("journal", "view"):
        drawn = replace(drawn, details={**drawn.details, "what": "events"})
    return drawn


def _of_database(rng: random.Random) -> Fault:
    """Draws a fault of the database, of the connection to the database, or of one of the two coordinators."""
    # Some of these times are before the first job, and most are during the jobs.
    at, shortly = round(rng.uniform(0.3, 7.0), 2), round(rng.uniform(0.1, 3.0), 2)
    either = rng.choice((COORDINATOR, SECOND))
    # A leadership is valid for three seconds, so the longer durations end it.
    long = round(rng.uniform(3.5, 9.0) if rng.random() < 0.4 else rng.uniform(0.3, 3.0), 2)
    weights = {"restart": 5, "stop": 3, "slow": 2, "weather": 3, "cut": 4, "kill": 3, "kill_at_commit": 3,
               "halt": 3}
    kind = rng.choices(list(weights), list(weights.values()))[0]
    match kind:
        case "restart":
            return Fault(at, kind, DATABASE, shortly, {"how": rng.choice(("fast", "immediate", "killed"))})
        case "stop":
            return Fault(at, kind, DATABASE, long, {"whole": rng.choice(("yes", "yes", "no"))})
        case "slow":
            return Fault(at, kind, DATABASE, long, _halting(rng))
        case "weather":
            return Fault(at, kind, DATABASE, round(rng.uniform(1.0, 8.0), 2), _late(rng))
        case "cut":
            details: dict[str, float | str] = {"way": rng.choice(("in", "out", "both", "both"))}
            if rng.random() < 0.25:
                return Fault(at, kind, COORDINATOR, long, {**details, "peer": float(SECOND)})
            # The cut separates the database from one coordinator or from all nodes.
            if rng.random() < 0.7:
                details["peer"] = float(either)
            return Fault(at, kind, DATABASE, long, details)
        case "kill":
            return Fault(at, kind, either, shortly)
        case "halt":
            # After a long stop, this coordinator continues while the other one leads.
            return Fault(at, "stop", either, long)
        case _:
            return Fault(at, kind, COORDINATOR, shortly,
                         {"commits": float(rng.randrange(1, 9)),
                          "after": rng.choice((0.0, 0.0, 0.001, 0.004))})


def _of_bucket(rng: random.Random) -> Fault:
    """Draws a fault of the object store, or of the connection to the object store."""
    at = round(rng.uniform(0.0, 5.0), 2)
    lasts = round(rng.uniform(6.0, 14.0) if rng.random() < 0.25 else rng.uniform(0.2, 4.0), 2)
    match rng.choices(("restart", "stop", "slow", "weather", "cut"), (5, 3, 2, 3, 4))[0]:
        case "restart":
            return Fault(at, "restart", BUCKET, lasts, {"how": "killed"})
        case "stop":
            return Fault(at, "stop", BUCKET, lasts)
        case "slow":
            return Fault(at, "slow", BUCKET, lasts, _halting(rng))
        case "weather":
            return Fault(at, "weather", BUCKET, round(rng.uniform(1.0, 8.0), 2), _late(rng))
        case _:
            return Fault(at, "cut", BUCKET, lasts, {"way": rng.choice(("in", "out", "both"))})


def _of_liar(rng: random.Random) -> Fault:
    """Draws a fault of the liar, or a restart of the coordinator, which loses the data in its memory."""
    at, shortly = round(rng.uniform(0.0, 5.0), 2), round(rng.uniform(0.1, 3.0), 2)
    kind = rng.choices(("kill", "stop", "cut", "term", "restart", "kill_at_commit"), (3, 3, 3, 2, 3, 3))[0]
    match kind:
        case "stop":
            return Fault(at, kind, FIRST_WORKER, round(rng.uniform(0.5, 14.0), 2))
        case "cut":
            return Fault(at, kind, FIRST_WORKER, round(rng.uniform(0.5, 14.0), 2),
                         {"way": rng.choice(("in", "out", "both"))})
        case "restart":
            return Fault(at, "kill", COORDINATOR, shortly)
        case "kill_at_commit":
            return Fault(at, kind, COORDINATOR, shortly,
                         {"commits": float(rng.randrange(1, 9)),
                          "after": rng.choice((0.0, 0.0, 0.001, 0.004))})
        case _:
            return Fault(at, kind, FIRST_WORKER, shortly)


def _halting(rng: random.Random) -> dict[str, float | str]:
    """Draws the times for which a slow process is stopped and for which it runs, alternately, in seconds."""
    return {"stopped": round(rng.uniform(0.05, 0.8), 3), "runs": round(rng.uniform(0.01, 0.1), 3)}


def _late(rng: random.Random) -> dict[str, float | str]:
    """Draws weather with mainly long delays."""
    delay = round(rng.choice((0.05, 0.2, 0.8)) * rng.random(), 3)
    return {
        "delay": delay, "jitter": round(delay * rng.random(), 3),
        "loss": round(rng.choice((0.0, 0.02, 0.2)) * rng.random(), 3),
        "duplicate": round(rng.choice((0.0, 0.3)) * rng.random(), 3),
        "reorder": round(rng.choice((0.0, 0.3)) * rng.random(), 3),
        "way": rng.choice(("in", "out", "both")),
    }


def _of_kind(rng: random.Random, kind: str, workers: int, spare: bool) -> Fault:
    """Draws a fault of a kind that all farms have.

    With `spare`, the fault does not end the coordinator's process.
    """
    at = round(rng.uniform(0.0, 5.0), 2)
    worker = rng.randrange(FIRST_WORKER, FIRST_WORKER + workers)
    anybody = worker if spare or rng.random() < 0.5 else COORDINATOR
    shortly = round(rng.uniform(0.1, 3.0), 2)
    details: dict[str, float | str] = {}
    match kind:
        case "kill" | "term":
            return Fault(at, kind, anybody, shortly)
        case "kill_at_commit":
            # The number of the commit, counted from the time of the fault, and the delay after this commit in
            # seconds.
            return Fault(at, kind, COORDINATOR, shortly,
                         {"commits": rng.randrange(1, 9), "after": rng.choice((0.0, 0.0, 0.001, 0.004))})
        case "stop":
            # A lease is valid for ten seconds, so the longer durations end it.
            lasts = round(rng.uniform(10.5, 15.0) if rng.random() < 0.25 else rng.uniform(0.5, 6.0), 2)
            return Fault(at, kind, anybody, lasts)
        case "weather":
            worst = rng.choice((0.02, 0.1, 0.3))
            details = {
                "loss": round(rng.uniform(0.0, worst), 3),
                "delay": round(rng.choice((0.0, 0.02, 0.1, 0.5)) * rng.random(), 3),
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
    raise ValueError(f"unknown kind of fault: {kind}")


def _spot(rng: random.Random) -> dict[str, float | str]:
    """Draws the place of a damage: the file and the byte as fractions, and the number of the bit."""
    return {"file": round(rng.random(), 6), "byte": round(rng.random(), 6), "bit": rng.randrange(8)}
