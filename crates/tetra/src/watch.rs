//! Who follows long work: how far it is, and whether it may take so much memory.

/// A part of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Points become corners of tetrahedra.
    Points,
    /// Tetrahedra that triangles pass through are cut.
    Cut,
    /// The faces of tetrahedra become those of cells.
    Faces,
}

/// Follows the work. Called from several threads.
pub trait Watch: Sync {
    /// So much of a stage is done.
    fn done(&self, _stage: Stage, _done: u64, _total: u64) {}

    /// From here on the work is expected to have taken so many bytes at its peak. An error ends it.
    ///
    /// # Errors
    /// Why it may not go on.
    fn needs(&self, _bytes: u64) -> Result<(), String> {
        Ok(())
    }
}

/// Lets all work go on and tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quiet;

impl Watch for Quiet {}
