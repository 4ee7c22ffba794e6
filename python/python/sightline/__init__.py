"""Sightline: from-region visibility of triangle scenes.

    import sightline
    pvs = sightline.bake("level.glb", cells=(16, 4, 16))   # or (vertices, faces), or a mesh of trimesh
    ids = pvs.visible((1.5, 2.0, -3.0))                    # numpy array of triangle ids, ascending
    error = sightline.measure(pvs, "level.glb")["mean_error"]
    job = sightline.Client("http://127.0.0.1:7600").submit("level.glb")

`Pvs("level.pvs")` reads a result. The package sends log messages to the logger "sightline".
"""

import os as _os
import tempfile as _tempfile

# Mesa's Vulkan drivers print a warning if the variable is not set.
_os.environ.setdefault("XDG_RUNTIME_DIR", _tempfile.gettempdir())

from ._client import Client, Job
from ._errors import CoordinatorError, Error, InputError, JobError, OptionError, Refused, SightlineError
from ._progress import Progress
from ._sightline import Pvs
from ._work import assemble, bake, cells, measure, plan, tile, unite, verify

__all__ = [
    "Client",
    "CoordinatorError",
    "Error",
    "InputError",
    "Job",
    "JobError",
    "OptionError",
    "Progress",
    "Pvs",
    "Refused",
    "SightlineError",
    "assemble",
    "bake",
    "cells",
    "measure",
    "plan",
    "tile",
    "unite",
    "verify",
]
