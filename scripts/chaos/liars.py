"""A worker that returns wrong bytes: the program under test, with a ray tracer that does not see some triangles.

Nothing in the program knows of it: the worker loads Embree from a folder of the harness (`lying.c`), as it would from a
machine whose library or processor is broken. Its profile is that of the others, and its outputs are well-formed.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from .spaces import NoNamespaces

# In the order in which workers look for them, with Embree's major version.
LIBRARIES = (("libembree4.so.4", 4), ("libembree3.so.3", 3))
# One of them is the liar's: the fewer triangles it does not see, the fewer of its tiles are wrong.
MODULI = (2, 7, 29)


def make(folder: Path) -> None:
    """Builds the library in `folder`.

    Raises NoNamespaces with what this machine lacks.
    """
    if shutil.which("cc") is None:
        raise NoNamespaces("cc is not installed (scripts/setup.sh --for test)")
    known = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=True).stdout.splitlines()
    for name, major in LIBRARIES:
        paths = [line.split("=>")[1].strip() for line in known if line.strip().startswith(f"{name} ")]
        if paths:
            folder.mkdir(exist_ok=True)
            source = Path(__file__).parent / "lying.c"
            subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-Wall", f'-DREAL="{paths[0]}"', f"-DMAJOR={major}",
                            "-o", str(folder / name), str(source), "-ldl"], check=True)
            return
    raise NoNamespaces("Embree is not installed (scripts/setup.sh)")


def environment(folder: Path, seed: int) -> dict[str, str]:
    """What makes a worker a liar."""
    return {"LD_LIBRARY_PATH": str(folder), "LYING_MODULUS": str(MODULI[seed % len(MODULI)])}
