"""The worlds: kinds of farms with different jobs, tiles and stores, some with a liar.

To add a world, for example with other arguments of the coordinator, add an entry to `WORLDS`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from .processes import run

# The backend of all jobs and workers: the liar replaces the library of this backend (liars.py).
BACKEND = "embree"


@dataclass(frozen=True)
class World:
    """A kind of farm.

    The jobs of a world differ in one parameter, which is the seed if the sampler uses the seed.
    """

    name: str
    # The arguments of `sightline generate` for the scene.
    scene: tuple[str, ...]
    # The common parameters of the jobs. Each job has one of `variants` in addition.
    flags: tuple[str, ...]
    variants: tuple[tuple[str, str], ...]
    # The size of the disk with the data directory, in bytes.
    disk: int = 96 << 20
    # Additional arguments of the coordinator.
    coordinator: tuple[str, ...] = ()
    # The relative frequency of the world.
    weight: int = 1
    # The name of the jobs, if another world has the same jobs. Default: the name of the world.
    jobs: str = ""
    # The store: `disk` for records and blobs on the coordinator's disk, `database` for records in a database
    # that two coordinators share, or `bucket` for blobs in a bucket.
    store: str = "disk"
    # True if one worker returns wrong bytes. Then two workers compute each tile.
    liar: bool = False

    @property
    def calm(self) -> str:
        """The name of the scene and of the calm runs."""
        return self.jobs or self.name


_SEEDS = tuple(("--seed", str(seed)) for seed in range(1, 6))
# The sampler for cubes uses no random numbers, so its jobs differ in the error threshold.
_ERRORS = tuple(("--error-threshold", error) for error in ("0.1", "0.11", "0.12", "0.13", "0.14"))

# Each job takes about half a second of one core, so that a few jobs last as long as the faults.

# Blocks of sight lines, which share no data: 16 tiles.
_LINES = World("lines", ("town", "--triangles", "4000"),
               ("--cells", "4x4x2", "--block-cells", "2", "--target-error", "0.0002"), _SEEDS, weight=2)
# Faces, separators and leaves, which share samples through packs: 69 tiles.
_CUBES = World("cubes", ("rooms", "--triangles", "1000"),
               ("--sampler", "cubes", "--cells", "4x4x2", "--resolution", "48"), _ERRORS, weight=2)
# Exact cells with certificates: 8 tiles.
_EXACT = World("exact", ("rooms", "--triangles", "600"),
               ("--method", "exact", "--certificates", "--cells", "4x2x2", "--block-cells", "2"), _SEEDS)
# One block that a crew shares.
_CREW = World("crew", ("town", "--triangles", "8000"), ("--cells", "4x4x4", "--target-error", "0.0002"),
              _SEEDS, weight=2)


def _like(world: World, name: str, weight: int, store: str = "disk", liar: bool = False) -> World:
    """Returns a world with the jobs of another world."""
    checks = ("--spot-check", "1") if liar else ()
    return replace(world, name=name, weight=weight, jobs=world.calm, store=store, liar=liar,
                   coordinator=checks)


WORLDS = (
    _LINES, _CUBES, _EXACT, _CREW,
    # Two coordinators on one database.
    _like(_CUBES, "pair", 2, store="database"), _like(_LINES, "pair-lines", 1, store="database"),
    _like(_CREW, "pair-crew", 1, store="database"),
    # Blobs in an object store.
    _like(_CUBES, "bucket", 2, store="bucket"), _like(_LINES, "bucket-lines", 1, store="bucket"),
    # A worker that returns wrong bytes. In `liar-lines`, workers share blocks, and the bytes of a block do
    # not show which worker was wrong.
    _like(_CUBES, "liar", 2, liar=True), _like(_LINES, "liar-lines", 1, liar=True),
)


def named(name: str) -> World:
    """Returns the world with a name.

    Raises KeyError if no world has the name.
    """
    return {world.name: world for world in WORLDS}[name]


class Calm:
    """Scenes and calm runs: results of one process without faults. The harness creates each of them once."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program = program
        self.folder = folder

    def scene(self, world: World) -> Path:
        """Returns the file of a world's scene."""
        return self.folder / f"{world.calm}.glb"

    def result(self, world: World, variant: int) -> Path:
        """Returns the file of a calm run's result."""
        return self.folder / f"{world.calm}.{variant}.pvs"

    @property
    def database(self) -> Path:
        """The files of a new database, if a schedule needs one."""
        return self.folder / "database"

    @property
    def lying(self) -> Path:
        """The folder with the faulty Embree of a liar."""
        return self.folder / "lying"

    def flags(self, world: World, variant: int) -> list[str]:
        """Returns the parameters of a job."""
        return ["--backend", BACKEND, *world.flags, *world.variants[variant]]

    def prepare(self, world: World, variants: set[int]) -> None:
        """Creates the scene and the results of these variants, if they do not exist."""
        environment = {**os.environ, "XDG_CACHE_HOME": str(self.folder / "cache")}
        if not self.scene(world).exists():
            self._must(["generate", *world.scene, "-o", str(self.scene(world))], environment)
        for variant in sorted(variants):
            result = self.result(world, variant)
            if not result.exists():
                data = self.folder / f"data-{world.calm}-{variant}"
                self._must(["bake", str(self.scene(world)), *self.flags(world, variant), "-o", str(result),
                            "--data-dir", str(data)], environment)

    def _must(self, words: list[str], environment: dict[str, str]) -> None:
        """Runs the program. Raises RuntimeError if it fails."""
        code, out, err = run([str(self.program), *words], environment, 300.0, self.folder)
        if code != 0:
            raise RuntimeError(f"sightline {' '.join(words)} ended with exit code {code}:\n{out}{err}")
