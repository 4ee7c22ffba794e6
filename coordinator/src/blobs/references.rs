//! References from records to blobs.
//!
//! The references serve the removal of unreferenced blobs, and the check of a store that is not in use.

use std::collections::{BTreeMap, BTreeSet};
use std::time::SystemTime;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, JobState, TileState};
use sightline_store::{BlobError, Blobs, Queries, StoreError};

use crate::jobs::stored_spec;

/// A record or blob that could not be read or removed.
#[derive(Debug, thiserror::Error)]
pub enum KeepingError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blob store failed.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

/// The record that references a blob.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reference {
    /// The record of a scene.
    Scene,
    /// The record of a job whose result is the blob.
    Result(JobId),
    /// The record of a job whose specification references the blob, which contains viewpoints, boxes or
    /// receivers.
    Spec(JobId),
    /// The record of a tile whose output, or placeholder for an output, is the blob.
    Output(JobId, TileIndex),
}

/// Returns the blobs that records reference and that have to exist. A done job references its result instead
/// of the outputs of its tiles.
pub fn needed(store: &dyn Queries) -> Result<BTreeMap<Digest, Vec<Reference>>, StoreError> {
    let mut all: BTreeMap<Digest, Vec<Reference>> = BTreeMap::new();
    for scene in store.scenes()? {
        all.entry(scene.digest).or_default().push(Reference::Scene);
    }
    for job in store.jobs()? {
        if let JobState::Done { result, .. } = job.state {
            all.entry(result)
                .or_default()
                .push(Reference::Result(job.id));
        }
        for part in stored_spec::named(&job.spec) {
            all.entry(part).or_default().push(Reference::Spec(job.id));
        }
        for (tile, digest) in outputs(store, &job)? {
            all.entry(digest)
                .or_default()
                .push(Reference::Output(job.id, tile));
        }
    }
    Ok(all)
}

/// Returns the outputs that a job still needs. These are all outputs if the job has no result, or if it has
/// tiles set aside, which can be retried. Otherwise the job needs none.
fn outputs(store: &dyn Queries, job: &JobRecord) -> Result<Vec<(TileIndex, Digest)>, StoreError> {
    let mut outputs = Vec::new();
    let mut is_whole = true;
    for tile in store.tiles(job.id)? {
        match tile.state {
            TileState::Open => {}
            TileState::Done { digest, .. } => outputs.push((tile.tile, digest)),
            TileState::SetAside { digest, .. } => {
                is_whole = false;
                outputs.push((tile.tile, digest));
            }
        }
    }
    if job.state.phase() == JobPhase::Done && is_whole {
        outputs.clear();
    }
    Ok(outputs)
}

/// Removes the unreferenced blobs for whose write time `is_old` returns true. Returns their number and their
/// total size in bytes. `alone` runs a removal while no other thread adds a reference to a blob.
pub(crate) fn sweep(
    store: &dyn Queries,
    blobs: &dyn Blobs,
    is_old: &dyn Fn(&Digest, SystemTime) -> bool,
    alone: &dyn Fn(&mut dyn FnMut()),
) -> Result<(u64, u64), KeepingError> {
    let needed = needed(store)?;
    let mut old = BTreeMap::new();
    blobs.visit(&mut |stored| {
        if !needed.contains_key(&stored.digest) && is_old(&stored.digest, stored.written) {
            old.insert(stored.digest, stored.bytes);
        }
        true
    })?;
    let (mut count, mut sum) = (0, 0);
    for (digest, bytes) in old {
        let mut removed = Ok(false);
        alone(&mut || {
            // A client may have uploaded this blob again and be about to reference it, so check its time
            // again.
            removed = match blobs.written(&digest) {
                Ok(Some(written)) if is_old(&digest, written) => blobs.remove(&digest),
                Ok(_) => Ok(false),
                Err(e) => Err(e),
            };
        });
        if removed? {
            count += 1;
            sum += bytes;
        }
    }
    Ok((count, sum))
}

/// The result of a check of a store.
#[derive(Debug, Default)]
pub struct Verified {
    /// The number of scenes.
    pub scenes: u64,
    /// The number of jobs.
    pub jobs: u64,
    /// The number of existing blobs.
    pub blobs: u64,
    /// The total size of the existing blobs, in bytes.
    pub bytes: u64,
    /// The number of unreferenced blobs.
    pub unneeded: u64,
    /// The total size of the unreferenced blobs, in bytes.
    pub unneeded_bytes: u64,
    /// The referenced blobs that are absent or damaged, each with its references and the reason.
    pub lost: BTreeMap<Digest, (Vec<Reference>, String)>,
}

/// Reads every record and every blob. `progress` receives the number of bytes that were read.
///
/// # Errors
/// [`KeepingError`] if a record cannot be read, or the disk fails. A damaged blob is not an error.
pub fn verify(
    store: &dyn Queries,
    blobs: &dyn Blobs,
    progress: &dyn Fn(u64),
) -> Result<Verified, KeepingError> {
    let needed = needed(store)?;
    let mut found = Verified {
        scenes: store.scenes()?.len() as u64,
        jobs: store.jobs()?.len() as u64,
        ..Verified::default()
    };
    let mut present = BTreeSet::new();
    let mut all = Vec::new();
    blobs.visit(&mut |stored| {
        all.push(stored);
        true
    })?;
    for stored in all {
        found.blobs += 1;
        found.bytes += stored.bytes;
        if !needed.contains_key(&stored.digest) {
            found.unneeded += 1;
            found.unneeded_bytes += stored.bytes;
        } else {
            match blobs.open_checked(&stored.digest) {
                Ok(_) => drop(present.insert(stored.digest)),
                Err(e) if e.is_lost() => {
                    let needs = needed.get(&stored.digest).cloned().unwrap_or_default();
                    found.lost.insert(stored.digest, (needs, e.to_string()));
                }
                Err(e) => return Err(e.into()),
            }
        }
        progress(stored.bytes);
    }
    for (digest, needs) in needed {
        if !present.contains(&digest) && !found.lost.contains_key(&digest) {
            found
                .lost
                .insert(digest, (needs, "the blob is missing".to_owned()));
        }
    }
    Ok(found)
}

/// A function that reopens tiles of a job and returns the number of reopened tiles.
pub type Reopen<'a> = dyn FnMut(JobId, &[TileIndex]) -> Result<u32, StoreError> + 'a;

/// Reopens, with `reopen`, the tiles whose outputs or results are lost, and removes damaged blobs. Returns
/// the number of reopened tiles. Lost scenes and lost parts of specifications have to be uploaded again.
///
/// # Errors
/// [`KeepingError`] if the store or the blobs fail.
pub fn repair(
    blobs: &dyn Blobs,
    found: &Verified,
    reopen: &mut Reopen<'_>,
) -> Result<u64, KeepingError> {
    let mut tiles: BTreeMap<JobId, BTreeSet<TileIndex>> = BTreeMap::new();
    for (digest, (needs, _)) in &found.lost {
        blobs.remove(digest)?;
        for need in needs {
            match need {
                Reference::Output(job, tile) => drop(tiles.entry(*job).or_default().insert(*tile)),
                // `reopen` reopens all tiles of a done job, so one tile suffices.
                Reference::Result(job) => drop(tiles.entry(*job).or_default().insert(TileIndex(0))),
                Reference::Scene | Reference::Spec(_) => {}
            }
        }
    }
    let mut opened = 0;
    for (job, tiles) in tiles {
        let tiles: Vec<TileIndex> = tiles.into_iter().collect();
        opened += u64::from(reopen(job, &tiles)?);
    }
    Ok(opened)
}
