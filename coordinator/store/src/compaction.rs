//! Compaction of the journal: the current entries replace the events that led to them.
//!
//! The new journal is written next to the old one, synced, and moved into its place. A crash leaves one of
//! the two journals. The next start rebuilds the view from the remaining journal.

use std::path::Path;

use super::disk::Disk;
use super::entries::Entry;
use super::error::StoreError;
use super::journal::{Journal, Numbers};
use super::rules::StateChange;

/// Maximum length of the texts in a frame before the next entry starts a new frame, in bytes.
const FRAME_BYTES: usize = 1 << 20;
/// Minimum length of a journal that is compacted, in bytes.
const SHORT: u64 = 32 << 20;
/// Minimum ratio of a journal's length to the length of its entries for a compaction at the start.
const TIMES: u64 = 8;

/// Returns true if a journal of this length is worth compacting.
pub(super) fn is_worth(journal: u64, entries: &[Entry]) -> bool {
    let live: u64 = entries
        .iter()
        .map(|e| (e.key.len() + e.value.len()) as u64)
        .sum();
    journal > SHORT && journal / TIMES > live
}

/// Writes a journal of these entries in place of the journal at `path`. Returns its length in bytes.
pub(super) fn replace(
    disk: &dyn Disk,
    path: &Path,
    entries: &[Entry],
    numbers: Numbers,
) -> Result<u64, StoreError> {
    let mut journal = Journal::begin(disk, &path.with_extension("compact"))?;
    let mut written = entries.iter().map(Entry::written).peekable();
    while written.peek().is_some() {
        let (mut frame, mut bytes) = (Vec::new(), 0);
        while let Some((key, value)) = written.next_if(|_| bytes < FRAME_BYTES) {
            bytes += key.len() + value.len();
            frame.push((key, value));
        }
        let payload = serde_json::to_vec(&[StateChange::Imported { entries: frame }]);
        journal.append(
            &payload.map_err(|e| StoreError::View {
                what: e.to_string(),
            })?,
            numbers,
        )?;
    }
    Ok(journal.install(disk, path, numbers)?)
}

#[cfg(test)]
mod tests {
    use super::super::{Queries as _, SledStore, Store as _};
    use super::*;
    use sightline_records::SceneRecord;

    fn scene(n: u8) -> SceneRecord {
        SceneRecord {
            digest: [n; 32],
            bytes: 1,
            triangles: 1,
            objects: 1,
            owners: Default::default(),
        }
    }

    #[test]
    fn compacted_store_keeps_entries_and_accepts_commands() {
        let directory = tempfile::tempdir().unwrap();
        let entries = {
            let store = SledStore::open(directory.path()).unwrap();
            (0..50).for_each(|n| store.record_scene(scene(n)).unwrap());
            for _ in 0..200 {
                store.begin_epoch().unwrap();
            }
            store.entries().unwrap()
        };
        let done = SledStore::compact(directory.path()).unwrap();
        assert!(done.to < done.from, "{done:?}");
        let store = SledStore::open(directory.path()).unwrap();
        assert_eq!(store.entries().unwrap(), entries);
        assert_eq!(store.begin_epoch().unwrap(), 201);
        store.record_scene(scene(99)).unwrap();
        drop(store);
        assert_eq!(
            SledStore::open(directory.path())
                .unwrap()
                .scenes()
                .unwrap()
                .len(),
            51
        );
        assert!(matches!(
            SledStore::compact(&directory.path().join("none")),
            Err(StoreError::Journal(_))
        ));
    }

    #[test]
    fn only_empty_store_imports_entries() {
        let directory = tempfile::tempdir().unwrap();
        let from = SledStore::open(&directory.path().join("from")).unwrap();
        (0..5).for_each(|n| from.record_scene(scene(n)).unwrap());
        let to = SledStore::open(&directory.path().join("to")).unwrap();
        let entries = from.entries().unwrap();
        to.import(entries[..2].to_vec(), true).unwrap();
        to.import(entries[2..].to_vec(), false).unwrap();
        assert_eq!(to.entries().unwrap(), entries);
        assert!(matches!(
            to.import(entries, true),
            Err(StoreError::NotEmpty)
        ));
    }

    #[test]
    fn compaction_overwrites_file_of_crashed_compaction() {
        let directory = tempfile::tempdir().unwrap();
        let store = SledStore::open(directory.path()).unwrap();
        store.record_scene(scene(1)).unwrap();
        drop(store);
        std::fs::write(directory.path().join("journal.compact"), b"half").unwrap();
        SledStore::compact(directory.path()).unwrap();
        assert_eq!(
            SledStore::open(directory.path()).unwrap().scenes().unwrap(),
            [scene(1)]
        );
    }
}
