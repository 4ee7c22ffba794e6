"""Options as keyword arguments, turned into the flags of the command line, which decides what they mean."""

from __future__ import annotations

import difflib
import os
import shutil
import tempfile
from contextlib import contextmanager
from typing import Any, Callable, Dict, Iterable, Iterator, List, Sequence, Tuple, TypedDict, Union

import numpy as np

from . import _mesh
from ._errors import OptionError

Numbers = Sequence[float]
Globs = Union[str, Sequence[str]]
Path = Union[str, "os.PathLike[str]"]


class KindOptions(TypedDict, total=False):
    """What blocks and what shows, by globs over names of objects and materials. Of several that match a name
    the last one counts."""

    see_through: Globs
    occluder_only: Globs
    moving: Globs
    doors: Globs
    opaque: Union[bool, Globs]
    alpha_textures: bool
    cull_back_faces: bool


class JobOptions(KindOptions, total=False):
    """What to bake, and how: the options of `sightline bake`, with `_` for `-`."""

    method: str
    certificates: bool
    cells: Union[int, str, Sequence[int]]
    cell_size: float
    triangle_budget: int
    max_depth: int
    sampler: str
    target_error: float
    max_error: float
    time_budget: Union[float, str]
    block_cells: int
    rays: int
    granularity: str
    min_share: float
    contributions: bool
    far: float
    cell_to_cell: str
    view_box: Union[Numbers, Sequence[Numbers]]
    view_mesh: Path
    eye_heights: Tuple[float, float]
    viewpoints: Union[Path, Sequence[Numbers]]
    reach: float
    reachable_from: Union[Numbers, Sequence[Numbers]]
    up: str
    resolution: int
    error_threshold: float
    interior_threshold: float
    error_measure: str
    min_distance: float
    no_solids: bool
    superset: str
    backend: str
    seed: int
    traces: str
    traces_ca: Path


#: Turns a value into the texts of the flags; each text is a flag of its own. None is a flag without a value.
Texts = Callable[[Any, str], Iterable[Union[str, None]]]


def _whole(value: Any, folder: str) -> Iterable[str]:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"it is a whole number, and not {value!r}")
    return [str(int(value))]


def _number(value: Any, folder: str) -> Iterable[str]:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"it is a number, and not {value!r}")
    return [repr(float(value))]


def _word(value: Any, folder: str) -> Iterable[str]:
    if not isinstance(value, str):
        raise TypeError(f"it is a text, and not {value!r}")
    return [value]


def _path(value: Any, folder: str) -> Iterable[str]:
    return [os.fsdecode(os.fspath(value))]


def _switch(value: Any, folder: str) -> Iterable[None]:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"it is True or False, and not {value!r}")
    return [None] if value else []


def _globs(value: Any, folder: str) -> Iterable[Union[str, None]]:
    if isinstance(value, bool):
        return ["*"] if value else []
    return [word for one in ([value] if isinstance(value, str) else value) for word in _word(one, folder)]


def _duration(value: Any, folder: str) -> Iterable[str]:
    return [value] if isinstance(value, str) else _number(value, folder)


def _cells(value: Any, folder: str) -> Iterable[str]:
    if isinstance(value, str):
        return [value]
    of = [value] * 3 if isinstance(value, (int, np.integer)) else list(value)
    if len(of) != 3:
        raise ValueError(f"it is one number or three, as in (8, 8, 8), and not {value!r}")
    return ["x".join(text for n in of for text in _whole(n, folder))]


def _rows(columns: int) -> Texts:
    """Rows of numbers, or a single one; each row is a flag."""

    def texts(value: Any, folder: str) -> Iterable[str]:
        rows = np.asarray(value, dtype=np.float64)
        # A box is also its least and its greatest corner.
        if columns == 6 and rows.shape == (2, 3):
            rows = rows.reshape(1, 6)
        if rows.ndim == 1:
            rows = rows[None]
        if rows.ndim == 3 and columns == 6:
            rows = rows.reshape(len(rows), -1)
        if rows.ndim != 2 or rows.shape[1] != columns or len(rows) == 0:
            raise ValueError(f"it is {columns} numbers, or rows of them, and not of the shape {np.shape(value)}")
        return [",".join(repr(float(x)) for x in row) for row in rows]

    return texts


def _viewpoints(value: Any, folder: str) -> Iterable[str]:
    """A file of viewpoints; an array becomes one."""
    if isinstance(value, (str, os.PathLike)):
        return _path(value, folder)
    file = os.path.join(folder, "viewpoints.txt")
    np.savetxt(file, _mesh.points("viewpoints", value, (3, 4)), fmt="%.17g")
    return [file]


_TEXTS: Dict[str, Texts] = {
    **dict.fromkeys(
        ("certificates", "contributions", "no_solids", "alpha_textures", "cull_back_faces", "all", "dry_run", "exact"),
        _switch,
    ),
    **dict.fromkeys(("see_through", "occluder_only", "moving", "doors", "opaque"), _globs),
    **dict.fromkeys(
        ("triangle_budget", "max_depth", "block_cells", "rays", "resolution", "seed", "workers", "priority")
        + ("pairs", "sample", "threads", "limit", "before"),
        _whole,
    ),
    **dict.fromkeys(
        ("cell_size", "target_error", "max_error", "min_share", "far", "reach", "error_threshold")
        + ("interior_threshold", "min_distance"),
        _number,
    ),
    **dict.fromkeys(
        ("method", "sampler", "granularity", "cell_to_cell", "up", "error_measure", "superset", "backend")
        + ("name", "user", "request_id", "coordinator", "traces"),
        _word,
    ),
    **dict.fromkeys(("view_mesh", "data_dir", "path", "images", "traces_ca"), _path),
    "time_budget": _duration,
    "cells": _cells,
    "view_box": _rows(6),
    "eye_heights": _rows(2),
    "reachable_from": _rows(3),
    "viewpoints": _viewpoints,
    "viewpoints_file": _viewpoints,
}


@contextmanager
def folder() -> Iterator[str]:
    """A folder for files that are not kept."""
    path = tempfile.mkdtemp(prefix="sightline-")
    try:
        yield path
    finally:
        # A bake that was ended may still write to it for a moment.
        shutil.rmtree(path, ignore_errors=True)


def flags(function: str, known: Iterable[str], options: Dict[str, Any], folder: str) -> List[str]:
    """The flags of these options; None leaves an option out. Files that they need are written to `folder`."""
    known = set(known)
    out = []
    for name, value in options.items():
        if name not in known:
            near = difflib.get_close_matches(name, sorted(known), 1)
            hint = f"; did you mean {near[0]}?" if near else f"; it has {', '.join(sorted(known))}"
            raise TypeError(f"{function} has no option {name}{hint}")
        if value is None:
            continue
        flag = "--" + ("viewpoints-file" if name == "viewpoints_file" else name.replace("_", "-"))
        try:
            texts = list(_TEXTS[name](value, folder))
        except TypeError as e:
            raise TypeError(f"{function}, {name}: {e}") from None
        except ValueError as e:
            raise OptionError(f"{function}, {name}: {e}") from None
        out += [flag if text is None else f"{flag}={text}" for text in texts]
    return out
