"""Processes of the program under test: started in their namespace, signalled by number, logged to a file."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from .spaces import Space


class Process:
    """A process that runs until it is ended or ends by itself."""

    def __init__(self, name: str, space: Space, command: list[str], log: Path, environment: dict[str, str]) -> None:
        self.name = name
        self.stopped = False
        self.log = log
        self.began = time.monotonic()
        with log.open("ab") as out:
            # What earlier processes of the node have said is before.
            self._from = out.tell()
            out.write(f"== {' '.join(command)}\n".encode())
            out.flush()
            self._child = subprocess.Popen(
                space.within(command), stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment)

    @property
    def pid(self) -> int:
        return self._child.pid

    def code(self) -> int | None:
        """The exit code of a process that has ended; -N after signal N."""
        return self._child.poll()

    def runs(self) -> bool:
        return self.code() is None

    def send(self, number: signal.Signals, whole: bool = False) -> None:
        """Sends a signal, also to its children if the whole of it is meant; a process that has ended needs none."""
        children = self._children() if whole else []
        if self.runs():
            self._child.send_signal(number)
            if number in (signal.SIGSTOP, signal.SIGCONT):
                self.stopped = number == signal.SIGSTOP
        for child in children:
            try:
                os.kill(child, number)
            except ProcessLookupError:
                # It has ended meanwhile.
                continue

    def _children(self) -> list[int]:
        try:
            return [int(pid) for pid in Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()]
        except OSError:
            return []

    def kill(self) -> None:
        """Kills it and its children, and waits until it is gone."""
        self.send(signal.SIGKILL, whole=True)
        self._child.wait()

    def ended_within(self, seconds: float) -> bool:
        """Waits for the end."""
        try:
            self._child.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def arguments(self) -> str:
        """The argument list as the system shows it to everybody."""
        try:
            return Path(f"/proc/{self.pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            return ""

    def said(self) -> str:
        """What it has written to its log."""
        with self.log.open("rb") as log:
            log.seek(self._from)
            return log.read().decode(errors="replace")

    def handles(self) -> int:
        """Open file descriptors."""
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def resident(self) -> int:
        """Bytes of memory in use."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")


def run(command: list[str], environment: dict[str, str], limit: float, folder: Path) -> tuple[int, str, str]:
    """Runs a command to its end: its code, -9 when it took too long, stdout and stderr."""
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                             env=environment, cwd=folder, text=True, errors="replace")
    try:
        out, err = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        child.kill()
        out, err = child.communicate()
        return -9, out, f"{err}(took longer than {limit} s)"
    return child.returncode, out, err


def wait_until(look, limit: float, every: float = 0.05) -> bool:
    """Looks until `look()` is true; false when that takes too long."""
    until = time.monotonic() + limit
    while not look():
        if time.monotonic() > until:
            return False
        time.sleep(every)
    return True
