//! The context of all parts of the reader: the file, its folder and the limits.

use std::path::Path;

use crate::SceneError;
use crate::load::limits::{EXPORT_AGAIN, Limits};

/// Integer positions.
pub(super) const QUANTIZATION: &str = "KHR_mesh_quantization";

/// The context of all parts of the reader.
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) base_dir: Option<&'a Path>,
    pub(super) limits: &'a Limits,
    /// Whether the textures of masked materials are read.
    pub(super) alpha_textures: bool,
}

impl Source<'_> {
    pub(super) fn bad(&self, element: impl Into<String>, reason: impl Into<String>) -> SceneError {
        SceneError::bad(self.file, element, reason, EXPORT_AGAIN)
    }
}
