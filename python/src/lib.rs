//! Results for Python: view cells, and what is visible from each, as numpy arrays.

use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArrayMethods as _};
use pyo3::create_exception;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use sightline_pvs::PvsError;

create_exception!(_sightline, Error, PyValueError, "A result that is refused.");

/// A cell: its number, or a point in it.
#[derive(FromPyObject)]
enum CellOrPoint {
    Cell(u32),
    Point([f32; 3]),
}

/// An opened result. Queries may come from several threads at a time.
#[pyclass(frozen, module = "sightline")]
struct Pvs(sightline_pvs::Pvs);

fn refused(e: PvsError) -> PyErr {
    match e {
        PvsError::NoCell { .. } => PyIndexError::new_err(e.to_string()),
        e => Error::new_err(e.to_string()),
    }
}

impl Pvs {
    fn cell(&self, of: &CellOrPoint) -> PyResult<u32> {
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
        py.detach(|| read(&self.0, cell, &mut ids)).map_err(refused)?;
        Ok(ids.into_pyarray(py))
    }
}

#[pymethods]
impl Pvs {
    /// Opens a file, or reads bytes, and checks all of it.
    #[new]
    fn new(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(bytes) = source.extract::<Vec<u8>>() {
            return py.detach(|| sightline_pvs::Pvs::from_bytes(bytes)).map(Self).map_err(refused);
        }
        let path: std::path::PathBuf = source.extract()?;
        py.detach(|| sightline_pvs::Pvs::open(path)).map(Self).map_err(refused)
    }

    /// Number of triangles of the scene.
    #[getter]
    fn triangles(&self) -> u32 {
        self.0.triangle_count()
    }

    /// How the sets were made: aggressive, exact, verified or portals.
    #[getter]
    fn method(&self) -> &str {
        self.0.method()
    }

    /// The description of the bake, as JSON text.
    #[getter]
    fn info_json(&self) -> &str {
        self.0.info_json()
    }

    /// The objects of the scene as (name, first triangle, number of triangles).
    #[getter]
    fn objects(&self) -> Vec<(String, u32, u32)> {
        self.0.objects().iter().map(|o| (o.name.clone(), o.first, o.count)).collect()
    }

    /// The boxes of all cells: least x, y, z, then greatest x, y, z in each row.
    #[getter]
    fn boxes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let cells = 0..self.0.cells();
        let all: Vec<f32> =
            cells.flat_map(|cell| self.0.cell_bounds(cell).unwrap_or_default().concat()).collect();
        all.into_pyarray(py).reshape([self.0.cells() as usize, 6])
    }

    /// Number of cells.
    fn __len__(&self) -> usize {
        self.0.cells() as usize
    }

    /// The cell that holds a point; None outside the view box.
    fn cell_of(&self, point: [f32; 3]) -> Option<u32> {
        self.0.find_cell(point)
    }

    /// Whether viewpoints are in a cell.
    fn is_reached(&self, cell: u32) -> PyResult<bool> {
        self.0.is_reached(cell).map_err(refused)
    }

    /// The triangles to draw from a cell, or from the cell of a point, ascending.
    fn visible<'py>(&self, py: Python<'py>, of: CellOrPoint) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::visible)
    }

    /// Those of them that were neither seen nor proved hidden.
    fn undecided<'py>(&self, py: Python<'py>, of: CellOrPoint) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::undecided)
    }

    /// The objects of the triangles to draw, ascending.
    fn visible_objects<'py>(&self, py: Python<'py>, of: CellOrPoint) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.set(py, &of, sightline_pvs::Pvs::visible_objects)
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

#[pymodule]
fn _sightline(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Pvs>()?;
    module.add("Error", module.py().get_type::<Error>())
}
