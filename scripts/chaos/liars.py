"""The liar, a worker that returns wrong bytes: the program under test with an Embree that ignores some
triangles.

The liar loads the library `lying.c` of the harness instead of Embree. The program is unchanged, so the liar
represents a machine with a defective library or processor. The liar has the same numerics profile as the
other workers, and its outputs are well-formed.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from .spaces import NoNamespaces

# The names of the library with Embree's major version, in the order in which workers search for them.
LIBRARIES = (("libembree4.so.4", 4), ("libembree3.so.3", 3))
# The possible moduli of a liar. With a larger modulus, the liar ignores fewer triangles and returns fewer
# wrong tiles.
MODULI = (2, 7, 29)


def make(folder: Path) -> None:
    """Builds the library in `folder`.

    Raises NoNamespaces with the missing requirement.
    """
    if shutil.which("cc") is None:
        raise NoNamespaces("cc is not installed (scripts/setup.sh --for test)")
    known = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True,
                           check=True).stdout.splitlines()
    for name, major in LIBRARIES:
        paths = [line.split("=>")[1].strip() for line in known if line.strip().startswith(f"{name} ")]
        if paths:
            folder.mkdir(exist_ok=True)
            source = Path(__file__).parent / "lying.c"
            subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-Wall", f'-DREAL="{paths[0]}"',
                            f"-DMAJOR={major}",
                            "-o", str(folder / name), str(source), "-ldl"], check=True)
            return
    raise NoNamespaces("Embree is not installed (scripts/setup.sh)")


def environment(folder: Path, seed: int) -> dict[str, str]:
    """Returns the variables that make a worker a liar."""
    return {"LD_LIBRARY_PATH": str(folder), "LYING_MODULUS": str(MODULI[seed % len(MODULI)])}
