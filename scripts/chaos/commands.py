"""The name, the command and the environment of the process on each node of a farm."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from . import liars
from .nodes import BALANCER, BUCKET, COORDINATOR, DATABASE, SECOND
from .services import Bucket, Database
from .worlds import BACKEND

if TYPE_CHECKING:
    from .farm import Farm

PORT = 7600
# The name of the liar, the worker that returns wrong bytes.
LIAR = "liar"
# The library of Debian's package faketime, or None if the package is not installed.
FAKETIME = next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)

# The name of a node, its command, and the variables that only this node has.
Command = tuple[str, list[str], dict[str, str]]


def of(farm: Farm, number: int) -> Command:
    """Returns the command of a node."""
    if number in farm.coordinators:
        return _coordinator(farm, number)
    if number == DATABASE and farm.database:
        return "database", farm.database.command(), {}
    if number == BUCKET and farm.bucket:
        return "bucket", farm.bucket.command(), {}
    if number == BALANCER:
        addresses = [farm.spaces[coordinator].address for coordinator in farm.coordinators]
        return "balancer", [sys.executable, "-m", "chaos.balancer", farm.spaces[number].address, str(PORT),
                            *addresses], {}
    return _worker(farm, number)


def _coordinator(farm: Farm, number: int) -> Command:
    data = farm.disk.second if number == SECOND else farm.disk.data
    command = [str(farm.calm.program), "coordinator", "--listen", f"{farm.spaces[number].address}:{PORT}",
               "--data-dir", str(data), *farm.world.coordinator]
    environment: dict[str, str] = {}
    if farm.keys:
        command += farm.keys.coordinator(pair=farm.database is not None)
    # Connections to the bucket are not encrypted.
    if not farm.keys or farm.bucket:
        command.append("--allow-plaintext")
    if farm.bucket:
        command += farm.bucket.coordinator()
        environment |= Bucket.environment()
    if farm.database:
        environment |= Database.environment()
    # The clock faults affect only this coordinator. A second coordinator keeps the correct clock.
    if farm.has_clock and number == COORDINATOR:
        environment |= {
            "LD_PRELOAD": str(FAKETIME), "FAKETIME_TIMESTAMP_FILE": str(farm.clock), "NO_FAKE_STAT": "1",
            "FAKETIME_CACHE_DURATION": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1",
        }
    return "coordinator" if number == COORDINATOR else "second", command, environment


def _worker(farm: Farm, number: int) -> Command:
    farm.restarts += 1
    lies = number in farm.liars
    name = f"worker-{number}"
    # The liar keeps its name, because the coordinator would accept it again under another name
    # (docs/security.md).
    called = LIAR if lies else name + ("" if farm.schedule.same_names else f"-{farm.restarts}")
    command = [str(farm.calm.program), "worker", "--coordinator", farm.url, "--backend", BACKEND,
               "--threads", "1", "--name", called]
    command += farm.keys.worker(pair=farm.database is not None) if farm.keys else []
    return name, command, liars.environment(farm.calm.lying, farm.schedule.seed) if lies else {}
