"""Meshes as the package takes them: a path, arrays, or an object of trimesh. Wrong ones are refused here, with
a sentence that names the part at fault."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, List, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import InputError

if TYPE_CHECKING:
    # trimesh.Trimesh and trimesh.Scene, of which only a few attributes are used.
    MeshLike = Union[str, "os.PathLike[str]", Tuple[ArrayLike, ArrayLike], Any]

Part = Tuple[str, "NDArray[np.float32]", "NDArray[np.int64]"]
Source = Union[str, List[Part]]


def source(mesh: MeshLike) -> Source:
    """What the native part takes: a path, or named parts with vertices and triangles."""
    if isinstance(mesh, (str, os.PathLike)):
        path = os.fspath(mesh)
        if isinstance(path, str):
            return path
    elif isinstance(mesh, (tuple, list)):
        if len(mesh) != 2:
            raise TypeError(f"a mesh as a tuple is (vertices, faces), and this one has {len(mesh)} parts")
        return [_part("mesh", mesh[0], mesh[1])]
    elif hasattr(mesh, "geometry") and hasattr(mesh, "graph"):
        return _of_scene(mesh)
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return [_part("mesh", mesh.vertices, mesh.faces)]
    raise TypeError(
        "a mesh is a path, (vertices, faces), a trimesh.Trimesh or a trimesh.Scene, and not "
        f"{type(mesh).__name__}"
    )


def _of_scene(scene: Any) -> List[Part]:
    """One part for each node with a mesh, in the order of the scene's graph, placed by the node."""
    parts = []
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        # Paths and clouds of points hide nothing and show no surface.
        if getattr(mesh, "faces", None) is None:
            continue
        place = np.asarray(place, dtype=np.float64)
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ place[:3, :3].T + place[:3, 3]
        faces = np.asarray(mesh.faces)
        # A mirror turns triangles over; the order of their corners keeps their fronts outside.
        mirrored = np.linalg.det(place[:3, :3]) < 0
        parts.append(_part(str(node), vertices, faces[:, ::-1] if mirrored else faces))
    if not parts:
        raise InputError("the scene has no mesh with faces; add one with scene.add_geometry")
    return parts


def _part(name: str, vertices: ArrayLike, faces: ArrayLike) -> Part:
    points = _array(f"the vertices of {name}", vertices, "fiu", "numbers")
    corners = _array(f"the faces of {name}", faces, "iu", "whole numbers")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"vertex {row} of {name} is {points[row].tolist()}; coordinates have to be finite")
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(points, dtype=np.float32)
    if not np.isfinite(single).all():
        raise InputError(f"coordinates of {name} are too large for single precision; use another unit of length")
    if len(corners) == 0:
        raise InputError(f"{name} has no faces; give at least one triangle")
    wrong = (corners < 0) | (corners >= len(points))
    if wrong.any():
        row = int(np.flatnonzero(wrong.any(axis=1))[0])
        raise InputError(
            f"face {row} of {name} is {corners[row].tolist()}, and the vertices are numbered from 0 to "
            f"{len(points) - 1}"
        )
    return name, single, np.ascontiguousarray(corners, dtype=np.int64)


def _array(what: str, given: ArrayLike, kinds: str, of: str) -> NDArray[Any]:
    """An array of shape (n, 3) with one of these kinds of numbers."""
    array = np.asarray(given)
    if array.dtype.kind not in kinds:
        raise TypeError(f"{what} are an array of {of}, and not of {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{what} have the shape (n, 3), and not {array.shape}")
    return array


def points(what: str, given: Sequence[Any], columns: Sequence[int]) -> NDArray[np.float64]:
    """An array of finite numbers with one of these numbers of columns."""
    array = np.asarray(given, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] not in columns or len(array) == 0:
        wanted = " or ".join(f"(n, {c})" for c in columns)
        raise InputError(f"{what} have the shape {wanted}, and not {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{what} have to be finite")
    return array
