"""The faults: how each kind begins, and how it ends."""

from __future__ import annotations

import signal
import threading
import time
from typing import Callable

from . import disk
from .drawing import Fault
from .farm import Farm
from .nodes import COORDINATOR, SECOND
from .switch import Weather

Undo = Callable[[], None]
# How long a kill at a commit waits for the commit, and a flipped bit for a file, in seconds. Then the coordinator is
# killed without a commit, and nothing is flipped.
WAIT = 4.0


def begin(farm: Farm, fault: Fault) -> Undo:
    """Begins a fault; what is returned ends it."""
    farm.note(f"begins: {fault}")
    return BEGIN[fault.kind](farm, fault)


def duration(fault: Fault) -> float:
    """Seconds from the begin to the end of a fault."""
    return fault.lasts + (WAIT if fault.kind in ("kill_at_commit", "flip") else 0.0)


def _kill(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node)
    return lambda: farm.let_up(fault.node)


def _term(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node, signal.SIGTERM)
    return lambda: farm.let_up(fault.node)


# The ways to end a database: without waiting for those who are connected, without writing down what is in memory, and
# without its knowledge.
ENDS = {"fast": signal.SIGINT, "immediate": signal.SIGQUIT, "killed": None}


def _restart(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node, ENDS[str(fault.details["how"])])
    return lambda: farm.let_up(fault.node)


def _kill_at_commit(farm: Farm, fault: Fault) -> Undo:
    def watch() -> None:
        until, before, grown = time.monotonic() + WAIT, farm.written(), 0
        while time.monotonic() < until and grown < int(fault.details["commits"]):
            now = farm.written()
            grown += now > before
            before = now
            time.sleep(0.0003)
        time.sleep(float(fault.details["after"]))
        # Of two the one that commits.
        node = farm.leader() if farm.database else COORDINATOR
        farm.take_down(node)
        farm.note(f"killed coordinator {node} after {grown} commits")
        time.sleep(fault.lasts)
        farm.let_up(node)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    return watcher.join


def _stop(farm: Farm, fault: Fault) -> Undo:
    # A database whose first process alone is stopped answers those who are connected, and nobody else.
    whole = fault.details.get("whole", "yes") == "yes"
    farm.send(fault.node, signal.SIGSTOP, whole)
    return lambda: farm.send(fault.node, signal.SIGCONT, whole=True)


def _slow(farm: Farm, fault: Fault) -> Undo:
    def halt() -> None:
        until = time.monotonic() + fault.lasts
        while time.monotonic() < until:
            farm.send(fault.node, signal.SIGSTOP, whole=True)
            time.sleep(float(fault.details["stopped"]))
            farm.send(fault.node, signal.SIGCONT, whole=True)
            time.sleep(float(fault.details["runs"]))

    halting = threading.Thread(target=halt, daemon=True)
    halting.start()
    return halting.join


def _over_ways(farm: Farm, fault: Fault, weather: Weather) -> Undo:
    """Weather on the packets to a node, from it, or both; between it and another one alone where that is named."""
    way, others = fault.details["way"], [number for number in farm.spaces if number != fault.node]
    if "peer" in fault.details:
        others = [int(fault.details["peer"])]
    ways = [(other, fault.node) for other in others if way in ("in", "both")]
    ways += [(fault.node, other) for other in others if way in ("out", "both")]
    for source, target in ways:
        farm.switch.change(source, target, weather)

    def undo() -> None:
        for source, target in ways:
            farm.switch.restore(source, target, weather)

    return undo


def _weather(farm: Farm, fault: Fault) -> Undo:
    parts = ("loss", "delay", "jitter", "duplicate", "reorder")
    return _over_ways(farm, fault, Weather(**{part: float(fault.details[part]) for part in parts}))


def _cut(farm: Farm, fault: Fault) -> Undo:
    return _over_ways(farm, fault, Weather(cut=True))


def _unplug(farm: Farm, fault: Fault) -> Undo:
    farm.spaces[fault.node].link(up=False)
    return lambda: farm.spaces[fault.node].link(up=True)


def _disk_full(farm: Farm, fault: Fault) -> Undo:
    filler = farm.disk.fill(f"filler-{fault.at}", int(fault.details["left"]))
    return lambda: filler.unlink(missing_ok=True)


def _clock(farm: Farm, fault: Fault) -> Undo:
    step = float(fault.details["step"])
    farm.step_clock(step)
    return lambda: farm.step_clock(step, back=True)


def _flip(farm: Farm, fault: Fault) -> Undo:
    def watch() -> None:
        until = time.monotonic() + WAIT
        while not _damage(farm, fault) and time.monotonic() < until:
            time.sleep(0.02)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    return watcher.join


def _torn(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node)
    if not _damage(farm, fault):
        farm.note(f"there is no {fault.details['what']} to damage")
    return lambda: farm.let_up(fault.node)


def _damage(farm: Farm, fault: Fault) -> bool:
    """Damages a file and notes which; false when there is none of its kind."""
    what, spot = str(fault.details["what"]), float(fault.details["byte"])
    if what == "journal":
        farm.note(disk.leave_unfinished(farm.disk.journal, spot))
        return True
    if what == "events":
        farm.note(disk.tear(farm.disk.events(second=fault.node == SECOND), 200, spot))
        return True
    scenes, tiles = farm.disk.blobs(farm.scenes)
    files = {"scene": scenes, "tile": tiles, "outcome": farm.disk.outcomes(), "view": farm.disk.view()}[what]
    chosen = disk.choose(files, float(fault.details["file"]))
    done = chosen and disk.flip(chosen, spot, int(fault.details["bit"]))
    if done:
        farm.damaged.add(what)
        farm.note(f"turned over {done} ({what})")
    return bool(done)


BEGIN: dict[str, Callable[[Farm, Fault], Undo]] = {
    "kill": _kill, "kill_at_commit": _kill_at_commit, "term": _term, "stop": _stop, "weather": _weather, "cut": _cut,
    "unplug": _unplug, "restart": _restart, "slow": _slow, "disk_full": _disk_full, "clock": _clock, "flip": _flip, "torn": _torn,
}
