//! The reader of scene files for commands, with the flags about kinds and sides.

use std::path::Path;
use std::sync::Arc;

use sightline::{Error, NamedResult, Scene, SceneSource, read_scene, read_scene_of};

use crate::args::kinds::KindArgs;
use crate::terminal::progress::Terminal;

/// Reads a scene file, and prints the warnings.
pub fn scene(path: &Path, kinds: &KindArgs) -> Result<Arc<Scene>, Error> {
    let source = SceneSource::File(path.to_owned());
    read_scene(&source, &kinds.options, &Terminal::new())
}

/// Reads the scene file of a result, with the flags of the user or otherwise the flags of the bake.
pub fn scene_of(
    path: &Path,
    kinds: &KindArgs,
    result: NamedResult<'_>,
) -> Result<Arc<Scene>, Error> {
    let source = SceneSource::File(path.to_owned());
    read_scene_of(&source, &kinds.options, result, &Terminal::new())
}
