#!/usr/bin/env python3
"""Runs the integration tests of the workspace, several test programs at once.

    scripts/run_tests.py [--jobs N] [--skip TEXT]...

cargo runs one test program after the other, and most test programs wait for processes that they started. This
script builds the test programs with cargo and runs N at a time. Default: the number of processors. It runs
each program of ALONE without other programs. If a test fails, the script prints the output of the test's
program. --skip excludes the tests whose names contain TEXT.
"""

import argparse
import concurrent.futures
import json
import os
import signal
import subprocess
import sys
import time

# Programs that measure response times, which other programs would affect.
ALONE = {"hostile"}
# The slowest programs. They begin first, so that the script does not wait for one of them at the end.
FIRST = ["chaos", "cluster", "direct", "objects", "bake", "portals", "sights", "replicas"]
# The time limit of a program, in seconds.
LIMIT = 1200
# The processes of the running programs.
RUNNING = set()


def programs():
    """Builds the test programs. Returns the name, the file and the folder of the package of each program."""
    command = ["cargo", "test", "--locked", "--workspace", "--test", "*", "--no-run"]
    command += ["--message-format=json-render-diagnostics"]
    built = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if built.returncode != 0:
        sys.exit(built.returncode)
    found = []
    for line in built.stdout.splitlines():
        message = json.loads(line)
        target = message.get("target", {})
        if message["reason"] == "compiler-artifact" and "test" in target["kind"] and message["executable"]:
            folder = os.path.dirname(message["manifest_path"])
            found.append((target["name"], message["executable"], folder))
    return found


def run(program, skip):
    """Runs a test program.

    Returns its name, the time in seconds, the failure or an empty text, and the output.
    """
    name, file, folder = program
    arguments = [argument for text in skip for argument in ("--skip", text)]
    started = time.monotonic()
    environment = dict(os.environ, CARGO_MANIFEST_DIR=folder)
    # In a separate session, `killpg` ends the program together with the processes that it started.
    started_program = subprocess.Popen(
        [file, *arguments], cwd=folder, env=environment, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )
    RUNNING.add(started_program)
    try:
        output, _ = started_program.communicate(timeout=LIMIT)
        failure = "" if started_program.returncode == 0 else f"exit status {started_program.returncode}"
    except subprocess.TimeoutExpired:
        os.killpg(started_program.pid, signal.SIGKILL)
        output, _ = started_program.communicate()
        failure = f"still running after {LIMIT} s"
    RUNNING.discard(started_program)
    return name, time.monotonic() - started, failure, output.decode(errors="replace")


def stop(number, _frame):
    """Kills the running programs with their processes, and ends the script."""
    for program in list(RUNNING):
        os.killpg(program.pid, signal.SIGKILL)
    os._exit(128 + number)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--skip", action="append", default=[])
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    order = {name: place for place, name in enumerate(FIRST)}
    found = sorted(programs(), key=lambda program: (order.get(program[0], len(FIRST)), program[0]))
    if not found:
        sys.exit("run_tests: cargo built no test programs")
    together = [program for program in found if program[0] not in ALONE]
    alone = [program for program in found if program[0] in ALONE]
    took, failed = [], []

    def note(ended):
        name, seconds, failure, output = ended
        took.append((seconds, name))
        print(f"{seconds:7.1f} s  {name}{': FAILED, ' + failure if failure else ''}", flush=True)
        if failure:
            failed.append(name)
            print(output, flush=True)

    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        running = [pool.submit(run, program, arguments.skip) for program in together]
        for one in concurrent.futures.as_completed(running):
            note(one.result())
    for program in alone:
        note(run(program, arguments.skip))
    slowest = ", ".join(f"{name} {seconds:.0f} s" for seconds, name in sorted(took, reverse=True)[:8])
    print(f"{len(took)} test programs, {len(failed)} failed; the slowest: {slowest}")
    if failed:
        sys.exit(f"run_tests: failed: {', '.join(sorted(failed))}")


if __name__ == "__main__":
    main()
