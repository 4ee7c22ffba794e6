//! Construction of the contents of a `.tets` file from a scene.

use sightline_scene::{Scene, SceneError};
use thiserror::Error;

use crate::cells::{CellCounts, Cells, CellsError, Tetrahedra, cells};
use crate::delaunay::{Delaunay, DelaunayError};
use crate::file::Contents;
use crate::point_query::Hierarchy;
use crate::surfaces::Surfaces;
use crate::watch::BuildObserver;
use crate::windings::windings;

/// The contents of a `.tets` file, in memory.
#[derive(Clone, Debug, Default)]
pub struct Built {
    /// The digest of the scene.
    pub digest: [u8; 32],
    /// The triangles of the scene, with corners as indices of distinct points.
    pub surfaces: Surfaces,
    /// The cells between the surfaces.
    pub cells: Cells,
    /// The number of closed solids around each cell.
    pub windings: Vec<i32>,
    /// The hierarchy of boxes over the triangles.
    pub hierarchy: Hierarchy,
    /// The number of Delaunay tetrahedra that were divided into the cells.
    pub tetrahedra: u64,
    /// Statistics about the construction of the cells.
    pub counts: CellCounts,
}

/// The reason why the cells of a scene could not be built.
#[derive(Debug, Error)]
pub enum BuildError {
    /// The scene has more triangles than the search for closed solids supports.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The Delaunay construction rejected the points of the scene, or the observer rejected its memory use.
    #[error(transparent)]
    Delaunay(#[from] DelaunayError),
    /// The cells could not be built from the tetrahedra.
    #[error(transparent)]
    Cells(#[from] CellsError),
}

impl Built {
    /// Returns borrowed views of all lists, as [`crate::file::write()`] requires them.
    pub fn contents(&self) -> Contents<'_> {
        Contents {
            digest: self.digest,
            surfaces: self.surfaces.view(),
            cells: self.cells.view(),
            windings: &self.windings,
            boxes: self.hierarchy.view(),
        }
    }
}

/// Fills the space between the surfaces of a scene with cells, and builds all other lists of a `.tets` file.
/// Reports the progress to `watch`.
///
/// # Errors
/// [`BuildError`] if the scene has too many triangles, or if its tetrahedra or cells cannot be built.
pub fn build(scene: &Scene, watch: &dyn BuildObserver) -> Result<Built, BuildError> {
    let surfaces = Surfaces::new(scene)?;
    let delaunay = Delaunay::watched(&surfaces.points, watch)?;
    let Delaunay {
        points,
        tetrahedra,
        neighbours,
    } = &delaunay;
    let (cells, counts) = cells(
        &surfaces,
        &Tetrahedra {
            points,
            tetrahedra,
            neighbours,
        },
        watch,
    )?;
    let tetrahedra = delaunay.tetrahedra.len() as u64;
    drop(delaunay);
    let windings = windings(surfaces.view(), cells.view());
    let hierarchy = Hierarchy::new(surfaces.view());
    Ok(Built {
        digest: scene.digest().0,
        surfaces,
        cells,
        windings,
        hierarchy,
        tetrahedra,
        counts,
    })
}
