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
        with log.open("ab") as out:
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

    def send(self, number: signal.Signals) -> None:
        """Sends a signal; a process that has ended needs none."""
        if self.runs():
            self._child.send_signal(number)
            if number in (signal.SIGSTOP, signal.SIGCONT):
                self.stopped = number == signal.SIGSTOP

    def kill(self) -> None:
        """Kills it and waits until it is gone."""
        self.send(signal.SIGKILL)
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
