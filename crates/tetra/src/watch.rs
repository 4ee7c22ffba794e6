//! Observers of builds of `.tets` files. An observer receives the progress and can reject the memory use.

/// A stage of a build of a `.tets` file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuildStage {
    /// Insertion of the scene's points as corners of tetrahedra, one point per unit.
    Points,
    /// Cutting of the tetrahedra through which triangles pass, one tetrahedron per unit.
    Cut,
    /// Conversion of the faces of tetrahedra to faces of cells, one tetrahedron per unit.
    Faces,
}

/// An observer of a build. Several threads call its methods.
pub trait BuildObserver: Sync {
    /// Receives the report that `_done` of `_total` units of a stage are done. The default ignores the
    /// report.
    fn done(&self, _stage: BuildStage, _done: u64, _total: u64) {}

    /// Receives the expected peak memory of the rest of the build, in bytes, and allows or rejects it. An
    /// error ends the build. The default allows any memory use.
    ///
    /// # Errors
    /// A message for the user if the build must not continue.
    fn needs(&self, _bytes: u64) -> Result<(), String> {
        Ok(())
    }
}

/// An observer that ignores the progress and allows any memory use.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quiet;

impl BuildObserver for Quiet {}
