"""Injection of faults: for each kind, a function that begins a fault and returns a function that ends it."""

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
# The time limit for the commit of `kill_at_commit` and for the file of `flip`, in seconds. After this time,
# `kill_at_commit` kills the coordinator without a commit, and `flip` has no effect.
WAIT = 4.0


def begin(farm: Farm, fault: Fault) -> Undo:
    """Begins a fault. Returns the function that ends it."""
    farm.note(f"begins: {fault}")
    return BEGIN[fault.kind](farm, fault)


def duration(fault: Fault) -> float:
    """Returns the maximum time from the start to the end of a fault, in seconds."""
    return fault.lasts + (WAIT if fault.kind in ("kill_at_commit", "flip") else 0.0)


def _kill(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node)
    return lambda: farm.let_up(fault.node)


def _term(farm: Farm, fault: Fault) -> Undo:
    farm.take_down(fault.node, signal.SIGTERM)
    return lambda: farm.let_up(fault.node)


# The signals that end a database: SIGINT does not wait for clients, SIGQUIT does not write data from memory,
# and None stands for SIGKILL.
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
        # Of two coordinators, only the leader commits.
        node = farm.leader() if farm.database else COORDINATOR
        farm.take_down(node)
        farm.note(f"killed coordinator {node} after {grown} commits")
        time.sleep(fault.lasts)
        farm.let_up(node)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    return watcher.join


def _stop(farm: Farm, fault: Fault) -> Undo:
    # If only the first process of a database is stopped, the database answers connected clients and accepts
    # no others.
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
    """Adds weather to the packets to a node, from a node, or both.

    With the detail `peer`, only between two nodes.
    """
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
        farm.note(f"no file of the kind {fault.details['what']} exists, so no file is damaged")
    return lambda: farm.let_up(fault.node)


def _damage(farm: Farm, fault: Fault) -> bool:
    """Damages a file and writes its name to the log. Returns false if no file of the kind exists."""
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
        farm.note(f"flipped {done} ({what})")
    return bool(done)


BEGIN: dict[str, Callable[[Farm, Fault], Undo]] = {
    "kill": _kill, "kill_at_commit": _kill_at_commit, "term": _term, "stop": _stop, "weather": _weather,
    "cut": _cut, "unplug": _unplug, "restart": _restart, "slow": _slow, "disk_full": _disk_full,
    "clock": _clock, "flip": _flip, "torn": _torn,
}
