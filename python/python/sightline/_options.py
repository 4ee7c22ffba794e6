"""Options as keyword arguments: their types, and the JSON documents that the native part reads."""

from __future__ import annotations

import difflib
import json
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
    """The kinds of triangles, by globs over names of objects and materials. If several globs match a name, the last
    one counts."""

    see_through: Globs
    occluder_only: Globs
    moving: Globs
    doors: Globs
    opaque: Union[bool, Globs]
    alpha_textures: bool
    cull_back_faces: bool


class JobOptions(KindOptions, total=False):
    """The options of a job: the options of `sightline bake`, with `_` instead of `-`."""

    method: str
    certificates: bool
    cells: Union[int, str, Sequence[int]]
    cell_size: float
    triangle_budget: int
    max_depth: int
    cell_budget: int
    byte_budget: Union[int, str]
    fine: Union[int, str, Sequence[int]]
    cost: str
    sampler: str
    target_error: float
    max_error: float
    time_budget: Union[float, str]
    block_cells: int
    rays: int
    credit: str
    granularity: str
    complete: str
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


#: A function that converts a value to JSON. Its second argument is a folder for files.
Convert = Callable[[Any, str], Any]


def _whole(value: Any, folder: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{value!r} is not a whole number")
    return int(value)


def _number(value: Any, folder: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{value!r} is not a number")
    if not np.isfinite(value):
        raise ValueError(f"{value!r} is not a finite number")
    return float(value)


def _word(value: Any, folder: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a text")
    return value


def _path(value: Any, folder: str) -> str:
    return os.fsdecode(os.fspath(value))


def _switch(value: Any, folder: str) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{value!r} is not True or False")
    return bool(value)


def _globs(value: Any, folder: str) -> List[str]:
    if isinstance(value, bool):
        return ["*"] if value else []
    return [_word(one, folder) for one in ([value] if isinstance(value, str) else value)]


def _duration(value: Any, folder: str) -> Union[str, float]:
    return value if isinstance(value, str) else _number(value, folder)


def _bytes(value: Any, folder: str) -> Union[str, int]:
    return value if isinstance(value, str) else _whole(value, folder)


def _cells(value: Any, folder: str) -> Union[str, List[int]]:
    if isinstance(value, str):
        return value
    cells = [value] * 3 if isinstance(value, (int, np.integer)) else list(value)
    if len(cells) != 3:
        raise ValueError(f"{value!r} is not one number or three; give, for example, (8, 8, 8)")
    return [_whole(n, folder) for n in cells]


def _rows(columns: int) -> Convert:
    """Returns a converter for rows of numbers, or a single row."""

    def rows_of(value: Any, folder: str) -> List[List[float]]:
        rows = np.asarray(value, dtype=np.float64)
        # A box may be given as its minimum and its maximum corner.
        if columns == 6 and rows.shape == (2, 3):
            rows = rows.reshape(1, 6)
        if rows.ndim == 1:
            rows = rows[None]
        if rows.ndim == 3 and columns == 6:
            rows = rows.reshape(len(rows), -1)
        if rows.ndim != 2 or rows.shape[1] != columns or len(rows) == 0:
            raise ValueError(f"give {columns} numbers, or rows of {columns} numbers, not the shape {np.shape(value)}")
        if not np.isfinite(rows).all():
            raise ValueError("all numbers must be finite")
        return [[float(x) for x in row] for row in rows]

    return rows_of


def _heights(value: Any, folder: str) -> List[float]:
    low, high = _rows(2)(value, folder)[0]
    if low > high:
        raise ValueError(f"give the minimum height, then the maximum height, not {value!r}")
    return [low, high]


def _viewpoints(value: Any, folder: str) -> str:
    """Returns the path of a file of viewpoints; writes an array to a file."""
    if isinstance(value, (str, os.PathLike)):
        return _path(value, folder)
    file = os.path.join(folder, "viewpoints.txt")
    np.savetxt(file, _mesh.points("viewpoints", value, (3, 4)), fmt="%.17g")
    return file


_CONVERT: Dict[str, Convert] = {
    **dict.fromkeys(
        ("certificates", "contributions", "no_solids", "alpha_textures", "cull_back_faces", "exact"),
        _switch,
    ),
    **dict.fromkeys(("see_through", "occluder_only", "moving", "doors", "opaque"), _globs),
    **dict.fromkeys(
        ("triangle_budget", "max_depth", "cell_budget", "block_cells", "rays", "resolution", "seed", "workers")
        + ("priority", "pairs", "sample"),
        _whole,
    ),
    **dict.fromkeys(
        ("cell_size", "target_error", "max_error", "min_share", "far", "reach", "error_threshold")
        + ("interior_threshold", "min_distance"),
        _number,
    ),
    **dict.fromkeys(
        ("method", "sampler", "credit", "granularity", "complete", "cell_to_cell", "up", "error_measure", "superset", "backend")
        + ("cost", "name", "user", "request_id", "traces"),
        _word,
    ),
    **dict.fromkeys(
        ("view_mesh", "data_dir", "output", "path", "images", "traces_ca", "ca", "cert", "key", "token_file"), _path
    ),
    "time_budget": _duration,
    "byte_budget": _bytes,
    "cells": _cells,
    "fine": _cells,
    "view_box": _rows(6),
    "eye_heights": _heights,
    "reachable_from": _rows(3),
    "viewpoints": _viewpoints,
    "viewpoints_file": _viewpoints,
}

#: The name of the kind for each option.
_KINDS = {
    "see_through": "see-through",
    "occluder_only": "occluder-only",
    "moving": "moving",
    "doors": "doors",
    "opaque": "opaque",
}
#: The field of the traces document for each option.
_TRACES = {"traces": "url", "traces_ca": "ca"}


@contextmanager
def folder() -> Iterator[str]:
    """Creates a temporary folder, which is removed at the end of the context."""
    path = tempfile.mkdtemp(prefix="sightline-")
    try:
        yield path
    finally:
        # A stopped bake may still write to the folder for a moment, so ignore errors.
        shutil.rmtree(path, ignore_errors=True)


def values(function: str, known: Iterable[str], options: Dict[str, Any], folder: str) -> Dict[str, Any]:
    """Converts the values of options to JSON values and skips options with the value None. Writes an
    array of viewpoints to a file in `folder`."""
    known = set(known)
    out = {}
    for name, value in options.items():
        if name not in known:
            near = difflib.get_close_matches(name, sorted(known), 1)
            hint = f"; did you mean {near[0]}?" if near else f"; the options are {', '.join(sorted(known))}"
            raise TypeError(f"{function} has no option {name}{hint}")
        if value is None:
            continue
        try:
            out[name] = _CONVERT[name](value, folder)
        except TypeError as e:
            raise TypeError(f"{function}, {name}: {e}") from None
        except ValueError as e:
            raise OptionError(f"{function}, {name}: {e}", name) from None
    return out


def take(values: Dict[str, Any], names: Dict[str, str]) -> Dict[str, Any]:
    """Removes the options in `names` from `values` and returns them, renamed by `names`."""
    return {names[name]: values.pop(name) for name in list(values) if name in names}


def scene(values: Dict[str, Any]) -> Dict[str, Any]:
    """Removes the options of kinds and sides from `values` and returns the document of a scene. The rules have the
    order of the arguments."""
    kinds = take(values, {name: name for name in (*_KINDS, "alpha_textures", "cull_back_faces")})
    rules = [(_KINDS[name], glob) for name, globs in kinds.items() if name in _KINDS for glob in globs]
    document: Dict[str, Any] = {"rules": rules}
    document.update({name: kinds[name] for name in ("alpha_textures", "cull_back_faces") if name in kinds})
    return document


def traces(values: Dict[str, Any]) -> Dict[str, Any]:
    """Removes the options of traces from `values` and returns the traces document."""
    return take(values, _TRACES)


def document(**parts: Any) -> str:
    """Returns the JSON text of an object with these parts."""
    return json.dumps(parts)
