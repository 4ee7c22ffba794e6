#!/usr/bin/env python3
"""Measures the cost of encryption and the cost of metrics for a bake on a farm.

    scripts/farm_cost.py [--program target/release/sightline] [--rounds 7] [--triangles 60000] [--error 0.001]

A farm is a coordinator and two single-threaded workers on this machine. Each round bakes the same town on a
plain farm, on a farm with TLS, client certificates for workers and tokens for users, and on a farm whose
metrics the script reads every second. The script prints medians of the wall-clock time and of the processor
time of all processes, as ratios to the plain farm of the same round. It needs openssl for the certificates.
"""

import argparse
import os
import pathlib
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parent.parent
KINDS = ("plain", "encrypted", "metrics")


class Farm:
    """A coordinator and two workers, which run inside a `with` block, and their processor time."""

    def __init__(self, program, folder, kind):
        self.program, self.folder, self.kind = program, folder, kind
        self.children, self.seconds, self.reading = [], 0.0, threading.Event()

    def start(self, *arguments, log):
        out = open(self.folder / f"{log}.out", "w")
        err = open(self.folder / f"{log}.err", "w")
        child = subprocess.Popen([self.program, *arguments], stdout=out, stderr=err, cwd=self.folder)
        self.children.append(child)
        return self.folder / f"{log}.out"

    def line(self, path, begins):
        """Waits for the first line that begins with a text, and returns the rest of the line."""
        until = time.monotonic() + 30
        while time.monotonic() < until:
            for line in path.read_text().splitlines():
                if line.startswith(begins):
                    return line[len(begins):].strip()
            time.sleep(0.02)
        log = path.with_suffix(".err").read_text()
        sys.exit(f"{path} contains no line that begins with '{begins}':\n{log}")

    def read(self, address):
        while not self.reading.wait(1.0):
            urllib.request.urlopen(address, timeout=5).read()

    def __enter__(self):
        arguments = ["--listen", "127.0.0.1:0", "--data-dir", "data"]
        if self.kind == "encrypted":
            pki = ["--tls-cert", "pki/coordinator.pem", "--tls-key", "pki/coordinator.key"]
            arguments += [*pki, "--client-ca", "pki/ca.pem", "--tokens", "tokens.json"]
        if self.kind == "metrics":
            arguments += ["--metrics-listen", "127.0.0.1:0"]
        said = self.start("coordinator", *arguments, log="coordinator")
        url = self.line(said, "listening on ")
        # The certificate is valid for the name localhost.
        url = url.replace("127.0.0.1", "localhost") if self.kind == "encrypted" else url
        addresses = [self.line(said, "metrics on ")] if self.kind == "metrics" else []
        self.client = ["--coordinator", url]
        worker = ["--coordinator", url, "--backend", "cpu", "--threads", "1"]
        if self.kind == "encrypted":
            self.client += ["--ca", "pki/ca.pem", "--token-file", "client.token"]
            worker += ["--ca", "pki/ca.pem", "--cert", "pki/worker.pem", "--key", "pki/worker.key"]
        if self.kind == "metrics":
            worker += ["--metrics-listen", "127.0.0.1:0"]
        for name in ("one", "two"):
            said = self.start("worker", *worker, "--name", name, log=name)
            if self.kind == "metrics":
                addresses.append(self.line(said, "metrics on "))
        for address in addresses:
            threading.Thread(target=self.read, args=(address,), daemon=True).start()
        return self

    def run(self, *arguments):
        """Runs a client, adds its processor time, and returns its output."""
        with open(self.folder / "client.out", "w+") as out, open(self.folder / "client.err", "w+") as err:
            child = subprocess.Popen(
                [self.program, *arguments, *self.client], stdout=out, stderr=err, cwd=self.folder
            )
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            self.seconds += usage.ru_utime + usage.ru_stime
            out.seek(0)
            err.seek(0)
            if child.returncode != 0:
                sys.exit(f"{' '.join(arguments)} ended with exit code {child.returncode}:\n{err.read()}")
            return out.read()

    def __exit__(self, *_):
        self.reading.set()
        for child in reversed(self.children):
            child.send_signal(signal.SIGTERM)
        for child in reversed(self.children):
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            self.seconds += usage.ru_utime + usage.ru_stime


def bake(program, folder, kind, options):
    """Bakes on a new farm.

    Returns the wall-clock seconds, the processor seconds and the bytes of the result.
    """
    shutil.rmtree(folder / "data", ignore_errors=True)
    with Farm(program, folder, kind) as farm:
        began = time.monotonic()
        job = farm.run("submit", "town.glb", *options).strip()
        farm.run("watch", job)
        farm.run("fetch", job, "-o", "town.pvs")
        wall = time.monotonic() - began
    return wall, farm.seconds, (folder / "town.pvs").read_bytes()


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=ROOT / "target/release/sightline", type=pathlib.Path)
    parser.add_argument("--rounds", default=7, type=int)
    parser.add_argument("--triangles", default=60000, type=int)
    parser.add_argument("--error", default="0.001")
    arguments = parser.parse_args()
    program = arguments.program.resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        os.environ.setdefault("XDG_RUNTIME_DIR", str(folder))
        quiet = {"cwd": folder, "check": True, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        subprocess.run([ROOT / "deploy/certificates.sh", "pki", "localhost"], **quiet)
        town = ["generate", "town", "-o", "town.glb", "--triangles", str(arguments.triangles)]
        subprocess.run([program, *town], **quiet)
        token = [program, "token", "new", "--user", "client", "--scope", "submit", "--tokens", "tokens.json"]
        said = subprocess.run(token, cwd=folder, check=True, capture_output=True, text=True)
        (folder / "client.token").write_text(said.stdout)
        options = ["--cells", "8x4x8", "--block-cells", "16", "--target-error", arguments.error]
        ratios = {kind: [] for kind in KINDS[1:]}
        for number in range(arguments.rounds):
            # The order changes each round, so that slow changes of the machine affect all kinds equally.
            order = KINDS[number % 3:] + KINDS[: number % 3]
            took = {kind: bake(program, folder, kind, options) for kind in order}
            wall, seconds, bytes_ = took["plain"]
            for kind in KINDS[1:]:
                if took[kind][2] != bytes_:
                    sys.exit(f"the result of the farm '{kind}' differs from the result of the plain farm")
                ratios[kind].append((took[kind][0] / wall, took[kind][1] / seconds))
            print(f"round {number + 1}: plain wall {wall:.2f} s, processor {seconds:.2f} s", file=sys.stderr)
        print(f"{arguments.rounds} rounds, {arguments.triangles} triangles, target error {arguments.error}")
        for kind, pairs in ratios.items():
            walls, seconds = zip(*pairs)
            spread = f"{min(seconds):.3f} to {max(seconds):.3f}"
            wall, processor = statistics.median(walls), statistics.median(seconds)
            print(f"{kind}: wall {wall:.3f}, processor {processor:.3f} ({spread})")


if __name__ == "__main__":
    main()
