"""The annotations are complete, and the stubs of the native part are those of what it has."""

import pathlib
import re
import subprocess
import sys

from sightline import _options

FOLDER = pathlib.Path(__file__).parent.parent


def test_the_package_is_typed(tmp_path):
    use = tmp_path / "use.py"
    use.write_text(
        "import numpy as np\nimport sightline\n"
        "pvs = sightline.bake('a.glb', cells=(4, 4, 4), max_error=0.01, progress=print)\n"
        "ids: 'np.typing.NDArray[np.uint32]' = pvs.visible((1.0, 2.0, 3.0))\n"
        "job: sightline.Job = sightline.Client().submit((np.eye(3), [[0, 1, 2]]), seed=3).wait()\n"
    )
    config = ["--config-file", str(FOLDER / "pyproject.toml"), "--cache-dir", str(tmp_path)]
    mypy = [sys.executable, "-m", "mypy", *config]
    for more in (["-p", "sightline"], [str(use)]):
        done = subprocess.run([*mypy, *more], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    use.write_text("import sightline\nsightline.bake('a.glb', cell=3)\n")
    assert subprocess.run([*mypy, str(use)], cwd=tmp_path, capture_output=True).returncode == 1


def test_the_stubs_are_those_of_the_native_part():
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "sightline._sightline", "--ignore-disjoint-bases"],
        capture_output=True, text=True, cwd="/",
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_option_of_the_command_has_a_type(program):
    flags = set(re.findall(r"^ +(?:-\w, )?--([a-z-]+)", program("bake --help"), re.M))
    assert {"cells", "max-error", "see-through", "no-solids"} <= flags
    # Parameters of `bake` beside its options, and what belongs to a command.
    others = {"output", "from", "data-dir", "workers", "view", "json", "help", "version"}
    known = {name.replace("_", "-") for name in _options.JobOptions.__annotations__}
    assert known == flags - others
    assert {name for name in _options.JobOptions.__annotations__} <= set(_options._CONVERT)
