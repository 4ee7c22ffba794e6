#!/usr/bin/env python3
"""Writes the page that compares the papers' tables with ours: reproduction.py FOLDER PAGE.md COMMAND [quick]

FOLDER contains the measurements of scripts/reproduce.sh, one file per command. All our numbers come from
FOLDER. This script contains the papers' numbers exactly as printed. scripts/reproduction_notes.md describes
the differences, in one section for each table. COMMAND is the command line that the page shows.
"""

import json
import os
import re
import sys
from pathlib import Path

# Nirenstein and Blake 2004, Table 1 (section 7.1), which equals Nirenstein 2003, Table 3 (section 4.3.1).
# Experiment: scene, size, threshold, time per cell, cells, visible set.
PERFORMANCE = {
    1: ("Forest", "5m", "0.2", "9.23s", "512", "8.68%"),
    2: ("Forest", "2m", "0", "5.48s", "512", "14.84%"),
    3: ("Forest", "2m", "0.999", "4.17s", "512", "13.63%"),
    4: ("Durand et al.", "1.45m", "0.99", "2.57", "400", "0.79%"),
    5: ("Town", "1.35m", "0", "2.5s", "512", "1.45%"),
    6: ("Town", "1.35m", "0.999", "2.46s", "512", "1.35%"),
}
# Nirenstein and Blake 2004, Table 2 (section 7.2), which equals Nirenstein 2003, Table 4 (section 4.3.2),
# except for experiment 4: the thesis has only "-" in its row.
# Experiment: average error, maximum error, regions, average largest region, largest region.
ERRORS = {
    1: ("0.338% (886)", "6.293% (16497)", "267.27", "0.032% (84)", "0.607% (1591)"),
    2: ("0.315% (826)", "1.3% (3408)", "453.42", "0.016% (42)", "0.09% (236)"),
    3: ("0.888% (2328)", "5.88% (15414)", "605.91", "0.083% (218)", "0.66% (1730)"),
    4: ("0.561% (1471)", "1.71% (4490)", "110.23", "326.23% (326)", "0.915% (2400)"),
    5: ("0.116% (304)", "1.034% (2711)", "14.2", "0.107% (80)", "0.745% (1953)"),
    6: ("0.117% (307)", "1.034% (2711)", "14.97", "0.105% (275)", "0.745% (1953)"),
}
# Nirenstein 2003, Table 9 (section 6.3): time per cell, culling, full solution. From the text of that
# section: queries per cell, and the mean and the maximum number of effective occluders per query.
EXACT = {
    "town": ("Town", "2min 33sec", "99.45%", "3 days 15hrs", "42900", "1.7", "250"),
    "forest": ("Forest", "10min 30sec", "99.12%", "2 days 22hrs", "55000", "3.6", "472"),
}
# The scene of scripts/reproduce.sh that replaces the scene of each experiment.
OURS = {1: "forest-large", 2: "forest-small", 3: "forest-small", 4: "forest-durand", 5: "town", 6: "town"}
UNITS = {"ns": 1e-9, "µs": 1e-6, "ms": 1e-3, "s": 1.0}


def percent(fraction):
    """Formats a fraction as per cent with three digits."""
    return "0 %" if fraction <= 0 else f"{100 * fraction:#.3g} %".replace(". %", " %")


def seconds(value):
    """Formats a time with three digits, or returns "?" for None."""
    return "?" if value is None else f"{value:#.3g} s".replace(". s", " s")


def duration(value):
    """Formats a long time in days, hours, minutes or seconds."""
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        if value >= 2 * length:
            return f"{value / length:.1f} {unit}"
    return f"{value:.0f} s"


def table(header, rows):
    """Returns a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)


class Measured:
    """The files with the measurements in a folder."""

    def __init__(self, folder):
        self.folder = Path(folder)

    def json(self, name):
        """Reads a JSON file."""
        return json.loads((self.folder / f"{name}.json").read_text())

    def text(self, name):
        """Reads a text file."""
        return (self.folder / name).read_text()

    def given(self):
        """Returns the names of the scenes from the command line."""
        return sorted(p.name.removesuffix(".cubes.json") for p in self.folder.glob("given-*.cubes.json"))


def cubes_of(bake):
    """Returns the parameters of the visibility cubes of a bake."""
    return bake["info"]["spec"]["visibility"]["aggressive"]["sampling"]["cubes"]


def performance(measured, names):
    """Returns the table of times and set sizes."""
    rows = []
    for name, experiment in names:
        if experiment:
            scene, size, threshold, time, cells, seen = PERFORMANCE[experiment]
            rows.append([experiment, "paper", scene, size, cells, threshold, time, "-", seen])
        label = experiment or name.removeprefix("given-")
        for sampler in ("cubes", "lines"):
            bake = measured.json(f"{name}.{sampler}")
            cpu = bake.get("cpu_seconds")
            rows.append([
                label, sampler, OURS.get(experiment, ""), bake["triangles"], bake["cells"],
                f"{cubes_of(bake)['error_threshold']:g}" if sampler == "cubes" else "-",
                seconds(bake["seconds"] / bake["cells"]),
                seconds(cpu / bake["cells"] if cpu is not None else None),
                percent(bake["mean_visible_fraction"]),
            ])
    header = ["Exp.", "of", "Scene", "Triangles", "Cells", "Threshold", "Time/Cell", "CPU/Cell",
              "Visible Set"]
    return table(header, rows)


def errors(measured, names):
    """Returns the table of wrong pixels."""
    rows = []
    for name, experiment in names:
        if experiment:
            rows.append([experiment, "paper", *ERRORS[experiment]])
        for sampler in ("cubes", "lines"):
            found = measured.json(f"{name}.{sampler}.error")
            rows.append([
                experiment or name.removeprefix("given-"), sampler, percent(found["mean_error"]),
                percent(found["max_error"]), f"{found['mean_regions']:.2f}",
                percent(found["mean_max_region"]), percent(found["max_region"]),
            ])
    return table(["Exp.", "of", "Avg. Error", "Max. Error", "CR Count", "Avg. Max. CR", "Tot. Max. CR"], rows)


def growth(measured):
    """Returns the table of times for several numbers of cells."""
    rows = []
    for row in measured.json("growth")["growth"]:
        cpu = row["cpu_seconds"]
        rows.append([
            f"{row['cells']:.0f}", seconds(row["seconds"]), seconds(row["seconds"] / row["cells"]),
            seconds(cpu / row["cells"] if cpu is not None else None),
        ])
    return table(["Cells", "Time", "Time/Cell", "CPU/Cell"], rows)


def cells(text):
    """Parses the output of the example `cells`.

    Returns a row for each cell (seconds, sampled, visible, missed, undecided, queries), and the number of
    triangles.
    """
    number = r"(\d+)"
    pattern = (
        rf"^cell \d+: ([\d.]+)(ns|µs|ms|s); sampled {number}, visible {number}, missed {number}, .*?"
        rf"undecided {number} .*?; {number} queries"
    )
    found = [(float(m[0]) * UNITS[m[1]], *map(int, m[2:])) for m in re.findall(pattern, text, re.MULTILINE)]
    return found, int(re.search(r"^(\d+) triangles", text, re.MULTILINE)[1])


def exact(measured, names):
    """Returns the table of exact cells."""
    rows = []
    for name in names:
        found, triangles = cells(measured.text(f"{name}.cells.txt"))
        paper = EXACT.get(name)
        if paper:
            rows.append([paper[0], "thesis", "", "100", *paper[1:5], "", ""])
        mean = [sum(cell[i] for cell in found) / len(found) for i in range(6)]
        whole = measured.json(f"{name}.sampled")["cells"]
        rows.append([
            paper[0] if paper else name.removeprefix("given-"), "exact", triangles, len(found),
            seconds(mean[0]),
            percent(1 - mean[2] / triangles), f"{duration(mean[0] * whole)}, estimated", f"{mean[5]:.0f}",
            sum(cell[4] for cell in found), percent(1 - (mean[2] - mean[3]) / mean[2]) if mean[2] else "-",
        ])
    header = ["Scene", "of", "Triangles", "Cells timed", "Time/Cell", "Culling", "Full solution",
              "Queries/Cell"]
    return table([*header, "Undecided", "Missed by sampling"], rows)


def queries(measured, names):
    """Returns the table of exact queries."""
    rows = []
    for name in names:
        text = measured.text(f"{name}.pairs.txt")
        paper = EXACT.get(name)
        if paper:
            rows.append([paper[0], "thesis", "approximately 48000 queries", "-", "-", paper[5], paper[6],
                         "m^1.15"])

        def of(kind):
            """Returns the number and the mean time of the pairs of a kind."""
            match = re.search(rf"^{kind}: (\d+) pairs, mean ([\d.]+) ms", text, re.MULTILINE)
            return (int(match[1]), f"{match[2]} ms") if match else (0, "-")

        classes = [int(m) for m in re.findall(r"^\d+ to (\d+) effective occluders", text, re.MULTILINE)]
        power = re.search(r"time (m\^[\d.]+)", text)
        (visible, visible_time), (hidden, hidden_time) = of("visible"), of("hidden")
        rows.append([
            paper[0] if paper else name.removeprefix("given-"), "exact",
            f"{visible} visible, {hidden} hidden, {of('undecided')[0]} undecided", visible_time, hidden_time,
            re.search(r"^occluders (?:a|per) proof: ([\d.]+)", text, re.MULTILINE)[1],
            f"at most {max(classes)}" if classes else "-", power[1] if power else "too few pairs",
        ])
    header = ["Scene", "of", "Pairs", "Visible, mean", "Hidden, mean", "Effective occluders, mean", "most",
              "Time"]
    return table(header, rows)


def machine(measured):
    """Returns the list of facts about the machine and the run."""

    def value(path, key, separator=":"):
        """Returns the first value of a key in a file, or "unknown"."""
        try:
            lines = Path(path).read_text().splitlines()
        except OSError:
            return "unknown"
        pairs = (line.split(separator, 1) for line in lines if separator in line)
        return next((found.strip().strip('"') for name, found in pairs if name.strip() == key), "unknown")

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    lines = [
        f"processor: {value('/proc/cpuinfo', 'model name')}, {cores} cores",
        f"memory: {memory(value('/proc/meminfo', 'MemTotal'))}",
        f"system: {value('/etc/os-release', 'PRETTY_NAME', '=')}",
        f"program: {measured.text('version.txt').strip()}",
        f"numerics profile: {measured.json('exp1.lines.error')['backend']}",
        f"date: {measured.text('date.txt').strip()}",
        f"duration of the run: {duration(float(measured.text('seconds.txt')))}",
        f"other work: {others(measured)}",
    ]
    return "".join(f"- {line}\n" for line in lines)


def memory(text):
    """Formats a size of /proc/meminfo in GiB."""
    match = re.fullmatch(r"(\d+) kB", text)
    return f"{int(match[1]) / 2**20:.1f} GiB" if match else text


def others(measured):
    """Returns a sentence about the share of all cores that other processes used during the run.

    This share is the busy time of the system without the time of the script's child processes.
    """
    try:
        ticks = [[int(n) for n in measured.text(f"stat.{when}").split()[1:9]] for when in ("before", "after")]
    except (OSError, ValueError):
        return "unknown"
    delta = [b - a for a, b in zip(*ticks)]
    children = re.findall(r"(\d+)m([\d.]+)s", measured.text("times.txt").splitlines()[1])
    own = sum(60 * int(m) + float(s) for m, s in children) * os.sysconf("SC_CLK_TCK")
    busy = sum(delta) - delta[3] - delta[4]
    share = max(0.0, busy - own) / sum(delta)
    warning = "; **the machine was busy**, so times are too long, and CPU seconds slightly too high"
    text = f"other processes used {percent(share)} of the time of all cores (`/proc/stat`)"
    return text + (warning if share > 0.1 else "")


def notes():
    """Returns the sections of reproduction_notes.md by name."""
    text = (Path(__file__).parent / "reproduction_notes.md").read_text()
    parts = re.split(r"^## (.+)$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], (part.strip() for part in parts[2::2])))


def main():
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    measured, note = Measured(sys.argv[1]), notes()
    quick = sys.argv[4:] == ["quick"]
    given = measured.given()
    names = [(f"exp{i}", i) for i in range(1, 7)] + [(name, None) for name in given]
    exact_names = ["town", "forest", *given]
    commands = [line.split("\t") for line in measured.text("commands.txt").splitlines()]
    size = "scenes of the papers' sizes"
    if quick:
        size = "smaller scenes and fewer cells than the papers (`--quick`)"
    page = f"""# Experiments: the papers' tables compared with ours

`scripts/reproduce.sh` wrote this page, and its next run replaces the page. This run used
{size}.

```sh
{sys.argv[3]}
```

{machine(measured)}
{note["general"]}

## Sampling: performance

Nirenstein and Blake 2004, Table 1 (section 7.1), and Nirenstein 2003, Table 3 (section 4.3.1), have the same
numbers.

{performance(measured, names)}
{note["performance"]}

## Sampling: error

Nirenstein and Blake 2004, Table 2 (section 7.2), and Nirenstein 2003, Table 4 (section 4.3.2), have the same
numbers, except for experiment 4, whose row in the thesis contains only "-". The papers' numbers are as
printed. Numbers in parentheses are pixels.

{errors(measured, names)}
{note["error"]}

## Sampling: growth with cells

Nirenstein and Blake 2004, Figure 7, and Nirenstein 2003, Figure 21, plot the time per cell of the forest of
2m triangles against the number of cells, without numbers. Our table has the scene of experiments 2 and 3:

{growth(measured)}
{note["growth"]}

## Exact cells

Nirenstein 2003, Table 9 (section 6.3). The section's text states the numbers of queries per cell ("approx.").

{exact(measured, exact_names)}
{note["exact"]}

## Exact queries

Nirenstein 2003, section 6.3 and Figure 49. The numbers are from the text of the section, which has no table.

{queries(measured, exact_names)}
{note["queries"]}

## Not reproduced

{note["not reproduced"]}

## Commands

The commands that `scripts/reproduce.sh` ran, without folders. The name of the output precedes each command.

```
{chr(10).join(f"{name}: {line}" for name, line in commands)}
```
"""
    Path(sys.argv[2]).write_text(page)


if __name__ == "__main__":
    main()
