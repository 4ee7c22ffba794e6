//! Results for Python: cells with their boxes, sets and statistics, and cell-to-cell visibility.

use std::path::PathBuf;

use numpy::{
    AllowTypeChange, IntoPyArray as _, PyArray1, PyArray2, PyArrayLike2, PyArrayMethods as _,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use sightline_model::job::json::find_field;
use sightline_pvs::PvsError;

use crate::errors::of_pvs;

/// A cell: its number, or a point in the cell.
#[derive(FromPyObject)]
pub enum CellOrPoint {
    /// The number of the cell.
    Cell(u32),
    /// A point in the cell.
    Point([f32; 3]),
}

/// An open result. Several threads may query a result at the same time.
#[pyclass(frozen, module = "sightline")]
pub struct Pvs(pub sightline_pvs::Pvs);

impl Pvs {
    /// Returns the number of a cell, given by its number or by a point in the cell.
    pub fn cell(&self, of: &CellOrPoint) -> PyResult<u32> {
        match of {
            CellOrPoint::Cell(cell) => Ok(*cell),
            CellOrPoint::Point(point) => self
                .0
                .find_cell(*point)
                .ok_or_else(|| PyValueError::new_err(format!("{point:?} is outside the view box"))),
        }
    }

    fn set<'py>(
        &self,
        py: Python<'py>,
        of: &CellOrPoint,
        read: impl Fn(&sightline_pvs::Pvs, u32, &mut Vec<u32>) -> Result<(), PvsError> + Sync,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let cell = self.cell(of)?;
        let mut ids = Vec::new();
        py.detach(|| read(&self.0, cell, &mut ids))
            .map_err(of_pvs)?;
        Ok(ids.into_pyarray(py))
    }

    fn all<T>(&self, of: impl Fn(u32) -> Result<T, PvsError>) -> Result<Vec<T>, PvsError> {
        (0..self.0.cells()).map(of).collect()
    }
}

#[pymethods]
impl Pvs {
    /// Opens a file, or reads bytes, and checks the whole content.
    #[new]
    fn new(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(bytes) = source.extract::<Vec<u8>>() {
            return py
                .detach(|| sightline_pvs::Pvs::from_bytes(bytes))
                .map(Self)
                .map_err(of_pvs);
        }
        let path: PathBuf = source.extract()?;
        py.detach(|| sightline_pvs::Pvs::open(path))
            .map(Self)
            .map_err(of_pvs)
    }

    /// Returns the bytes of the file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.0.bytes())
    }

    /// Writes the file, which is complete and synced when this method returns.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| sightline_files::write(&path, self.0.bytes()))
            .map_err(PyErr::from)
    }

    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((slf.getattr("__class__")?, (slf.get().to_bytes(py),)))
    }

    /// Returns the number of triangles of the scene.
    #[getter]
    fn triangles(&self) -> u32 {
        self.0.triangle_count()
    }

    /// Returns the method that computed the sets: aggressive, exact, verified or portals.
    #[getter]
    fn method(&self) -> &str {
        self.0.method()
    }

    /// Returns the type of the items in the sets: triangles, clusters or objects.
    #[getter]
    fn granularity(&self) -> &str {
        self.0.granularity().name()
    }

    /// Returns the number of items that the sets can contain.
    #[getter]
    fn item_count(&self) -> u32 {
        self.0.item_count()
    }

    /// Returns the description of the bake, as JSON text.
    #[getter]
    fn info_json(&self) -> &str {
        self.0.info_json()
    }

    /// Returns the description of the bake.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("json")?
            .call_method1("loads", (self.0.info_json(),))
    }

    /// Returns the numbers of cells along x, y and z, or None if the cells are not a regular grid.
    #[getter]
    fn grid(&self) -> Option<(u32, u32, u32)> {
        let info: serde_json::Value = serde_json::from_str(self.0.info_json()).ok()?;
        // Cells by cost are boxes of the cells of the grid.
        if info.get("cells_by_cost").is_some() {
            return None;
        }
        let grid = find_field(&info["spec"], "grid")?;
        let along = |axis: &str| u32::try_from(grid[axis].as_u64()?).ok();
        Some((along("x")?, along("y")?, along("z")?))
    }

    /// Returns the box of all viewpoints: its minimum and its maximum corner.
    #[getter]
    fn view_box<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.0
            .tree()
            .view_box()
            .concat()
            .into_pyarray(py)
            .reshape([2, 3])
    }

    /// Returns the objects of the scene as (name, first triangle, number of triangles).
    #[getter]
    fn objects(&self) -> Vec<(String, u32, u32)> {
        self.0
            .objects()
            .iter()
            .map(|o| (o.name.clone(), o.first, o.count))
            .collect()
    }

    /// Returns the boxes of all cells: minimum x, y, z, then maximum x, y, z in each row.
    #[getter]
    fn boxes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let cells = 0..self.0.cells();
        let all: Vec<f32> = cells
            .flat_map(|cell| self.0.cell_bounds(cell).unwrap_or_default().concat())
            .collect();
        all.into_pyarray(py).reshape([self.0.cells() as usize, 6])
    }

    /// Returns for each cell True if the cell can contain viewpoints.
    #[getter]
    fn reached<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        Ok(self
            .all(|cell| self.0.is_reached(cell))
            .map_err(of_pvs)?
            .into_pyarray(py))
    }

    /// Returns for each cell True if the cell's tile was set aside after failures or has no output. The set
    /// of such a cell contains all triangles that show.
    #[getter]
    fn set_aside<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        Ok(self
            .all(|cell| self.0.is_set_aside(cell))
            .map_err(of_pvs)?
            .into_pyarray(py))
    }

    /// Returns the statistics of the bake by name, with one number for each cell.
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        for column in self.0.columns().map_err(of_pvs)? {
            all.set_item(column.name, column.values.into_pyarray(py))?;
        }
        Ok(all)
    }

    /// Returns the number of cells.
    fn __len__(&self) -> usize {
        self.0.cells() as usize
    }

    /// Returns the cell that contains a point, or None outside the view box.
    fn cell_of(&self, point: [f32; 3]) -> Option<u32> {
        self.0.find_cell(point)
    }

    /// Returns the cells that contain points, with one point per row; -1 outside the view box.
    fn cells_of<'py>(
        &self,
        py: Python<'py>,
        points: PyArrayLike2<'py, f64, AllowTypeChange>,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let points = points.as_array();
        if points.ncols() != 3 {
            return Err(PyValueError::new_err(format!(
                "points must have 3 coordinates, not {}",
                points.ncols()
            )));
        }
        let cell = |p: [f64; 3]| self.0.find_cell_precisely(p).map_or(-1, i64::from);
        let cells: Vec<i64> = points
            .rows()
            .into_iter()
            .map(|p| cell([p[0], p[1], p[2]]))
            .collect();
        Ok(cells.into_pyarray(py))
    }

    /// Returns True if a cell can contain viewpoints.
    fn is_reached(&self, cell: u32) -> PyResult<bool> {
        self.0.is_reached(cell).map_err(of_pvs)
    }

    /// Returns True if the result contains cell-to-cell visibility.
    #[getter]
    fn has_pairs(&self) -> PyResult<bool> {
        Ok(self.0.cell_pairs().map_err(of_pvs)?.is_some())
    }

    /// Returns True if a point of one cell may see a point of the other cell.
    fn sees(&self, one: CellOrPoint, other: CellOrPoint) -> PyResult<bool> {
        self.0
            .sees(self.cell(&one)?, self.cell(&other)?)
            .map_err(of_pvs)
    }

    /// Returns True if a point of a cell may see a point of the box from `least` to `greatest`.
    fn sees_box(&self, of: CellOrPoint, least: [f32; 3], greatest: [f32; 3]) -> PyResult<bool> {
        self.0
            .sees_box(self.cell(&of)?, least, greatest)
            .map_err(of_pvs)
    }

    /// Returns the triangles to draw from a cell, or from the cell of a point, ascending.
    fn visible<'py>(
        &self,
        py: Python<'py>,
        of: CellOrPoint,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::visible)
    }

    /// Returns the triangles to draw that were neither seen nor proved hidden.
    fn undecided<'py>(
        &self,
        py: Python<'py>,
        of: CellOrPoint,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::undecided)
    }

    /// Returns the objects of the triangles to draw, ascending.
    fn visible_objects<'py>(
        &self,
        py: Python<'py>,
        of: CellOrPoint,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::visible_objects)
    }

    /// Returns the items to draw: triangles, clusters or objects, by the granularity of the result.
    fn visible_items<'py>(
        &self,
        py: Python<'py>,
        of: CellOrPoint,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::visible_items)
    }

    /// Returns the number of triangles to draw from each cell.
    #[getter]
    fn set_sizes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let sizes = py.detach(|| {
            (0..self.0.cells())
                .map(|cell| self.0.visible_count(cell))
                .collect::<Result<Vec<u32>, PvsError>>()
        });
        Ok(sizes.map_err(of_pvs)?.into_pyarray(py))
    }

    /// Returns the share of the view that each visible item covers, with a row for each of `visible_items`.
    /// Each row contains the mean share of all directions and the maximum from one viewpoint, both rounded up
    /// to a power of two. Returns None if the result has no contributions.
    fn contributions<'py>(
        &self,
        py: Python<'py>,
        of: CellOrPoint,
    ) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let Some(all) = self.0.contributions(self.cell(&of)?).map_err(of_pvs)? else {
            return Ok(None);
        };
        let rows: Vec<f64> = all
            .iter()
            .flat_map(|c| [c.mean()[1], c.greatest()[1]])
            .collect();
        rows.into_pyarray(py).reshape([all.len(), 2]).map(Some)
    }

    fn __repr__(&self) -> String {
        format!(
            "<sightline.Pvs: {} cells over {} triangles, method {}>",
            self.0.cells(),
            self.0.triangle_count(),
            self.0.method()
        )
    }
}
