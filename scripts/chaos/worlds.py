"""The worlds: which jobs a farm does, how it is cut into tiles, and on which store.

A world with another store or other engines is one more entry of `WORLDS`, with its arguments in `coordinator`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
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


_SEEDS = tuple(("--seed", str(seed)) for seed in range(1, 6))
# Cubes use no random numbers.
_ERRORS = tuple(("--error-threshold", error) for error in ("0.1", "0.11", "0.12", "0.13", "0.14"))

# Jobs of about half a second of a core, so that a few of them fill the time of the faults.
WORLDS = (
    # Blocks of sight lines, which share nothing: 16 tiles.
    World("lines", ("town", "--triangles", "4000"),
          ("--cells", "4x4x2", "--block-cells", "2", "--target-error", "0.0002"), _SEEDS, weight=2),
    # Faces, separators and leaves, which share samples through packs: 69 tiles.
    World("cubes", ("rooms", "--triangles", "1000"),
          ("--sampler", "cubes", "--cells", "4x4x2", "--resolution", "48"), _ERRORS, weight=2),
    # Exact cells with certificates: 8 tiles.
    World("exact", ("rooms", "--triangles", "600"),
          ("--method", "exact", "--certificates", "--cells", "4x2x2", "--block-cells", "2"), _SEEDS),
    # One block that a crew shares.
    World("crew", ("town", "--triangles", "8000"), ("--cells", "4x4x4", "--target-error", "0.0002"), _SEEDS, weight=2),
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
        return self.folder / f"{world.name}.glb"

    def result(self, world: World, variant: int) -> Path:
        return self.folder / f"{world.name}.{variant}.pvs"

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
                data = self.folder / f"data-{world.name}-{variant}"
                self._must(["bake", str(self.scene(world)), *self.flags(world, variant), "-o", str(result),
                            "--data-dir", str(data)], environment)

    def _must(self, words: list[str], environment: dict[str, str]) -> None:
        code, out, err = run([str(self.program), *words], environment, 300.0, self.folder)
        if code != 0:
            raise RuntimeError(f"sightline {' '.join(words)} ended with {code}:\n{out}{err}")
