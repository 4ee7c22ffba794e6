//! The conversion of scenes from Python: a path, or named parts with vertices and faces.

use std::path::PathBuf;

use glam::Vec3;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use sightline::SceneSource;
use sightline_scene::{Object, Triangle};

use crate::errors::InputError;

/// A part of a mesh: its name, its vertices, and the corners of its faces.
type Part<'py> = (
    String,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, i64>,
);

/// Converts a mesh in the form that `sightline._mesh.source` returns.
pub fn source(mesh: &Bound<'_, PyAny>) -> PyResult<SceneSource> {
    if let Ok(path) = mesh.extract::<PathBuf>() {
        return Ok(SceneSource::File(path));
    }
    let parts: Vec<Part<'_>> = mesh.extract()?;
    let (mut triangles, mut objects) = (Vec::new(), Vec::new());
    for (name, vertices, faces) in parts {
        let (vertices, faces) = (vertices.as_array(), faces.as_array());
        let first = number(triangles.len())?;
        let vertex = |at: &i64| {
            let row = usize::try_from(*at)
                .ok()
                .filter(|at| *at < vertices.nrows() && vertices.ncols() == 3);
            row.map(|at| Vec3::new(vertices[[at, 0]], vertices[[at, 1]], vertices[[at, 2]]))
        };
        for face in faces.rows() {
            let corners: Option<Vec<Vec3>> = face.iter().map(vertex).collect();
            let v = corners.and_then(|c| <[Vec3; 3]>::try_from(c).ok());
            let v = v.ok_or_else(|| {
                InputError::new_err(format!(
                    "{name}: a face does not consist of the numbers of three vertices"
                ))
            })?;
            triangles.push(Triangle { v });
        }
        objects.push(Object {
            name,
            first,
            count: number(faces.nrows())?,
        });
    }
    Ok(SceneSource::Triangles(triangles, objects))
}

fn number(n: usize) -> PyResult<u32> {
    u32::try_from(n).map_err(|_| InputError::new_err("the mesh has more than 4294967295 triangles"))
}
