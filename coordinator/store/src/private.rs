//! Directories that other users of the machine cannot read.

use std::path::Path;

/// Creates a directory and its missing parents for their owner only (mode 0700).
///
/// An existing directory keeps its mode.
pub(crate) fn create_private(directory: &Path) -> std::io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(directory)
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    use std::os::unix::fs::PermissionsExt as _;

    #[cfg(unix)]
    use super::super::{FileBlobs, OwnDirectory, SledStore};
    use super::*;

    #[test]
    #[cfg(unix)]
    fn store_creates_directories_for_owner_only() {
        let folder = tempfile::tempdir().unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let [store, blobs, own] = ["store", "blobs", "own"].map(|name| folder.path().join(name));
        drop(SledStore::open(&store.join("state")).unwrap());
        drop(FileBlobs::open(&blobs.join("blobs")).unwrap());
        drop(OwnDirectory::take(&own).unwrap());
        for path in [
            &store,
            &store.join("state"),
            &blobs,
            &blobs.join("blobs"),
            &own,
        ] {
            assert_eq!(mode(path), 0o700, "{}", path.display());
        }
        // A directory that a user created keeps its mode.
        std::fs::set_permissions(&own, std::fs::Permissions::from_mode(0o750)).unwrap();
        drop(OwnDirectory::take(&own).unwrap());
        assert_eq!(mode(&own), 0o750);
    }
}
