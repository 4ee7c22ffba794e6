"""Conversion of meshes: a path, arrays, or an object of trimesh. Invalid meshes raise an error that names the
part, the vertex or the face."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, List, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import InputError

if TYPE_CHECKING:
    # Any stands for trimesh.Trimesh and trimesh.Scene: the package does not import trimesh.
    MeshLike = Union[str, "os.PathLike[str]", Tuple[ArrayLike, ArrayLike], Any]

Part = Tuple[str, "NDArray[np.float32]", "NDArray[np.int64]"]
Source = Union[str, List[Part]]


def source(mesh: MeshLike) -> Source:
    """Converts a mesh to the input of the native part: a path, or named parts with vertices and triangles."""
    if isinstance(mesh, (str, os.PathLike)):
        path = os.fspath(mesh)
        if isinstance(path, str):
            return path
    elif isinstance(mesh, (tuple, list)):
        if len(mesh) != 2:
            raise TypeError(f"a mesh as a tuple must be (vertices, faces), but the tuple has {len(mesh)} elements")
        return [_part("mesh", mesh[0], mesh[1])]
    elif hasattr(mesh, "geometry") and hasattr(mesh, "graph"):
        return _of_scene(mesh)
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return [_part("mesh", mesh.vertices, mesh.faces)]
    raise TypeError(
        "a mesh must be a path, (vertices, faces), a trimesh.Trimesh or a trimesh.Scene, not "
        f"{type(mesh).__name__}"
    )


def _of_scene(scene: Any) -> List[Part]:
    """Returns a part for each node with a mesh, in the order of the scene's graph, in world space."""
    parts = []
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        # Skip paths and point clouds, which have no surface.
        if getattr(mesh, "faces", None) is None:
            continue
        place = np.asarray(place, dtype=np.float64)
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ place[:3, :3].T + place[:3, 3]
        faces = np.asarray(mesh.faces)
        # A mirroring transform reverses the winding, so reverse the corners to keep the fronts outside.
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
        raise InputError(f"vertex {row} of {name} is {points[row].tolist()}; coordinates must be finite")
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
            f"face {row} of {name} is {corners[row].tolist()}, but the vertices are numbered from 0 to "
            f"{len(points) - 1}"
        )
    return name, single, np.ascontiguousarray(corners, dtype=np.int64)


def _array(what: str, given: ArrayLike, kinds: str, of: str) -> NDArray[Any]:
    """Checks and returns an array of shape (n, 3) whose dtype kind is one of `kinds`."""
    array = np.asarray(given)
    if array.dtype.kind not in kinds:
        raise TypeError(f"{what} must be an array of {of}, not of {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{what} must have the shape (n, 3), not {array.shape}")
    return array


def points(what: str, given: Sequence[Any], columns: Sequence[int]) -> NDArray[np.float64]:
    """Checks and returns an array of finite numbers whose number of columns is one of `columns`."""
    array = np.asarray(given, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] not in columns or len(array) == 0:
        wanted = " or ".join(f"(n, {c})" for c in columns)
        raise InputError(f"{what} must have the shape {wanted}, not {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{what} must be finite numbers")
    return array
