"""What the tests share: the program under test, meshes, and results compared cell by cell."""

import json
import os
import subprocess

import numpy as np
import pytest

#: Six rooms with doors between them.
ROOMS = "generate rooms --grid 3x2 --triangles 1500 -o rooms.glb"


class Program:
    """Runs the `sightline` command in a folder."""

    def __init__(self, folder):
        self.folder = folder
        self.binary = os.environ["SIGHTLINE_BIN"]
        self.env = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}

    def path(self, name):
        return str(self.folder / name)

    def __call__(self, line):
        done = subprocess.run(
            [self.binary, *line.split()], cwd=self.folder, env=self.env, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, f"sightline {line}: {done.stderr}"
        return done.stdout

    def json(self, line):
        return json.loads(self(line + " --json"))

    def sets(self, result):
        cells = [json.loads(line) for line in self(f"dump {result}").splitlines()[1:]]
        return [cell["visible"] for cell in cells]


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    program = Program(tmp_path_factory.mktemp("sightline"))
    program(ROOMS)
    return program


@pytest.fixture(scope="session")
def baked(program):
    """What the command makes of the rooms."""
    program("bake rooms.glb -o rooms.pvs --cells 4x2x3 --backend cpu")
    return program.path("rooms.pvs")


def boxes(places, size=1.0):
    """Vertices and triangles of cubes with these middles."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
        + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )
    places = np.asarray(places, dtype=float)
    vertices = (places[:, None] + size * corner).reshape(-1, 3)
    return vertices, (8 * np.arange(len(places))[:, None, None] + faces).reshape(-1, 3)


def sets(pvs):
    return [pvs.visible(cell).tolist() for cell in range(len(pvs))]
