#!/usr/bin/env python3
"""Measures the CPU time that clients of the dashboard cost a coordinator.

    scripts/watchers.py path/to/sightline

The script measures the coordinator's process for half a minute while a worker computes a job: first without
clients, then with ten clients that receive the events of the job and of the workers. It runs only on Linux,
because it reads /proc.
"""
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

SECONDS = 30
WATCHERS = 10


def cpu(pid):
    """Returns the user and system time of a process, in seconds."""
    fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def watch(url, stop, heard):
    with urllib.request.urlopen(url) as stream:
        while not stop.is_set():
            heard[0] += len(stream.readline())


def main():
    program = os.path.abspath(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        run = lambda *args: subprocess.run(
            [program, *args], cwd=folder, check=True, capture_output=True, text=True).stdout
        run("generate", "town", "--triangles", "60000", "-o", "town.glb")
        coordinator = subprocess.Popen(
            [program, "coordinator", "--data-dir", "data", "--listen", "127.0.0.1:0", "--http",
             "127.0.0.1:0"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        url = coordinator.stdout.readline().split()[-1]
        pages = coordinator.stdout.readline().split()[-1]
        worker = subprocess.Popen(
            [program, "worker", "--coordinator", url, "--backend", "cpu", "--threads", "1"], cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            job = run("submit", "town.glb", "--cells", "64x8x64", "--block-cells", "8", "--backend", "cpu",
                      "--coordinator", url).strip()
            time.sleep(3)
            before = cpu(coordinator.pid)
            time.sleep(SECONDS)
            alone = cpu(coordinator.pid) - before
            stop, heard = threading.Event(), [0]
            address = f"{pages}live?job={job}&workers=true"
            for _ in range(WATCHERS):
                threading.Thread(target=watch, args=(address, stop, heard), daemon=True).start()
            time.sleep(1)
            before = cpu(coordinator.pid)
            time.sleep(SECONDS)
            watched = cpu(coordinator.pid) - before
            stop.set()
            print(f"CPU time of the coordinator in {SECONDS} s: {alone:.2f} s without clients of the "
                  f"dashboard, {watched:.2f} s with {WATCHERS}")
            print(f"{WATCHERS} clients cost {100 * (watched - alone) / SECONDS:.2f} % of a core and received "
                  f"{heard[0]} bytes")
        finally:
            worker.kill()
            coordinator.kill()
            worker.wait()
            coordinator.wait()


main()
