"""A farm: coordinators and their services, workers and a client, each in a separate network namespace.

The farm restarts processes that end by themselves, like a service manager.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

from . import commands, keys
from .commands import PORT
from .disk import Disk
from .nodes import BALANCER, BUCKET, CLIENT, COORDINATOR, DATABASE, FIRST_WORKER, SECOND
from .plan import Schedule
from .processes import Process, run, wait_until
from .services import PASSWORD, SECRET, Bucket, Database
from .spaces import Space
from .switch import Switch
from .worlds import Calm, named

# The delay before the farm restarts a process that ended by itself, in seconds.
AGAIN = 0.5
# The time limit of a client's call, in seconds.
CALL = 15.0
# The texts that a service prints when it accepts connections, and the time limit for its start, in seconds.
READY = ("listening on", "ready to accept connections")
STARTS = 60.0
# The text that one of two coordinators prints when it begins to lead.
LEADS = "this coordinator leads"
# The length of the end of a log that a report contains, in bytes.
END = 4000


class Farm:
    """All processes of a schedule. Several threads may call the methods at a time."""

    def __init__(self, calm: Calm, schedule: Schedule, folder: Path) -> None:
        self.calm = calm
        self.schedule = schedule
        self.world = named(schedule.world)
        self.folder = folder
        self.logs = folder / "logs"
        self.logs.mkdir(parents=True)
        self.began = time.monotonic()
        self.keys = keys.make(calm.program, folder / "keys") if schedule.closed else None
        self.disk = Disk(folder / "disk", self.world.disk, self.world.store)
        has_database, has_bucket = self.world.store == "database", self.world.store == "bucket"
        self.coordinators = (COORDINATOR, SECOND) if has_database else (COORDINATOR,)
        self.database = Database(calm.database, f"chaos-{os.getpid()}") if has_database else None
        self.bucket = Bucket(calm.program, self.disk.bucket, schedule.seed) if has_bucket else None
        # The workers that return wrong bytes.
        self.liars = {FIRST_WORKER} if self.world.liar else set()
        self.scenes: set[str] = set()
        # The kinds of files in which a fault flipped a bit.
        self.damaged: set[str] = set()
        # The processes that ended by themselves: name, exit code, and end of the log.
        self.endings: list[tuple[str, int, str]] = []
        self.arguments: set[str] = set()
        self.restarts = 0
        self._lock = threading.RLock()
        self._nodes: dict[int, Process] = {}
        # The number of faults that keep each node down.
        self._down: dict[int, int] = {}
        self._since: dict[int, float] = {}
        self.clock = folder / "clock"
        self._steps: list[float] = []
        self.clock.write_text("+0\n")
        self.has_clock = any(fault.kind == "clock" for fault in schedule.faults)
        self.services = (DATABASE, BALANCER) if has_database else (BUCKET,) if has_bucket else ()
        numbers = [*self.services, *self.coordinators, *self.workers(), CLIENT]
        self.spaces = {number: Space(f"s{os.getpid()}-{number}", number) for number in numbers}
        self.switch = Switch({number: space.device for number, space in self.spaces.items()}, schedule.seed)
        self.switch.start()

    def workers(self) -> range:
        """Returns the numbers of the workers."""
        return range(FIRST_WORKER, FIRST_WORKER + self.schedule.workers)

    @property
    def shares_tiles(self) -> bool:
        """True if workers help with the tiles of other workers, which happens only with the sampler for
        lines."""
        return self.world.calm in ("lines", "crew")

    def note(self, text: str) -> None:
        """Writes a line to the log of the schedule."""
        with self._lock, (self.logs / "schedule.log").open("a") as log:
            log.write(f"{time.monotonic() - self.began:8.3f} {text}\n")

    def start(self) -> None:
        """Starts all nodes: first the services that the coordinators need, then coordinators and workers."""
        for number in self.services:
            self._start(number)
        for number in self.services:
            process = self._nodes[number]
            if not wait_until(lambda: any(word in process.said() for word in READY), STARTS):
                raise RuntimeError(f"{process.name} is not ready after {STARTS} s:\n{process.said()[-END:]}")
        for number in [*self.coordinators, *self.workers()]:
            self._start(number)

    @property
    def url(self) -> str:
        """The address that workers and clients call."""
        at = BALANCER if self.database else COORDINATOR
        return f"{'https' if self.keys else 'http'}://{self.spaces[at].address}:{PORT}"

    def secrets(self) -> list[bytes]:
        """Returns the secrets, which logs, argument lists and files other than the files of keys must not
        contain."""
        found = self.keys.secrets() if self.keys else []
        of_services = ([PASSWORD.encode()] if self.database else []) + ([SECRET.encode()] if self.bucket else [])
        return found + of_services

    def leader(self) -> int:
        """Returns the coordinator that started last, of the coordinators whose logs report a leadership."""
        begun = [number for number in self.coordinators if number in self._nodes
                 and LEADS in self._nodes[number].said()]
        return max(begun, key=lambda number: self._nodes[number].began, default=COORDINATOR)

    def written(self) -> int:
        """Returns a number that grows when a coordinator writes records."""
        if self.database:
            return self.database.written()
        try:
            return self.disk.journal.stat().st_size
        except OSError:
            return 0

    def _environment(self) -> dict[str, str]:
        """Returns the environment of all processes."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SIGHTLINE_")}
        environment["XDG_CACHE_HOME"] = str(self.folder / "cache")
        environment["RUST_BACKTRACE"] = "1"
        if self.schedule.talkative:
            environment["SIGHTLINE_LOG"] = "sightline=debug"
        return environment

    def _start(self, number: int) -> None:
        """Starts the process of a node."""
        name, command, more = commands.of(self, number)
        environment = {**self._environment(), **more}
        self._nodes[number] = Process(name, self.spaces[number], command, self.logs / f"{name}.log",
                                      environment)

    def coordinator(self) -> Process | None:
        """Returns the process of the first coordinator, or None while it is down."""
        return self._nodes.get(COORDINATOR)

    def send(self, number: int, what: signal.Signals, whole: bool = False) -> None:
        """Sends a signal to a node. With `whole`, also sends the signal to its child processes."""
        with self._lock:
            if number in self._nodes:
                self._nodes[number].send(what, whole)

    def take_down(self, number: int, gently: signal.Signals | None = None) -> None:
        """Kills a node, or ends it with the signal `gently`, and keeps it down until `let_up`."""
        with self._lock:
            self._down[number] = self._down.get(number, 0) + 1
            process = self._nodes.get(number)
            if process:
                self.arguments.add(process.arguments())
                # A stopped process does not handle signals, so kill it.
                if gently and not process.stopped:
                    process.send(gently)
                else:
                    process.kill()
                    del self._nodes[number]

    def let_up(self, number: int) -> None:
        """Ends one `take_down`. At the end of the last one, the node starts again."""
        with self._lock:
            self._down[number] -= 1
            if self._down[number] == 0:
                process = self._nodes.pop(number, None)
                if process and process.runs():
                    self.note(f"{process.name} did not end before its restart")
                    process.kill()
                self._start(number)

    def tend(self) -> None:
        """Restarts processes that ended by themselves, after a short delay."""
        with self._lock:
            for number, process in list(self._nodes.items()):
                code = process.code()
                if code is None or self._down.get(number, 0) > 0:
                    self._since.pop(number, None)
                elif number not in self._since:
                    self._since[number] = time.monotonic()
                    self.endings.append((process.name, code, process.said()[-END:]))
                    self.note(f"{process.name} ended by itself with exit code {code}")
                elif time.monotonic() - self._since[number] > AGAIN:
                    del self._since[number]
                    self._start(number)

    def step_clock(self, seconds: float, back: bool = False) -> None:
        """Adds seconds to the coordinator's wall clock. With `back`, reverts an earlier change."""
        with self._lock:
            if back:
                self._steps.remove(seconds)
            else:
                self._steps.append(seconds)
            self.clock.write_text(f"{sum(self._steps):+}\n")

    def call(self, words: list[str], limit: float = CALL) -> tuple[int, str, str]:
        """Runs `sightline WORDS` in the client's namespace. Returns the exit code, stdout and stderr."""
        credentials = self.keys.client() if self.keys else []
        command = [str(self.calm.program), *words, "--coordinator", self.url, *credentials]
        code, out, err = run(self.spaces[CLIENT].within(command), self._environment(), limit, self.folder)
        with self._lock, (self.logs / "client.log").open("a") as log:
            log.write(f"{time.monotonic() - self.began:8.3f} sightline {' '.join(words)}: {code}\n{err}")
        return code, out, err

    def call_alone(self, words: list[str]) -> tuple[int, str, str]:
        """Runs `sightline WORDS` without a coordinator. Returns the exit code, stdout and stderr."""
        return run([str(self.calm.program), *words], self._environment(), 60.0, self.folder)

    def ask(self, words: list[str]) -> Any:
        """Returns the JSON output of `sightline WORDS --json`, or None if the call fails."""
        code, out, _ = self.call([*words, "--json"])
        return json.loads(out) if code == 0 else None

    def end(self) -> list[str]:
        """Ends first the workers and then the coordinators with SIGTERM. Returns the problems."""
        wrong = []
        with self._lock:
            workers = [self._nodes[number] for number in self.workers() if number in self._nodes]
            coordinators = [self._nodes[number] for number in self.coordinators if number in self._nodes]
            for group in (workers, coordinators):
                for process in group:
                    self.arguments.add(process.arguments())
                    process.send(signal.SIGTERM)
                for process in group:
                    if not process.ended_within(30.0):
                        wrong.append(f"{process.name} did not end within 30 s after SIGTERM")
                        process.kill()
                    elif process.code() != 0:
                        wrong.append(f"{process.name} ended with exit code {process.code()} after SIGTERM")
            for number in self.services:
                if number in self._nodes:
                    self._nodes[number].kill()
            self._nodes.clear()
        return wrong

    def remove(self) -> None:
        """Kills remaining processes, and removes the network and the disk."""
        with self._lock:
            for process in self._nodes.values():
                process.kill()
            self._nodes.clear()
        self.switch.end()
        for space in self.spaces.values():
            space.remove()
        self.disk.remove()
        if self.database:
            self.database.remove()
