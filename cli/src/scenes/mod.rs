//! Commands about scenes.

pub mod generate;
pub mod mesh;
pub mod portals;
pub mod read;
pub mod tetra;
pub mod tetra_vtk;
