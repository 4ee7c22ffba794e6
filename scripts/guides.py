#!/usr/bin/env python3
"""Runs the commands in README.md and in the parts Start and Guides of the documentation.

    scripts/guides.py                       run all pages
    scripts/guides.py --page docs/view.md   run one page

docs/SUMMARY.md lists the pages. The script runs the `sh` blocks of a page in one bash process, in their
order. The folder of the process contains the files of PREPARED. The commands run the program that
SIGHTLINE_BIN names. Default: target/debug/sightline. Commands that run until Ctrl-C run in the background
until the end of their page. SUBSTITUTIONS reduces the work of commands and replaces ports by free ports.

A comment `<!-- not run: REASON -->` in the line before a block excludes the block. The script lists these
blocks. The exit code is 1 if a command fails, or if a block has no language or a synonym of sh as language.
"""

import argparse
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PARTS = ("Start", "Guides")
# Folders of the repository that pages name. The script copies them into the folder of each page.
FOLDERS = ("deploy", "examples", "readers")
# The time limit of a page, in seconds.
LIMIT = 300
# Synonyms of the language sh, and the missing language. A block without a language can contain commands.
WRONG_LANGUAGES = ("", "bash", "shell", "console", "shell-session")

# Commands that create small scenes and results in place of the reader's. They contain the points of the
# pages.
TOWN = "sightline generate town --triangles 2000 -o {}.glb"
LEVEL = "sightline generate rooms --grid 6x4 --triangles 3900 -o {}.glb"
ROOM = "sightline generate rooms --grid 1x1 --triangles 300 -o {}.glb"
RESULT = "sightline bake {0}.glb -o {0}.pvs --cells 4x2x4"
# The commands, by page, that create the files that the page expects.
PREPARED = {
    "docs/view.md": [LEVEL.format("level")],
    "docs/measure.md": [ROOM.format("my_level"), RESULT.format("my_level")],
    "docs/portals.md": [LEVEL.format("level")],
    "docs/report.md": [LEVEL.format("level"), RESULT.format("level")],
    "examples/README.md": [LEVEL.format("level"), "mkdir Assets PROJECT"],
    "docs/look.md": [LEVEL.format("level"), RESULT.format("level")],
    "docs/viewpoints.md": [ROOM.format("level")],
    "docs/ambient.md": [ROOM.format("town")],
    "docs/cluster.md": [TOWN.format("my_level")],
    "docs/farm.md": [LEVEL.format("level")],
    "docs/operations.md": [TOWN.format("my_level"), TOWN.format("town")],
}

# Patterns and their replacements in each line of a block. The script does not change commands otherwise.
SUBSTITUTIONS = [
    # `bash -e` ignores the failure of a command before `&&`.
    (r" && ", "; "),
    # Smaller scenes, and fewer cells, viewpoints and texels, reduce the work.
    (r"(generate town .*)--triangles \d+", r"\1--triangles 2000"),
    (r"(sightline generate rooms)( -o)", r"\1 --triangles 500\2"),
    (r"(sightline bench \S+)", r"\1 --cells 1x1x1 --viewpoints 20 --resolution 16 --max-seconds 0.1"),
    (r"(sightline ambient \S+ -o \S+)(?!.*--to vertices)", r"\1 --resolution 128"),
    # The default address of a coordinator becomes explicit, so that the next rule replaces the port.
    (r"(sightline coordinator)(?!.*--listen)", r"\1 --listen 127.0.0.1:7600"),
    (r"\b(7600|7601)\b", lambda match: str(port(match[1]))),
    (r"(python3 -m http\.server)", lambda match: f"{match[1]} {port('8000')}"),
    # The certificates of the page are valid for farm.example and for localhost.
    (r"https://farm\.example:", "https://localhost:"),
]
# Commands that run until Ctrl-C.
FOREVER = re.compile(
    r"sightline (coordinator\b|worker(?!s)|bake .*--view\b|view (?!.* -o )|logs .*--follow\b)"
    r"|python3 -m http\.server")
# A pattern for the text that such a command prints when it is ready.
READY = r"listening on|backends:|http://|is submitted"

# Commands that bash runs before the script of a page. `background` waits until a command is ready.
PRELUDE = r"""
unset BASH_ENV  # Only the script of the page needs the prelude, and not the scripts that it runs.
background() {
  local log
  log=$(mktemp "$LOGS/XXXXXX")
  PYTHONUNBUFFERED=1 "$@" >"$log" 2>&1 &
  for _ in {1..600}; do
    if grep -qE "$READY" "$log"; then return 0; fi
    if ! kill -0 $! 2>/dev/null; then break; fi
    sleep 0.1
  done
  cat "$log"
  return 1
}
# SIGKILL, because a worker with a tile waits for its coordinator after SIGTERM.
trap 'status=$?; kill -KILL $(jobs -p) 2>/dev/null || true; wait || true; exit "$status"' EXIT
trap 'echo "$LINENO" >"$LOGS/failed"' ERR
"""
# The start of the line that marks the beginning of a block's output.
MARK = "== block in line "

ports, running = {}, []


def port(usual):
    """Returns the free port that replaces a usual port on the current page."""
    if usual not in ports:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            ports[usual] = listener.getsockname()[1]
    return ports[usual]


def read(path):
    """Returns the lines of a file of the repository."""
    with open(os.path.join(ROOT, path), encoding="utf-8") as file:
        return file.read().split("\n")


def write(text, *path):
    """Writes a file and returns its path."""
    with open(os.path.join(*path), "w", encoding="utf-8") as file:
        file.write(text)
    return file.name


def listed_pages():
    """Returns README.md and the pages of the parts PARTS in docs/SUMMARY.md."""
    found, part = ["README.md"], ""
    for line in read("docs/SUMMARY.md"):
        if line.startswith("# "):
            part = line[2:].strip()
        link = re.search(r"\]\(([^)]+\.md)\)", line)
        if link and part in PARTS:
            found.append(os.path.normpath(os.path.join("docs", link[1])))
    return found


def blocks(lines):
    """Yields each block: its language, the reason for exclusion or None, and the indices of its fences."""
    first = None
    for index, line in enumerate(lines):
        fence = re.match(r"\s*(`{3,}|~{3,})\s*([\w+-]*)", line)
        if fence and first is None:
            first, language = index, fence[2]
            reason = re.fullmatch(r"\s*<!-- not run: (.+) -->", lines[index - 1])
        elif fence and not fence[2]:
            yield language, reason and reason[1], first, index
            first = None


def command(line):
    """Returns a line of a block after the substitutions. Commands of FOREVER get the prefix `background`."""
    for pattern, replacement in SUBSTITUTIONS:
        line = re.sub(pattern, replacement, line)
    return f"background {line}" if FOREVER.match(line) else line


def run(page, program, base):
    """Runs a page. Returns the number of blocks that ran, the excluded blocks, and the failure or None."""
    lines, ran, excluded = read(page), 0, []
    ports.clear()
    # Line N of the script corresponds to line N of the page, so that bash reports the line of the page.
    script = [""] * len(lines)
    for language, reason, first, last in blocks(lines):
        if language in WRONG_LANGUAGES:
            fault = f"the block has the language “{language}”; use sh for commands, and text for output"
            return 0, [], f"{page}:{first + 1}: {fault}"
        if language == "sh" and reason:
            excluded.append(f"{page}:{first + 1}: {reason}")
        elif language == "sh":
            ran += 1
            script[first] = f"echo '{MARK}{first + 1}'"
            script[first + 1:last] = [command(line) for line in lines[first + 1:last]]
    if not ran:
        return ran, excluded, None
    work, logs = os.path.join(base, "work"), os.path.join(base, "logs")
    os.makedirs(work)
    os.makedirs(logs)
    os.makedirs(os.path.join(base, "tools"))
    # The viewer opens its page with xdg-open. This substitute does nothing, so that no browser starts.
    os.chmod(write("#!/bin/sh\n", base, "tools", "xdg-open"), 0o755)
    for folder in FOLDERS:
        built = shutil.ignore_patterns("target", "node_modules")
        shutil.copytree(os.path.join(ROOT, folder), os.path.join(work, folder), ignore=built)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SIGHTLINE_")}
    environment.update(
        PATH=os.pathsep.join([os.path.dirname(program), os.path.join(base, "tools"), os.environ["PATH"]]),
        XDG_CACHE_HOME=os.path.join(base, "cache"), LOGS=logs, READY=READY,
        SIGHTLINE_COORDINATOR=f"http://127.0.0.1:{port('7600')}")
    ended, failure = 0, None
    for part in ["\n".join(PREPARED.get(page, [])), "\n".join(script)]:
        ended, output = bash(part, base, work, environment)
        if ended == 0:
            continue
        failed = os.path.join(logs, "failed")
        _, mark, output = output.rpartition(MARK)
        # If bash did not write the number of the failed line, use the line of the last block that began.
        number = int(read(failed)[0] if os.path.exists(failed) else output.split()[0] if mark else 1)
        fault = f"still running after {LIMIT} s" if ended is None else f"exit status {ended}"
        failure = f"{page}:{number}: {fault}: {lines[number - 1]}\n"
        failure += (output.partition("\n")[2] if mark else output).rstrip()
        for log in sorted(os.listdir(logs)):
            text = read(os.path.join(logs, log))[-20:] if log != "failed" else []
            failure += "".join(f"\n  background: {line}" for line in text if line)
        break
    return ran, excluded, failure


def bash(script, base, work, environment):
    """Runs a script. Returns the exit status, or None after the time limit, and the output."""
    write(script, base, "page.sh")
    write(PRELUDE, base, "prelude.sh")
    environment = dict(environment, BASH_ENV=os.path.join(base, "prelude.sh"))
    # The output goes to a file, because processes in the background would keep a pipe open.
    with open(os.path.join(base, "output"), "w+", encoding="utf-8", errors="replace") as output:
        # In a separate session, `killpg` ends the page together with the processes that it started.
        process = subprocess.Popen(
            ["bash", "-euo", "pipefail", os.path.join(base, "page.sh")], cwd=work, env=environment,
            start_new_session=True, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)
        running.append(process)
        try:
            status = process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            status = None
        running.remove(process)
        output.seek(0)
        return status, output.read()


def stop(number, _frame):
    """Kills the current page with its processes, and ends the script."""
    for process in running:
        os.killpg(process.pid, signal.SIGKILL)
    sys.exit(128 + number)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", help="run only this page")
    arguments = parser.parse_args()
    target = os.environ.get("CARGO_TARGET_DIR", os.path.join(ROOT, "target"))
    program = os.path.abspath(os.environ.get("SIGHTLINE_BIN") or os.path.join(target, "debug", "sightline"))
    if not os.access(program, os.X_OK):
        sys.exit(f"guides: {program} does not exist; run cargo build --locked --workspace")
    pages = listed_pages()
    if arguments.page:
        if arguments.page not in pages:
            sys.exit(f"guides: {arguments.page} is not in the parts {' and '.join(PARTS)} of docs/SUMMARY.md")
        pages = [arguments.page]
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    blocks_run, not_run, failures = 0, [], []
    for page in pages:
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="sightline-guides-") as base:
            ran, excluded, failure = run(page, program, base)
        blocks_run += ran
        not_run += excluded
        failed = ": FAILED" if failure else ""
        print(f"{time.monotonic() - started:6.1f} s  {ran:2} blocks  {page}{failed}", flush=True)
        if failure:
            failures.append(page)
            print(failure, flush=True)
    for line in not_run:
        print(f"not run: {line}")
    print(f"{len(pages)} pages, {blocks_run} blocks run, {len(not_run)} blocks not run, "
          f"{len(failures)} pages failed")
    if failures:
        sys.exit(f"guides: failed: {', '.join(failures)}")


if __name__ == "__main__":
    main()
