"""The worlds: which jobs a farm does, how it is cut into tiles, on which store, and whether a worker lies.

A world with other engines is one more entry of `WORLDS`, with its arguments in `coordinator`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from .processes import run


@dataclass(frozen=True)
class World:
    """A kind of farm. The jobs of a world differ in their seed or, where a seed changes nothing, in another parameter."""

    name: str
    # What `sightline generate` makes the scene from.
    scene: tuple[str, ...]
    # The parameters of its jobs; the last of them is one of `variants`.
    flags: tuple[str, ...]
    variants: tuple[tuple[str, str], ...]
    # Bytes of the disk on which the data directory lies.
    disk: int = 96 << 20
    # More arguments of the coordinator.
    coordinator: tuple[str, ...] = ()
    # How often it is drawn, in comparison with the others.
    weight: int = 1
    # What its jobs are called, which are those of every world with the same; its name when empty.
    jobs: str = ""
    # Where records and blobs are: on the coordinator's disk, records in a `database` that two coordinators share, or
    # blobs in a `bucket`.
    store: str = "disk"
    # Whether a worker returns wrong bytes, so that each tile is computed by two.
    liar: bool = False

    @property
    def calm(self) -> str:
        """The name of its scene and its calm runs."""
        return self.jobs or self.name


_SEEDS = tuple(("--seed", str(seed)) for seed in range(1, 6))
# Cubes use no random numbers.
_ERRORS = tuple(("--error-threshold", error) for error in ("0.1", "0.11", "0.12", "0.13", "0.14"))

# Jobs of about half a second of a core, so that a few of them fill the time of the faults.
# Blocks of sight lines, which share nothing: 16 tiles.
_LINES = World("lines", ("town", "--triangles", "4000"),
               ("--cells", "4x4x2", "--block-cells", "2", "--target-error", "0.0002"), _SEEDS, weight=2)
# Faces, separators and leaves, which share samples through packs: 69 tiles.
_CUBES = World("cubes", ("rooms", "--triangles", "1000"),
               ("--sampler", "cubes", "--cells", "4x4x2", "--resolution", "48"), _ERRORS, weight=2)
# Exact cells with certificates: 8 tiles.
_EXACT = World("exact", ("rooms", "--triangles", "600"),
               ("--method", "exact", "--certificates", "--cells", "4x2x2", "--block-cells", "2"), _SEEDS)
# One block that a crew shares.
_CREW = World("crew", ("town", "--triangles", "8000"), ("--cells", "4x4x4", "--target-error", "0.0002"), _SEEDS, weight=2)


def _like(world: World, name: str, weight: int, store: str = "disk", liar: bool = False) -> World:
    """A world with the jobs of another one."""
    checks = ("--spot-check", "1") if liar else ()
    return replace(world, name=name, weight=weight, jobs=world.calm, store=store, liar=liar, coordinator=checks)


WORLDS = (
    _LINES, _CUBES, _EXACT, _CREW,
    # Two coordinators on one database.
    _like(_CUBES, "pair", 2, store="database"), _like(_LINES, "pair-lines", 1, store="database"),
    _like(_CREW, "pair-crew", 1, store="database"),
    # Blobs in an object store.
    _like(_CUBES, "bucket", 2, store="bucket"), _like(_LINES, "bucket-lines", 1, store="bucket"),
    # A worker that returns wrong bytes. Of a block that a crew shared nobody can say who of them was wrong.
    _like(_CUBES, "liar", 2, liar=True), _like(_LINES, "liar-lines", 1, liar=True),
)


def named(name: str) -> World:
    """The world of a name.

    Raises KeyError when there is none.
    """
    return {world.name: world for world in WORLDS}[name]


class Calm:
    """The scenes and the results of calm runs, by one process without faults, made once."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program = program
        self.folder = folder

    def scene(self, world: World) -> Path:
        return self.folder / f"{world.calm}.glb"

    def result(self, world: World, variant: int) -> Path:
        return self.folder / f"{world.calm}.{variant}.pvs"

    @property
    def database(self) -> Path:
        """The files of a new database, where a schedule needs them."""
        return self.folder / "database"

    @property
    def lying(self) -> Path:
        """The library of a liar."""
        return self.folder / "lying"

    def flags(self, world: World, variant: int) -> list[str]:
        """The parameters of a job."""
        return ["--backend", "cpu", *world.flags, *world.variants[variant]]

    def prepare(self, world: World, variants: set[int]) -> None:
        """Makes the scene, and the results of these variants, as far as they are missing."""
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
        code, out, err = run([str(self.program), *words], environment, 300.0, self.folder)
        if code != 0:
            raise RuntimeError(f"sightline {' '.join(words)} ended with {code}:\n{out}{err}")
