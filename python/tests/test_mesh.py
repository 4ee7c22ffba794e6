"""Meshes that are taken, and meshes that are refused with the part at fault."""

import pathlib

import numpy as np
import pytest
import trimesh
from conftest import boxes, sets

import sightline

CELLS = {"cells": (2, 1, 3), "backend": "cpu"}


def test_the_same_mesh_gives_the_same_sets_however_it_is_given(program):
    vertices, faces = boxes([[0, 0, 0], [3, 0, 0], [0, 0, 4], [3, 0, 4], [1.5, 0, 2]])
    of_trimesh = trimesh.Trimesh(vertices, faces, process=False)
    of_trimesh.export(program.path("boxes.ply"))
    program("bake boxes.ply -o boxes.pvs --cells 2x1x3 --backend cpu")
    expected = program.sets("boxes.pvs")
    assert len(expected) == 6 and all(0 < len(cell) < len(faces) for cell in expected)
    given = [
        program.path("boxes.ply"),
        pathlib.Path(program.path("boxes.ply")),
        (vertices, faces),
        (vertices.astype(np.float32), faces.astype(np.uint16)),
        [vertices.tolist(), faces.tolist()],
        of_trimesh,
    ]
    for mesh in given:
        pvs = sightline.bake(mesh, **CELLS)
        assert pvs.triangles == len(faces) and sets(pvs) == expected, type(mesh)


def test_a_scene_has_an_object_for_each_node_at_its_place():
    scene = trimesh.Scene()
    cube = trimesh.creation.box([1, 1, 1])
    for k, name in enumerate(["pillar", "glass pane", "wall"]):
        place = trimesh.transformations.translation_matrix([3 * k, 0, 0])
        scene.add_geometry(cube, node_name=name, geom_name="cube", transform=place)
    # A mirrored node, whose triangles stay turned outside.
    scene.add_geometry(cube, node_name="mirrored", transform=np.diag([-1, 1, 1, 1]) @ place)
    scene.add_geometry(trimesh.PointCloud([[0, 0, 0]]), node_name="points")
    pvs = sightline.bake(scene, cells=4, backend="cpu")
    assert [(name, count) for name, _, count in pvs.objects] == [
        ("pillar", 12), ("glass pane", 12), ("wall", 12), ("mirrored", 12)
    ]
    # The bounds of the scene, from the mirrored cube to the wall.
    assert pvs.view_box.tolist() == [[-6.5, -0.5, -0.5], [6.5, 0.5, 0.5]]
    # Rules match the names of nodes.
    clear = sightline.bake(scene, cells=4, see_through="glass*", backend="cpu")
    assert {c["kind"]: c["triangles"] for c in clear.info["kinds"]["counts"]}["see-through"] == 12
    # From the left the outside of the mirrored cube is seen, and its inside is not.
    left = (-20, -0.2, -0.2, -10, 0.2, 0.2)
    culled = sightline.bake(scene, cells=1, view_box=left, cull_back_faces=True, backend="cpu")
    seen = culled.visible(0)
    seen = seen[seen >= 36] - 36
    assert len(seen) > 0 and np.allclose(-(cube.triangles_center[seen][:, 0] + 6), -6.5)


@pytest.mark.parametrize(
    "vertices, faces, says",
    [
        (np.zeros((4, 2)), [[0, 1, 2]], r"the vertices of mesh must have the shape \(n, 3\), not \(4, 2\)"),
        (np.zeros(12), [[0, 1, 2]], r"not \(12,\)"),
        (np.eye(3), [[0, 1, 2, 0]], r"the faces of mesh must have the shape \(n, 3\), not \(1, 4\)"),
        (np.eye(3), [[0, 1, 3]], r"face 0 of mesh is \[0, 1, 3\], but the vertices are numbered from 0 to 2"),
        (np.eye(3), [[0, 1, 2], [0, -1, 2]], "face 1 of mesh"),
        (np.eye(3), np.zeros((0, 3), int), "has no faces"),
        ([[0, 0, 0], [1, np.nan, 0], [0, 1, 0]], [[0, 1, 2]], r"vertex 1 of mesh is \[1.0, nan, 0.0\]"),
        (np.eye(3) * 1e39, [[0, 1, 2]], "too large for single precision"),
        (np.zeros((3, 3)), [[0, 1, 2]], "none of the triangles of the scene has an area"),
    ],
)
def test_wrong_arrays_are_refused_in_a_sentence(vertices, faces, says):
    with pytest.raises(sightline.InputError, match=says) as refused:
        sightline.bake((vertices, faces))
    assert isinstance(refused.value, ValueError) and isinstance(refused.value, sightline.SightlineError)


@pytest.mark.parametrize(
    "mesh", [None, 7, b"level.glb", (np.eye(3),), (np.eye(3), [["a", "b", "c"]]), (np.eye(3), np.eye(3))]
)
def test_what_is_no_mesh_is_a_type_error(mesh):
    with pytest.raises(TypeError):
        sightline.bake(mesh)


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(sightline.InputError, match="nowhere.glb"):
        sightline.bake("nowhere.glb")
    with pytest.raises(sightline.InputError, match="no mesh with faces"):
        sightline.bake(trimesh.Scene())
