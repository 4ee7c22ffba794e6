//! The store of a simulated cluster. It is in memory, or the real store and blobs on a disk that fails.

use std::collections::BTreeMap;

use sightline_records::TileState;
use sightline_records::ids::JobId;
use sightline_store::failing::Loss;
use sightline_store::{BlobError, Blobs as _, JournalError, Store, StoreError};

use super::parts::{Ground, Refusal, SimulatedEvent, digest, output};
use super::world::World;

impl World {
    /// Returns the store, which is open while the coordinator runs.
    pub(super) fn store(&self) -> &dyn Store {
        match &self.ground {
            Ground::Memory(store) => store,
            Ground::Disk(disk) => &disk.get().expect("the store is open").0,
        }
    }

    /// Opens the store, and forgets the changes that a repair has lost.
    pub(super) fn open_store(&mut self) -> Result<(), String> {
        let Ground::Disk(disk) = &mut self.ground else {
            return Ok(());
        };
        let loss = disk.open()?;
        if let Some(loss) = loss {
            self.forget_lost(&loss)?;
        }
        Ok(())
    }

    /// Closes the store, because the coordinator's process ends or the power fails.
    pub(super) fn close_store(&mut self) {
        if let Ground::Disk(disk) = &mut self.ground {
            disk.close();
        }
    }

    /// Enables disk faults while faults are on.
    pub(super) fn begin_faults(&mut self) {
        let on = self.faults_on();
        if let Ground::Disk(disk) = &mut self.ground
            && on
        {
            disk.fail();
        }
    }

    /// Disables the faults of the disk.
    pub(super) fn end_faults(&mut self) {
        if let Ground::Disk(disk) = &self.ground {
            disk.heal();
        }
    }

    /// Fills the disk, or frees its space.
    pub(super) fn fill(&mut self, is_full: bool) {
        match &self.ground {
            Ground::Memory(_) => self.disk_full = is_full,
            Ground::Disk(disk) => disk.fill(is_full.then_some(0)),
        }
    }

    /// Ends the coordinator if an error of the store is final. Returns the consequence.
    ///
    /// # Errors
    /// The store's error, if no fault of a disk explains it.
    pub(super) fn refused(&mut self, e: &StoreError) -> Result<Refusal, String> {
        match e {
            StoreError::Journal(JournalError::NoSpace { .. } | JournalError::Write { .. }) => {
                Ok(Refusal::Later)
            }
            StoreError::Journal(JournalError::Unusable { .. }) => {
                self.stop_coordinator();
                self.after(300, SimulatedEvent::CoordinatorUp);
                Ok(Refusal::Ended)
            }
            e => Err(format!("the store refused: {e}")),
        }
    }

    /// Stores an output as a blob. Returns false if the disk fails.
    pub(super) fn keep(&self, bytes: &[u8]) -> bool {
        match &self.ground {
            Ground::Memory(_) => true,
            Ground::Disk(disk) => disk
                .get()
                .is_some_and(|(_, blobs)| blobs.put(bytes).is_ok()),
        }
    }

    /// Forgets the changes that a repair has lost. Returns an error for a lost job that the repair did not
    /// report.
    fn forget_lost(&mut self, loss: &Loss) -> Result<(), String> {
        for id in self.plans.keys().copied().collect::<Vec<JobId>>() {
            if self.store().job(id).map_err(|e| e.to_string())?.is_none() {
                if !loss.names(id.0) {
                    return Err(format!("job {id} is lost and not named: {loss:?}"));
                }
                self.plans.remove(&id);
                self.acknowledged.retain(|(job, _), _| *job != id);
            }
        }
        if loss.is_unmeasured {
            // The epochs that were begun are unknown, too.
            self.leased.clear();
        }
        if loss.is_loss || loss.is_unmeasured {
            let mut kept = BTreeMap::new();
            for ((job, tile), bytes) in std::mem::take(&mut self.acknowledged) {
                let state = self
                    .store()
                    .tile(job, tile)
                    .map_err(|e| e.to_string())?
                    .state;
                // A tile is open again, or has an earlier output again, because the change that opened it is
                // lost, too. Any other output must come from a worker with sound or broken memory.
                if let TileState::Done { digest: of, .. } = state {
                    if of == digest(&bytes) {
                        kept.insert((job, tile), bytes);
                    } else if ![false, true]
                        .iter()
                        .any(|broken| of == digest(&output(job, tile, *broken)))
                    {
                        return Err(format!(
                            "tile {tile} of job {job} has a foreign output: {of:?}"
                        ));
                    }
                }
            }
            self.acknowledged = kept;
        }
        Ok(())
    }

    /// Checks that the store has every acknowledged job and output, unchanged, with readable bytes.
    pub(super) fn nothing_is_lost(&self) -> Result<(), String> {
        for id in self.plans.keys() {
            if self.store().job(*id).map_err(|e| e.to_string())?.is_none() {
                return Err(format!("job {id} is lost"));
            }
        }
        for ((job, tile), bytes) in &self.acknowledged {
            let kept = self
                .store()
                .tile(*job, *tile)
                .map_err(|e| e.to_string())?
                .state;
            let digest = digest(bytes);
            if !matches!(&kept, TileState::Done { digest: d, .. } if *d == digest) {
                return Err(format!(
                    "the output of tile {tile} of job {job} is lost: {kept:?}"
                ));
            }
            let Ground::Disk(disk) = &self.ground else {
                continue;
            };
            match disk.get().map(|(_, blobs)| blobs.read(&digest)) {
                Some(Ok(read)) if read == *bytes => {}
                // A misplaced write may have hit this file.
                Some(Err(BlobError::Damaged { .. } | BlobError::Missing { .. }))
                    if disk.misdirects() => {}
                other => return Err(format!("the blob of tile {tile} of job {job}: {other:?}")),
            }
        }
        Ok(())
    }
}
