"""Checks that the program accepts all flags in the compose files, the chart and the units.

    python arguments.py PROGRAM DEPLOY_FOLDER
"""

import pathlib
import re
import shlex
import subprocess
import sys

import helm_python as helm
import yaml

import charts

# The commands of the program that these files use.
COMMANDS = {"coordinator", "worker", "health"}


def uses(words):
    """Yields (command, flag) for each flag of a line that runs the program."""
    words = [str(word) for word in words]
    command = next((word for word in words if word in COMMANDS), None)
    if command:
        for word in words[words.index(command):]:
            if flag := re.match(r"--[a-z][a-z-]*", word):
                yield command, flag.group()


def of_compose(path):
    """Yields the flags in a compose file."""
    for service in yaml.safe_load(path.read_text())["services"].values():
        for line in (service.get("command"), service.get("healthcheck", {}).get("test")):
            # The command line of a shell is a single word of the list, so split each word.
            yield from uses(word for text in line or [] for word in str(text).split())


def of_chart(folder):
    """Yields the flags in the chart, rendered with each file of values in ci/."""
    with helm.Chart.load(folder) as chart:
        for path in sorted((folder / "ci").glob("*.yaml")):
            for document in charts.render(chart, yaml.safe_load(path.read_text()) or {}):
                if document["kind"] in ("Deployment", "StatefulSet"):
                    for container in document["spec"]["template"]["spec"]["containers"]:
                        yield from uses(container["args"])


def of_unit(path):
    """Yields the flags in a unit of systemd."""
    text = path.read_text().replace("\\\n", " ")
    for line in re.findall(r"^ExecStart=(.*)$", text, re.MULTILINE):
        yield from uses(shlex.split(line))


def main(program, folder):
    folder = pathlib.Path(folder)
    found = {}
    for path in sorted(folder.glob("compose*.yaml")):
        found[path.name] = set(of_compose(path))
    found["the chart"] = set(of_chart(folder / "helm/sightline"))
    for path in sorted((folder / "systemd").glob("*.service")):
        found[path.name] = set(of_unit(path))
    if empty := [name for name, flags in found.items() if not flags]:
        sys.exit(f"arguments: found no flags in {empty}")
    known = {}
    for command in COMMANDS:
        told = subprocess.run([program, command, "--help"], capture_output=True, text=True, check=True).stdout
        known[command] = set(re.findall(r"--[a-z][a-z-]*", told))
    unknown = {
        name: sorted(f"{command} {flag}" for command, flag in flags if flag not in known[command])
        for name, flags in found.items()
    }
    if unknown := {name: flags for name, flags in unknown.items() if flags}:
        sys.exit(f"arguments: {program} does not accept these flags: {unknown}")
    print(f"arguments: the program accepts all {len(set().union(*found.values()))} flags")


if __name__ == "__main__":
    main(*sys.argv[1:])
