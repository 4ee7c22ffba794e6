"""Functions that bake, plan, measure and verify in this process."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any, Dict, Optional, Sequence, Union

from . import _mesh, _options, _progress, _sightline
from ._errors import Refused
from ._sightline import Pvs

if TYPE_CHECKING:
    from typing_extensions import Unpack

_JOB = tuple(_options.JobOptions.__annotations__)
_KINDS = tuple(_options.KindOptions.__annotations__)
#: The options of a bake in this process.
_LOCAL = {name: name for name in ("workers", "data_dir", "output")}


def bake(
    mesh: _mesh.MeshLike,
    *,
    output: Optional[_options.Path] = None,
    data_dir: Optional[_options.Path] = None,
    workers: Optional[int] = None,
    progress: Optional[_progress.OnProgress] = None,
    **options: Unpack[_options.JobOptions],
) -> Pvs:
    """Bakes a mesh in this process, as `sightline bake` does, and returns the result.

    mesh: a path (.obj, .ply, .gltf, .glb), (vertices, faces), a trimesh.Trimesh or a trimesh.Scene. Triangles are
      numbered in the order of the faces; a scene's nodes become the result's objects.
    output: a file for the result. Required if certificates exceed memory.
    data_dir: a folder for unfinished work and results. A bake of the same mesh with the same options
      continues from there, or returns the stored result. Default: a temporary folder.
    workers: the number of tiles that are baked at a time; these tiles share all cores. Default: the number of cores.
    progress: a function that is called with a `Progress`. Its exceptions end the bake, and so does Ctrl-C.

    The options are the options of `sightline bake`, including:
      cells=(8, 8, 8), or 8, or "walls:64"; cell_size; triangle_budget and max_depth
      cell_budget=64 or byte_budget="2MB", with fine=(16, 8, 16) and cost="triangles", "objects" or "bytes"
      view_box=(x0, y0, z0, x1, y1, z1), or several; reachable_from=(x, y, z); viewpoints=array or file; view_mesh=file
      target_error=0.0001; max_error; min_share; time_budget=30 (seconds) or "5m"
      method="aggressive", "exact", "verified" or "portals"; certificates=True
      granularity="triangles", "clusters" or "objects"; complete="off"; contributions=True; far; cell_to_cell="on"
      see_through="glass*", occluder_only, moving, doors, opaque; alpha_textures; cull_back_faces
      backend="auto", "cpu", "gpu" or "embree"; seed=0; sampler

    `sightline bake --help` explains each option.

        pvs = sightline.bake((vertices, faces), cells=(16, 4, 16), max_error=1e-3)
        ids = pvs.visible((1.5, 2.0, -3.0))
    """
    given: Dict[str, Any] = {"workers": workers, "data_dir": data_dir, "output": output, **options}
    with _options.folder() as folder:
        job = _options.values("bake", (*_JOB, *_LOCAL), given, folder)
        scene, traces = _options.scene(job), _options.traces(job)
        local = _options.take(job, _LOCAL)
        local.setdefault("data_dir", os.path.join(folder, "data"))
        document = _options.document(scene=scene, job=job, local={**local, "traces": traces})
        return _sightline.bake(_mesh.source(mesh), document, _progress.caller(progress))


def plan(mesh: _mesh.MeshLike, folder: _options.Path, **options: Unpack[_options.JobOptions]) -> Dict[str, Any]:
    """Writes the plan of a bake to a folder, or to a place in a bucket ("s3://BUCKET/PREFIX"), as `sightline plan`
    does. Accepts the meshes and options of `bake`, except `time_budget`, `traces` and `traces_ca`.

    Any number of processes compute the tiles with `tile`, and `assemble` joins them. Returns the JSON object of the
    command: `output`, `tiles` (their number) and `profile`.
    """
    with _options.folder() as files:
        known = [name for name in _JOB if name not in ("time_budget", "traces", "traces_ca")]
        job = _options.values("plan", known, dict(options), files)
        scene = _options.scene(job)
        told = _sightline.plan(_mesh.source(mesh), os.fspath(folder), _options.document(scene=scene, job=job))
    return _object(told)


def tile(
    folder: _options.Path, number: int, *, progress: Optional[_progress.OnProgress] = None
) -> Dict[str, Any]:
    """Computes tile `number` of the plan in a folder or bucket, as `sightline tile` does. Skips a tile whose file
    exists and is complete. Tiles are numbered from 0; `plan.json` in the folder lists the tiles that each tile needs.

    Returns the JSON object of the command: `tile`, `output`, `computed`, `samples` and `bytes`.
    """
    return _object(_sightline.tile(os.fspath(folder), number, _progress.caller(progress)))


def assemble(folder: _options.Path, output: _options.Path) -> Pvs:
    """Joins the tiles of the plan in a folder or bucket to the result file `output`, as `sightline assemble` does,
    and returns the result. Its bytes equal the result of `bake`."""
    _sightline.assemble(os.fspath(folder), os.fspath(output))
    return Pvs(output)


def measure(
    pvs: Union[Pvs, _options.Path],
    mesh: _mesh.MeshLike,
    *,
    viewpoints: Union[int, _options.Path, Sequence[Sequence[float]]] = 200,
    seed: int = 1,
    resolution: int = 256,
    path: Optional[_options.Path] = None,
    pairs: int = 0,
    images: Optional[_options.Path] = None,
    backend: str = "auto",
    exact: bool = False,
    progress: Optional[_progress.OnProgress] = None,
    **kinds: Unpack[_options.KindOptions],
) -> Dict[str, Any]:
    """Measures the error of a result, as `sightline measure` does: the fraction of wrong pixels in cubes of the
    whole mesh around viewpoints.

    viewpoints: the number of random viewpoints, an array of points (with optional weights in a fourth column), or
      a file.
    path: a file with a camera path, instead of viewpoints.
    pairs: the number of random pairs of points for measuring the pairs of cells that see each other.
    images: a folder for images of the worst frames.
    exact: compare with exact sets from the viewpoints, without pixels. Ignores resolution, pairs, images and backend.
    kinds: the options of kinds. Default: the options of the bake.

    Returns the JSON object of the command: `mean_error`, `p99_error` and `max_error` as fractions of a frame's
    pixels (with exact, of all directions), `frames`, `worst` and more.
    """
    given: Dict[str, Any] = {"seed": seed, "path": path, **kinds}
    if exact:
        given["exact"] = True
    else:
        given.update({"resolution": resolution, "pairs": pairs, "images": images, "backend": backend})
    with _options.folder() as folder:
        known = (*_KINDS, "seed", "resolution", "path", "pairs", "images", "backend", "exact", "viewpoints_file")
        count = 4294967295
        if isinstance(viewpoints, int) and not isinstance(viewpoints, bool):
            count = viewpoints
        else:
            given["viewpoints_file"] = viewpoints
        values = _options.values("measure", known, given, folder)
        document = _options.document(scene=_options.scene(values), viewpoints=count, **values)
        told = _sightline.measure(_opened(pvs), _mesh.source(mesh), document, _progress.caller(progress))
    return _object(told)


def verify(
    pvs: Union[Pvs, _options.Path],
    mesh: _mesh.MeshLike,
    *,
    sample: Optional[int] = None,
    seed: Optional[int] = None,
    progress: Optional[_progress.OnProgress] = None,
    **kinds: Unpack[_options.KindOptions],
) -> Dict[str, Any]:
    """Checks the witnesses and proofs of a result with the independent checker, as `sightline verify` does. The
    result needs certificates (method="exact", certificates=True).

    sample: the number of random pairs of cell and triangle to check. Default: all pairs.
    seed: the seed of the random pairs.

    Returns the JSON object of the command, with `accepted` True. Raises `Refused` if a claim does not hold.
    """
    given: Dict[str, Any] = {"sample": sample, "seed": seed, **kinds}
    values = _options.values("verify", (*_KINDS, "sample", "seed"), given, "")
    document = _options.document(scene=_options.scene(values), **values)
    told = _object(_sightline.verify(_opened(pvs), _mesh.source(mesh), document, _progress.caller(progress)))
    if not told["accepted"]:
        raise Refused(told["reason"], told.get("cell"))
    return told


def cells(
    pvs: Union[Pvs, _options.Path],
    *,
    cell_budget: Optional[int] = None,
    byte_budget: Optional[Union[int, str]] = None,
    cost: Optional[str] = None,
) -> Dict[str, Any]:
    """Finds the view cells with the least expected set for a budget in the grid of a result, as `sightline cells`
    does.

    cell_budget: the maximum number of cells with viewpoints.
    byte_budget: the maximum sum of the sizes of their sets, as a number of bytes or a text such as "2MB".
    cost: "triangles" (default), "objects" or "bytes".

    Returns the JSON object of the command: `fine`, `grid`, `chosen`, `boxes` and `hull`.
    """
    given: Dict[str, Any] = {"cell_budget": cell_budget, "byte_budget": byte_budget, "cost": cost}
    options = _options.values("cells", given, given, "")
    return _object(_sightline.cells(_opened(pvs), json.dumps(options)))


def unite(
    pvs: Union[Pvs, _options.Path],
    output: _options.Path,
    *,
    cell_budget: Optional[int] = None,
    byte_budget: Optional[Union[int, str]] = None,
    cost: Optional[str] = None,
    viewpoints: Optional[Union[_options.Path, Sequence[Sequence[float]]]] = None,
) -> Pvs:
    """Writes the result `output` with the view cells that `cells` finds in a result of a fine grid, as
    `sightline bake --from` does, and returns it. The set of a cell is the union of the sets of its fine cells.

    viewpoints: an array of points (with optional weights in a fourth column), or a file. The weight of a fine cell is
      the sum of the weights of its points. Default: the number of its parts that contain viewpoints.
    """
    given: Dict[str, Any] = {"cell_budget": cell_budget, "byte_budget": byte_budget, "cost": cost}
    given["viewpoints"] = viewpoints
    with _options.folder() as folder:
        options = _options.values("unite", given, given, folder)
        file = options.pop("viewpoints", None)
        _sightline.unite(_opened(pvs), os.fspath(output), json.dumps(options), file)
    return Pvs(output)


def _opened(pvs: Union[Pvs, _options.Path]) -> Pvs:
    return pvs if isinstance(pvs, Pvs) else Pvs(pvs)


def _object(text: str) -> Dict[str, Any]:
    told = json.loads(text)
    assert isinstance(told, dict)
    return told


def _read(path: str) -> Pvs:
    """Reads a result into memory, so that its file can be deleted."""
    with open(path, "rb") as file:
        return Pvs(file.read())
