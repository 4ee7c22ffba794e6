//! What of the stored blobs is needed: for the removal of the rest, and for the check of a store that is
//! not in use.

use std::collections::{BTreeMap, BTreeSet};
use std::time::SystemTime;

use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobPhase, JobRecord, JobState, TileState};
use sightline_store::{BlobError, Blobs, Queries, StoreError};

use crate::jobs::stored_spec;

/// Something that cannot be looked at.
#[derive(Debug, thiserror::Error)]
pub enum KeepingError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blobs failed.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

/// What a blob is needed for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reference {
    /// It is a scene.
    Scene,
    /// It is a job's result.
    Result(JobId),
    /// It is a large part of a job's specification, or its receivers.
    Spec(JobId),
    /// It is the output of a tile, or the stand-in for one.
    Output(JobId, TileIndex),
}

/// The blobs that records name and that have to be there. Outputs of a job that is done are in its result.
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

/// The outputs that a job still needs: all of a job without a result, and of one with tiles set aside,
/// which can be tried again.
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

/// Removes the blobs that no record names and whose time `is_old`; returns how many, and their bytes. `alone`
/// runs a removal while no other thread begins to need a blob.
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
            // Whoever has put it again since is going to name it.
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

/// What a check of a store has found.
#[derive(Debug, Default)]
pub struct Verified {
    /// Scenes, jobs and their tiles.
    pub scenes: u64,
    /// Jobs.
    pub jobs: u64,
    /// Blobs that are there, and their bytes.
    pub blobs: u64,
    /// Bytes of these.
    pub bytes: u64,
    /// Blobs that nobody needs, and their bytes.
    pub unneeded: u64,
    /// Bytes of these.
    pub unneeded_bytes: u64,
    /// Blobs that are needed and are absent or damaged, with what they are needed for.
    pub lost: BTreeMap<Digest, (Vec<Reference>, String)>,
}

/// Reads every record and every blob; `progress` is told the bytes that were read.
///
/// # Errors
/// When a record cannot be read, or the disk fails. A damaged blob is no error.
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
                .insert(digest, (needs, "it is missing".to_owned()));
        }
    }
    Ok(found)
}

/// A function that reopens tiles of a job, and returns their number.
pub type Reopen<'a> = dyn FnMut(JobId, &[TileIndex]) -> Result<u32, StoreError> + 'a;

/// Reopens the tiles whose outputs or results are lost, with `reopen`, and removes damaged blobs; returns the
/// number of tiles. Scenes and parts of specifications have to be sent again.
///
/// # Errors
/// The store's or the blobs'.
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
                // All of its tiles are opened, whichever is named.
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
