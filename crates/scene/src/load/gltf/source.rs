//! The context of all parts of the reader: the file, its folder and the limits.

use std::path::Path;

use crate::SceneError;
use crate::load::limits::{EXPORT_AGAIN, Limits};

/// Integer positions.
pub(super) const QUANTIZATION: &str = "KHR_mesh_quantization";
/// Compressed buffer views; of two in one view the first counts.
pub(super) const MESHOPT: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];
/// Hidden nodes.
pub(super) const VISIBILITY: &str = "KHR_node_visibility";

/// The context of all parts of the reader.
pub(super) struct GltfContext<'a> {
    pub(super) file: &'a str,
    pub(super) base_dir: Option<&'a Path>,
    pub(super) limits: &'a Limits,
    /// Whether the textures of masked materials are read.
    pub(super) alpha_textures: bool,
}

impl GltfContext<'_> {
    pub(super) fn bad(&self, element: impl Into<String>, reason: impl Into<String>) -> SceneError {
        SceneError::bad(self.file, element, reason, EXPORT_AGAIN)
    }
}
