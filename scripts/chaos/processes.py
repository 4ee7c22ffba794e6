"""Processes of the program under test: start in a namespace, signals, and logs in files."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from .spaces import Space


class Process:
    """A process of a node, with its log."""

    def __init__(self, name: str, space: Space, command: list[str], log: Path,
                 environment: dict[str, str]) -> None:
        self.name = name
        self.stopped = False
        self.log = log
        self.began = time.monotonic()
        with log.open("ab") as out:
            # The log already contains the output of earlier processes of the node.
            self._from = out.tell()
            out.write(f"== {' '.join(command)}\n".encode())
            out.flush()
            self._child = subprocess.Popen(
                space.within(command), stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment)

    @property
    def pid(self) -> int:
        return self._child.pid

    def code(self) -> int | None:
        """Returns the exit code, -N after signal N, or None while the process runs."""
        return self._child.poll()

    def runs(self) -> bool:
        """Returns true if the process has not ended."""
        return self.code() is None

    def send(self, number: signal.Signals, whole: bool = False) -> None:
        """Sends a signal if the process runs. With `whole`, also sends the signal to its child processes."""
        children = self._children() if whole else []
        if self.runs():
            self._child.send_signal(number)
            if number in (signal.SIGSTOP, signal.SIGCONT):
                self.stopped = number == signal.SIGSTOP
        for child in children:
            try:
                os.kill(child, number)
            except ProcessLookupError:
                # The child process has ended.
                continue

    def _children(self) -> list[int]:
        """Returns the numbers of the child processes."""
        try:
            return [int(pid)
                    for pid in Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()]
        except OSError:
            return []

    def kill(self) -> None:
        """Kills the process and its child processes, and waits for the end of the process."""
        self.send(signal.SIGKILL, whole=True)
        self._child.wait()

    def ended_within(self, seconds: float) -> bool:
        """Waits for the end of the process. Returns false if it still runs after this time."""
        try:
            self._child.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def arguments(self) -> str:
        """Returns the argument list, which all users of the machine can read."""
        try:
            arguments = Path(f"/proc/{self.pid}/cmdline").read_bytes()
            return arguments.replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            return ""

    def said(self) -> str:
        """Returns the text that the process has written to its log."""
        with self.log.open("rb") as log:
            log.seek(self._from)
            return log.read().decode(errors="replace")

    def handles(self) -> int:
        """Returns the number of open file descriptors."""
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def resident(self) -> int:
        """Returns the resident memory, in bytes."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")


def run(command: list[str], environment: dict[str, str], limit: float, folder: Path) -> tuple[int, str, str]:
    """Runs a command.

    Returns its exit code, or -9 after the time limit in seconds, and its stdout and stderr.
    """
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE,
                             env=environment, cwd=folder, text=True, errors="replace")
    try:
        out, err = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        child.kill()
        out, err = child.communicate()
        return -9, out, f"{err}(still running after {limit} s)"
    return child.returncode, out, err


def wait_until(look, limit: float, every: float = 0.05) -> bool:
    """Calls `look` repeatedly until it returns true. Returns false after the time limit in seconds."""
    until = time.monotonic() + limit
    while not look():
        if time.monotonic() > until:
            return False
        time.sleep(every)
    return True
