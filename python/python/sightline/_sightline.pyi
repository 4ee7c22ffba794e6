"""The native part."""

from os import PathLike
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Client", "Pvs", "assemble", "bake", "measure", "plan", "tile", "verify"]

_CellOrPoint = Union[int, Sequence[float]]
_Path = Union[str, "PathLike[str]"]
_Source = Union[str, List[Tuple[str, NDArray[np.float32], NDArray[np.int64]]]]
_Call = Optional[Callable[[int, int, str, str, Optional[float]], object]]

@final
class Pvs:
    """A result: view cells, and what is visible from each. Cells are given by their number or by a point in them.
    Look-ups may come from several threads at a time."""

    def __new__(cls, source: Union[_Path, bytes]) -> Pvs:
        """Opens a file, or reads bytes, and checks all of it."""
    @property
    def triangles(self) -> int:
        """Number of triangles of the scene."""
    @property
    def method(self) -> str:
        """How the sets were made: aggressive, exact, verified or portals."""
    @property
    def granularity(self) -> str:
        """What the sets name: triangles, clusters or objects."""
    @property
    def item_count(self) -> int:
        """Number of items that the sets name."""
    @property
    def info_json(self) -> str:
        """The description of the bake, as JSON text."""
    @property
    def info(self) -> Any:
        """The description of the bake."""
    @property
    def grid(self) -> Optional[Tuple[int, int, int]]:
        """The numbers of cells along x, y and z; None where the cells are no regular grid."""
    @property
    def view_box(self) -> NDArray[np.float32]:
        """The box of all viewpoints: its least and its greatest corner."""
    @property
    def objects(self) -> List[Tuple[str, int, int]]:
        """The objects of the scene as (name, first triangle, number of triangles)."""
    @property
    def boxes(self) -> NDArray[np.float32]:
        """The boxes of all cells: least x, y, z, then greatest x, y, z in each row."""
    @property
    def reached(self) -> NDArray[np.bool_]:
        """Whether viewpoints can be in each cell."""
    @property
    def set_aside(self) -> NDArray[np.bool_]:
        """Whether the tile of each cell was set aside after failures, so that the cell shows everything."""
    @property
    def set_sizes(self) -> NDArray[np.uint32]:
        """The number of triangles to draw from each cell."""
    @property
    def statistics(self) -> Dict[str, NDArray[np.uint64]]:
        """The statistics of the bake by name, one number for each cell."""
    @property
    def has_pairs(self) -> bool:
        """Whether the result says which cells see which."""
    def __len__(self) -> int: ...
    def cell_of(self, point: Sequence[float]) -> Optional[int]:
        """The cell that holds a point; None outside the view box."""
    def cells_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """The cells that hold points, one a row; -1 outside the view box."""
    def is_reached(self, cell: int) -> bool:
        """Whether viewpoints are in a cell."""
    def visible(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """The triangles to draw from a cell, or from the cell of a point, ascending."""
    def undecided(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """Those of them that were neither seen nor proved hidden."""
    def visible_objects(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """The objects of the triangles to draw, ascending."""
    def visible_items(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """The items to draw: triangles, clusters or objects, by the granularity of the result."""
    def contributions(self, of: _CellOrPoint) -> Optional[NDArray[np.float64]]:
        """How much of the view each visible item takes: a row for each of `visible_items`, with the mean share
        of all directions and the greatest from one viewpoint, both rounded up to a power of two; None where
        the result does not say."""
    def sees(self, one: _CellOrPoint, other: _CellOrPoint) -> bool:
        """Whether a point of one cell may see a point of another one."""
    def sees_box(self, of: _CellOrPoint, least: Sequence[float], greatest: Sequence[float]) -> bool:
        """Whether a point of a cell may see a point of the box from `least` to `greatest`."""
    def to_bytes(self) -> bytes:
        """The bytes of the file."""
    def save(self, path: _Path) -> None:
        """Writes the file."""

@final
class Client:
    """The client of a coordinator; it connects for each call."""

    def __new__(cls, url: str, credentials: str) -> Client: ...
    def submit(self, scene: _Source, options: str) -> Tuple[str, bool]: ...
    def jobs(self, limit: Optional[int], before: Optional[int]) -> List[str]: ...
    def show(self, job: int) -> str: ...
    def wait(self, job: int, progress: _Call) -> str: ...
    def act(self, job: int, action: str) -> str: ...
    def prioritize(self, job: int, priority: int) -> str: ...
    def fetch(self, job: int, output: _Path) -> int: ...

def bake(scene: _Source, options: str, progress: _Call) -> Pvs: ...
def plan(scene: _Source, folder: str, options: str) -> str: ...
def tile(folder: str, number: int, progress: _Call) -> str: ...
def assemble(folder: str, output: _Path) -> None: ...
def measure(pvs: Pvs, scene: _Source, options: str, progress: _Call) -> str: ...
def verify(pvs: Pvs, scene: _Source, options: str, progress: _Call) -> str: ...
