#!/usr/bin/env python3
"""Compares the time and memory of two builds of `sightline` for bakes, ambient occlusion and point queries.

    scripts/compare.py OLD NEW LEVEL [--runs N]

OLD and NEW are the programs. LEVEL is an indoor level as glTF; docs/experiments/rebuild.md uses quake_e1m3
(benches/README.md). The script runs OLD and NEW alternately, each with an empty cache. The first pair of runs
does not count. N is the number of counted pairs. Default: 5. For each case, the table contains the median of
the ratios NEW to OLD of the pairs, the smallest and the largest ratio, and the medians of the peak memory.
"""

import argparse
import json
import os
import pathlib
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

BAKES = {
    "lines": ["--cells", "16x8x16", "--target-error", "0.001"],
    "cubes": ["--sampler", "cubes", "--cells", "2x1x2", "--error-threshold", "0.05"],
    "portals": ["--method", "portals", "--cells", "4x2x4", "--reachable-from=1344,1096,636"],
}


def run(program, arguments, cache):
    """Runs a program with an empty cache. Returns the CPU seconds, wall seconds and peak memory in MiB."""
    shutil.rmtree(cache, ignore_errors=True)
    cache.mkdir()
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "XDG_RUNTIME_DIR": str(cache)}
    began = time.monotonic()
    child = subprocess.Popen(
        [program, *arguments], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=cache
    )
    errors = child.stderr.read()
    _, status, usage = os.wait4(child.pid, 0)
    wall = time.monotonic() - began
    if status != 0:
        sys.exit(f"compare: {program} {' '.join(arguments)} failed:\n{errors.decode(errors='replace')}")
    return usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024


def cases(program, level, work):
    """Yields the name and the arguments of each case. `program` generates the scenes."""
    for name, options in BAKES.items():
        yield name, ["bake", level, *options, "-o", "out.pvs"]
    rooms, tets = work / "rooms.glb", work / "rooms.tets"
    subprocess.run([program, "generate", "rooms", "-o", rooms], check=True, capture_output=True)
    yield "exact", ["bake", str(rooms), "--method", "exact", "--cells", "2x1x2", "-o", "out.pvs"]
    yield "ambient", ["ambient", str(rooms), "--points",
                      points(work / "ambient.jsonl", 3000, {"normal": [0, 1, 0]})]
    subprocess.run([program, "tetra", rooms, "-o", tets], check=True, capture_output=True)
    yield "look", ["look", str(tets), "--points", points(work / "look.jsonl", 200, {})]


def points(file, count, fields):
    """Writes random points in the rooms, with additional fields, as JSON Lines.

    Returns the name of the file.
    """
    draw = random.Random(1)
    drawn = ([draw.uniform(0.5, 29.5), 1.6, draw.uniform(0.5, 19.5)] for _ in range(count))
    file.write_text("".join(json.dumps({"point": point, **fields}) + "\n" for point in drawn))
    return str(file)


def main():
    """Parses the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("level")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    programs = [str(pathlib.Path(program).resolve(strict=True)) for program in (options.old, options.new)]
    level = str(pathlib.Path(options.level).resolve(strict=True))
    print("| case | CPU | wall | peak memory, old → new |\n|---|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        for name, arguments in cases(programs[0], level, work):
            pairs = []
            for count in range(options.runs + 1):
                pair = [run(program, arguments, work / "cache") for program in programs]
                if count > 0:
                    pairs.append(pair)
            cells = [name]
            for kind in range(2):
                ratios = [new[kind] / old[kind] for old, new in pairs]
                cells.append(f"{statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})")
            memory = [statistics.median(pair[side][2] for pair in pairs) for side in range(2)]
            cells.append(f"{memory[0]:.0f} → {memory[1]:.0f} MiB")
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
