//! A cache of checked blobs on the coordinator's disk, bounded in bytes, with least-recently-used eviction.
//! Every read checks the blob again. A lost copy costs only a download.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use sightline_records::ids::Digest;

use super::super::api::{BlobReader, Blobs as _};
use super::super::error::{BlobError, fault};
use super::super::files::{FileBlobs, FileWriter};

/// A directory of blobs with a maximum size.
pub(super) struct Cache {
    files: FileBlobs,
    most: u64,
    index: Mutex<Index>,
}

/// The blobs in the cache and the order of their last use.
#[derive(Default)]
struct Index {
    entries: BTreeMap<Digest, (u64, u64)>,
    by_use: BTreeMap<u64, Digest>,
    bytes: u64,
    uses: u64,
}

impl Index {
    fn forget(&mut self, digest: &Digest) {
        if let Some((bytes, used)) = self.entries.remove(digest) {
            self.by_use.remove(&used);
            self.bytes -= bytes;
        }
    }

    fn note(&mut self, digest: Digest, bytes: u64) {
        self.forget(&digest);
        self.uses += 1;
        self.entries.insert(digest, (bytes, self.uses));
        self.by_use.insert(self.uses, digest);
        self.bytes += bytes;
    }

    /// Removes entries until at most `most` bytes remain, least recently used first, and returns them.
    fn shrink(&mut self, most: u64) -> Vec<Digest> {
        let mut gone = Vec::new();
        while self.bytes > most {
            let Some(digest) = self.by_use.first_key_value().map(|(_, digest)| *digest) else {
                break;
            };
            self.forget(&digest);
            gone.push(digest);
        }
        gone
    }
}

impl Cache {
    /// Opens or creates the directory. If blobs of an earlier run exceed the bound, removes the oldest.
    ///
    /// # Errors
    /// An error if the directory cannot be created or listed.
    pub(super) fn open(directory: &Path, most: u64) -> Result<Self, BlobError> {
        let files = FileBlobs::open(directory)?;
        let mut found = Vec::new();
        for outer in folders(directory)? {
            for inner in folders(&outer)? {
                for entry in std::fs::read_dir(&inner).map_err(fault("list", &inner))? {
                    let entry = entry.map_err(fault("list", &inner))?;
                    let path = entry.path();
                    let metadata = entry.metadata().map_err(fault("look at", &path))?;
                    let Ok(digest) = blake3::Hash::from_hex(entry.file_name().as_encoded_bytes())
                    else {
                        continue;
                    };
                    let changed = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                    found.push((changed, Digest::from(digest), metadata.len()));
                }
            }
        }
        found.sort_unstable();
        let mut index = Index::default();
        found
            .into_iter()
            .for_each(|(_, digest, bytes)| index.note(digest, bytes));
        let cache = Self {
            files,
            most,
            index: Mutex::new(index),
        };
        cache.shrink();
        Ok(cache)
    }

    fn index(&self) -> MutexGuard<'_, Index> {
        // A wrong entry costs only a download or some bytes of the bound.
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the underlying files, for scratch files and for blobs that arrive.
    pub(super) fn files(&self) -> &FileBlobs {
        &self.files
    }

    /// Returns a checked blob if the cache contains it.
    pub(super) fn get(&self, digest: &Digest) -> Option<BlobReader> {
        if !self.index().entries.contains_key(digest) {
            return None;
        }
        match self.files.open_checked(digest) {
            Ok(reader) => {
                self.index().note(*digest, reader.length);
                Some(reader)
            }
            Err(e) => {
                if !matches!(e, BlobError::Missing { .. }) {
                    tracing::warn!(
                        "{e}; this blob was a copy, and is read from the object store again"
                    );
                }
                self.remove(digest);
                None
            }
        }
    }

    /// Stores a checked blob that was written to an unfinished file of the cache, and opens it. A blob larger
    /// than the bound is only opened.
    ///
    /// # Errors
    /// An error if the file cannot be opened or moved into place.
    pub(super) fn keep(
        &self,
        writer: FileWriter,
        digest: Digest,
        bytes: u64,
    ) -> Result<File, BlobError> {
        let file = File::open(writer.path()).map_err(fault("open", writer.path()))?;
        if bytes <= self.most {
            writer.place(Some(&digest), false)?;
            self.index().note(digest, bytes);
            self.shrink();
        }
        Ok(file)
    }

    /// Removes a blob.
    pub(super) fn remove(&self, digest: &Digest) {
        self.index().forget(digest);
        self.delete(digest);
    }

    fn shrink(&self) {
        let gone = self.index().shrink(self.most);
        gone.iter().for_each(|digest| self.delete(digest));
    }

    fn delete(&self, digest: &Digest) {
        if let Err(e) = self.files.remove(digest) {
            tracing::warn!("{e}; the copy takes space until it can be removed");
        }
    }
}

fn folders(directory: &Path) -> Result<Vec<std::path::PathBuf>, BlobError> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).map_err(fault("list", directory))? {
        let path = entry.map_err(fault("list", directory))?.path();
        if path.is_dir() && !path.ends_with("tmp") {
            found.push(path);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::super::super::api::BlobWriter as _;
    use super::*;

    fn put(cache: &Cache, bytes: &[u8]) -> Digest {
        let mut writer = cache.files().writer().unwrap();
        writer.append(bytes).unwrap();
        let digest = *blake3::hash(bytes).as_bytes();
        let mut read = Vec::new();
        cache
            .keep(writer, digest, bytes.len() as u64)
            .unwrap()
            .read_to_end(&mut read)
            .unwrap();
        assert_eq!(read, bytes);
        digest
    }

    #[test]
    fn cache_evicts_least_recently_used_and_misses_damaged_blobs() {
        let directory = tempfile::tempdir().unwrap();
        let cache = Cache::open(directory.path(), 100).unwrap();
        let [a, b] = [put(&cache, &[1; 40]), put(&cache, &[2; 40])];
        assert!(cache.get(&a).is_some());
        let c = put(&cache, &[3; 40]);
        assert!(cache.get(&a).is_some() && cache.get(&b).is_none() && cache.get(&c).is_some());
        let large = put(&cache, &[4; 101]);
        assert!(
            cache.get(&large).is_none() && cache.get(&a).is_some(),
            "it pushes nothing out"
        );
        std::fs::write(cache.files().path(&a), [7; 40]).unwrap();
        assert!(cache.get(&a).is_none() && !cache.files().path(&a).exists());
        // The next start counts existing blobs, and removes one if they exceed the bound.
        put(&cache, &[5; 40]);
        drop(cache);
        let cache = Cache::open(directory.path(), 50).unwrap();
        assert_eq!(cache.index().bytes, 40);
        assert_eq!(
            std::fs::read_dir(directory.path().join("tmp"))
                .unwrap()
                .count(),
            0
        );
    }
}
