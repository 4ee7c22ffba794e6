#!/usr/bin/env python3
"""Compares bakes of objects with bakes of triangles: objects.py SCENE.glb... [-- OPTIONS OF BAKE]

The bake of triangles gives a set of objects for each cell: the objects of the visible triangles. For each
scene, the script prints a row with the following columns:

    missed     the share of these objects that are missing from the bake of objects
    by chance  the share of these objects that are missing from a bake of triangles with another seed
    added      the share of the objects of the bake of objects that are missing from the bake of triangles
    time       the time of the bake of objects, divided by the time of the bake of triangles
    bytes      the size of its result, divided by the size of the result of the bake of triangles

The variable SIGHTLINE names the program. Default: `sightline` on the PATH.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

PROGRAM = os.environ.get("SIGHTLINE", "sightline")


def bake(scene: str, folder: str, name: str, options: list[str]) -> tuple[list[set[int]], float, int]:
    """Bakes a scene. Returns the set of objects of each cell, the time in seconds and the size in bytes."""
    out, store = os.path.join(folder, f"{name}.pvs"), os.path.join(folder, name)
    begun = time.monotonic()
    subprocess.run(
        [PROGRAM, "bake", scene, "-o", out, "--data-dir", store, *options],
        check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    seconds = time.monotonic() - begun
    text = subprocess.run([PROGRAM, "dump", out, "--items", "objects"], check=True,
                          capture_output=True).stdout
    cells = [json.loads(line) for line in text.splitlines()]
    return [set(cell["visible"]) for cell in cells if "visible" in cell], seconds, os.path.getsize(out)


def lacks(sets: list[set[int]], of: list[set[int]]) -> float:
    """Returns the share of the objects in `of` that are missing from `sets`."""
    return sum(len(b - a) for a, b in zip(sets, of, strict=True)) / max(sum(map(len, of)), 1)


def main() -> None:
    scenes, options = sys.argv[1:], []
    if "--" in scenes:
        at = scenes.index("--")
        scenes, options = scenes[:at], scenes[at + 1 :]
    if not scenes:
        sys.exit(__doc__)
    print("| scene | missed | by chance | added | time | bytes |\n|---|--:|--:|--:|--:|--:|", flush=True)
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            whole, slow, large = bake(scene, folder, "triangles", options)
            other, _, _ = bake(scene, folder, "other", [*options, "--seed", "2"])
            objects, fast, small = bake(scene, folder, "objects", [*options, "--granularity", "objects"])
        shares = [lacks(objects, whole), lacks(other, whole), lacks(whole, objects)]
        name = os.path.basename(scene).removesuffix(".glb")
        print(
            f"| {name} | {' | '.join(f'{100 * s:.2f} %' for s in shares)} | {fast / slow:.2f} "
            f"| {small / large:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
