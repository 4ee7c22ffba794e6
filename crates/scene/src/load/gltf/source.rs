//! The context of all modules of the glTF reader: the file, its folder and the limits.

use std::path::Path;

use crate::SceneError;
use crate::load::limits::{EXPORT_AGAIN, LoadLimits};

/// The extension that allows positions as integers.
pub(super) const QUANTIZATION: &str = "KHR_mesh_quantization";
/// The extensions of compressed buffer views. If a view has both, the first one is used.
pub(super) const MESHOPT: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];
/// The extension that hides nodes.
pub(super) const VISIBILITY: &str = "KHR_node_visibility";

/// The context of all modules of the glTF reader.
pub(super) struct GltfContext<'a> {
    pub(super) file: &'a str,
    pub(super) base_dir: Option<&'a Path>,
    pub(super) limits: &'a LoadLimits,
    /// True if the textures of masked materials are read.
    pub(super) alpha_textures: bool,
}

impl GltfContext<'_> {
    pub(super) fn bad(&self, element: impl Into<String>, reason: impl Into<String>) -> SceneError {
        SceneError::bad(self.file, element, reason, EXPORT_AGAIN)
    }
}
