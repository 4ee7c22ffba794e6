"""Types of the native part."""

from os import PathLike
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Client", "Pvs", "assemble", "bake", "cells", "measure", "plan", "tile", "unite", "verify"]

_CellOrPoint = Union[int, Sequence[float]]
_Path = Union[str, "PathLike[str]"]
_Source = Union[str, List[Tuple[str, NDArray[np.float32], NDArray[np.int64]]]]
_Call = Optional[Callable[[int, int, str, str, Optional[float]], object]]

@final
class Pvs:
    """A result: view cells and their visible sets. Methods accept the number of a cell or a point in the cell.
    Several threads may query a result at a time."""

    def __new__(cls, source: Union[_Path, bytes]) -> Pvs:
        """Opens a file, or reads bytes, and checks all of it."""
    @property
    def triangles(self) -> int:
        """The number of triangles of the scene."""
    @property
    def method(self) -> str:
        """The method of the bake: aggressive, exact, verified or portals."""
    @property
    def granularity(self) -> str:
        """The type of the items in the sets: triangles, clusters or objects."""
    @property
    def item_count(self) -> int:
        """The number of items of the result."""
    @property
    def info_json(self) -> str:
        """The description of the bake, as JSON text."""
    @property
    def info(self) -> Any:
        """The description of the bake, as a Python object."""
    @property
    def grid(self) -> Optional[Tuple[int, int, int]]:
        """The numbers of cells along x, y and z, or None if the cells do not form a regular grid."""
    @property
    def view_box(self) -> NDArray[np.float32]:
        """The box of all viewpoints: its minimum and its maximum corner."""
    @property
    def objects(self) -> List[Tuple[str, int, int]]:
        """The objects of the scene as (name, first triangle, number of triangles)."""
    @property
    def boxes(self) -> NDArray[np.float32]:
        """The boxes of all cells: minimum x, y, z, then maximum x, y, z in each row."""
    @property
    def reached(self) -> NDArray[np.bool_]:
        """For each cell, True if the cell can contain viewpoints."""
    @property
    def set_aside(self) -> NDArray[np.bool_]:
        """For each cell, True if its tile was set aside or has no output. The set then contains all triangles that
        show."""
    @property
    def set_sizes(self) -> NDArray[np.uint32]:
        """The number of triangles to draw from each cell."""
    @property
    def statistics(self) -> Dict[str, NDArray[np.uint64]]:
        """The statistics of the bake by name: arrays with one number for each cell."""
    @property
    def has_pairs(self) -> bool:
        """True if the result contains the pairs of cells that see each other."""
    def __len__(self) -> int: ...
    def cell_of(self, point: Sequence[float]) -> Optional[int]:
        """Returns the cell that contains a point, or None outside the view box."""
    def cells_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Returns the cell of each point, given as rows; -1 outside the view box."""
    def is_reached(self, cell: int) -> bool:
        """Returns True if a cell can contain viewpoints."""
    def visible(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """Returns the triangles to draw from a cell, or from the cell of a point, ascending."""
    def undecided(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """Returns the triangles to draw that were neither seen nor proved hidden, ascending."""
    def visible_objects(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """Returns the objects of the triangles to draw, ascending."""
    def visible_items(self, of: _CellOrPoint) -> NDArray[np.uint32]:
        """Returns the items to draw: triangles, clusters or objects, by the granularity of the result."""
    def contributions(self, of: _CellOrPoint) -> Optional[NDArray[np.float64]]:
        """Returns the share of the view of each visible item: a row for each of `visible_items`, with the mean
        share of all directions and the largest share from one viewpoint. Both are rounded up to a power of two.
        Returns None if the result has no contributions."""
    def sees(self, one: _CellOrPoint, other: _CellOrPoint) -> bool:
        """Returns True if a point of one cell may see a point of the other cell."""
    def sees_box(self, of: _CellOrPoint, least: Sequence[float], greatest: Sequence[float]) -> bool:
        """Returns True if a point of a cell may see a point of the box from `least` to `greatest`."""
    def to_bytes(self) -> bytes:
        """Returns the bytes of the file."""
    def save(self, path: _Path) -> None:
        """Writes the result to a file."""

@final
class Client:
    """The client of a coordinator, with a new connection for each call."""

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
def cells(pvs: Pvs, options: str) -> str: ...
def unite(pvs: Pvs, output: _Path, options: str, viewpoints: Optional[_Path]) -> None: ...
def verify(pvs: Pvs, scene: _Source, options: str, progress: _Call) -> str: ...
