//! From a scene to what a `.tets` file holds.

use sightline_scene::{Scene, SceneError};
use thiserror::Error;

use crate::cells::{Cells, CellsError, Counts, Tetrahedra, cells};
use crate::delaunay::{Delaunay, DelaunayError};
use crate::file::Contents;
use crate::look::Hierarchy;
use crate::surfaces::Surfaces;
use crate::watch::Watch;
use crate::windings::windings;

/// Everything that a `.tets` file holds, in memory.
#[derive(Clone, Debug, Default)]
pub struct Built {
    /// The digest of the scene.
    pub digest: [u8; 32],
    /// The surfaces.
    pub surfaces: Surfaces,
    /// The cells between them.
    pub cells: Cells,
    /// How many closed solids hold each cell.
    pub windings: Vec<i32>,
    /// The boxes over the triangles.
    pub hierarchy: Hierarchy,
    /// The number of Delaunay tetrahedra that cells are parts of.
    pub tetrahedra: u64,
    /// How the cells came about.
    pub counts: Counts,
}

/// Why a scene has no cells.
#[derive(Debug, Error)]
pub enum BuildError {
    /// The scene has too many triangles.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The points have no tetrahedra.
    #[error(transparent)]
    Delaunay(#[from] DelaunayError),
    /// The tetrahedra have no cells.
    #[error(transparent)]
    Cells(#[from] CellsError),
}

impl Built {
    /// The lists.
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

/// Fills the space between the surfaces of a scene with cells.
///
/// # Errors
/// [`BuildError`].
pub fn build(scene: &Scene, watch: &dyn Watch) -> Result<Built, BuildError> {
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
