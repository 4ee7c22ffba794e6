"""The faults: how each kind begins, and how it ends."""

from __future__ import annotations

import signal
import threading
import time
from typing import Callable

from . import disk
from .farm import Farm
from .plan import COORDINATOR, Fault
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
    farm.take_down(fault.node, gently=True)
    return lambda: farm.let_up(fault.node)


def _kill_at_commit(farm: Farm, fault: Fault) -> Undo:
    journal = farm.disk.journal

    def length() -> int:
        try:
            return journal.stat().st_size
        except OSError:
            return 0

    def watch() -> None:
        until, before, grown = time.monotonic() + WAIT, length(), 0
        while time.monotonic() < until and grown < int(fault.details["commits"]):
            now = length()
            grown += now > before
            before = now
            time.sleep(0.0003)
        time.sleep(float(fault.details["after"]))
        farm.take_down(COORDINATOR)
        farm.note(f"killed the coordinator after {grown} commits")
        time.sleep(fault.lasts)
        farm.let_up(COORDINATOR)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    return watcher.join


def _stop(farm: Farm, fault: Fault) -> Undo:
    farm.send(fault.node, signal.SIGSTOP)
    return lambda: farm.send(fault.node, signal.SIGCONT)


def _over_ways(farm: Farm, fault: Fault, weather: Weather) -> Undo:
    """Weather on the packets to a node, from it, or both."""
    way, others = fault.details["way"], [number for number in farm.spaces if number != fault.node]
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
    farm.take_down(COORDINATOR)
    if not _damage(farm, fault):
        farm.note(f"there is no {fault.details['what']} to damage")
    return lambda: farm.let_up(COORDINATOR)


def _damage(farm: Farm, fault: Fault) -> bool:
    """Damages a file and notes which; false when there is none of its kind."""
    what, spot = str(fault.details["what"]), float(fault.details["byte"])
    if what == "journal":
        farm.note(disk.leave_unfinished(farm.disk.journal, spot))
        return True
    if what == "events":
        farm.note(disk.tear(farm.disk.events(), 200, spot))
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
    "unplug": _unplug, "disk_full": _disk_full, "clock": _clock, "flip": _flip, "torn": _torn,
}
