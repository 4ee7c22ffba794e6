//! The store and the blobs on a simulated disk that loses power, fails and fills up, for simulators.

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

use sightline_numbers::random::SplitMix64;

use super::blobs::FileBlobs;
pub use super::disk::simulated::Counts;
use super::disk::simulated::{Faults, SimulatedDisk};
use super::error::{JournalError, StoreError};
use super::salvage;
use super::sled_store::SledStore;

const STATE: &str = "/data/state";
const BLOBS: &str = "/data/blobs";

/// A simulated disk with a store and blobs, which are open between [`FailingDisk::open`] and
/// [`FailingDisk::close`].
pub struct FailingDisk {
    random: SplitMix64,
    disk: SimulatedDisk,
    misdirects: bool,
    /// True after the disk has changed a bit. A schedule changes at most one bit.
    is_flipped: bool,
    open: Option<(SledStore, FileBlobs)>,
}

/// The acknowledged changes that a repair may have lost.
#[derive(Clone, Debug)]
pub struct Loss {
    /// True if no watermark is left to measure the loss.
    pub is_unmeasured: bool,
    /// True if acknowledged changes are lost.
    pub is_loss: bool,
    /// The numbers of the lost jobs.
    pub jobs: Option<RangeInclusive<u64>>,
}

impl Loss {
    /// Returns true if the repair reported that this job may be lost.
    pub fn names(&self, job: u64) -> bool {
        self.is_unmeasured || self.jobs.as_ref().is_some_and(|jobs| jobs.contains(&job))
    }
}

impl FailingDisk {
    /// Creates an empty disk. One disk in three misplaces a write.
    pub fn new(seed: u64) -> Self {
        let mut random = SplitMix64::named(&[seed, 7]);
        let misdirects = random.bits().is_multiple_of(3);
        Self {
            random,
            disk: SimulatedDisk::new(seed),
            misdirects,
            is_flipped: false,
            open: None,
        }
    }

    fn below(&mut self, n: u64) -> u64 {
        self.random.bits() % n.max(1)
    }

    /// Returns true if the disk itself may change bytes.
    pub fn misdirects(&self) -> bool {
        self.misdirects
    }

    /// Returns the numbers of faults that happened.
    pub fn counts(&self) -> Counts {
        self.disk.counts()
    }

    /// Returns the store and the blobs while they are open.
    pub fn get(&self) -> Option<&(SledStore, FileBlobs)> {
        self.open.as_ref()
    }

    /// Opens the store and the blobs, without faults. Repairs a damaged journal and then returns the loss.
    ///
    /// # Errors
    /// The reason why the store or the blobs cannot be opened.
    pub fn open(&mut self) -> Result<Option<Loss>, String> {
        self.heal();
        let blobs = FileBlobs::open_on(Arc::new(self.disk.clone()), Path::new(BLOBS), "tmp");
        let blobs = blobs.map_err(|e| e.to_string())?;
        let open = || SledStore::open_on(Arc::new(self.disk.clone()), Path::new(STATE));
        let (store, loss) = match open() {
            Ok(store) => (store, None),
            Err(StoreError::Journal(JournalError::Damaged { .. })) if self.misdirects => {
                let path = Path::new(STATE).join("journal");
                let found = salvage::read(&self.disk, &path, None).map_err(|e| e.to_string())?;
                let damage = found
                    .damage
                    .clone()
                    .ok_or("a refused journal has no damage")?;
                salvage::replace(&self.disk, &path, found).map_err(|e| e.to_string())?;
                let jobs = damage.lost_jobs.map(|(first, last)| first.0..=last.0);
                let loss = Loss {
                    is_unmeasured: damage.is_unmeasured,
                    is_loss: damage.is_loss,
                    jobs,
                };
                (open().map_err(|e| e.to_string())?, Some(loss))
            }
            Err(e) => return Err(format!("the store does not start: {e}")),
        };
        self.open = Some((store, blobs));
        Ok(loss)
    }

    /// Enables random faults: of reads, writes and syncs, and a lack of space.
    pub fn fail(&mut self) {
        let faults = Faults {
            read: if self.below(4) == 0 { 60 } else { 0 },
            write: if self.below(4) == 0 { 60 } else { 0 },
            sync: if self.below(4) == 0 { 60 } else { 0 },
            misdirected: if self.misdirects && !self.is_flipped {
                40
            } else {
                0
            },
        };
        self.disk.set_faults(faults);
        if self.below(3) == 0 {
            let room = self.below(6000);
            self.disk.set_room(Some(room));
        }
    }

    /// Sets the number of bytes that still fit on the disk, or removes the bound.
    pub fn fill(&self, room: Option<u64>) {
        self.disk.set_room(room);
    }

    /// Disables all faults.
    pub fn heal(&self) {
        self.disk.set_faults(Faults::default());
        self.disk.set_room(None);
    }

    /// Closes the store and the blobs: the process is killed, or the power fails.
    ///
    /// In some schedules the disk changes one bit, unless it has misplaced a write. After a power failure the
    /// watermark lacks the most recent commits, so a damaged last frame looks like an unfinished frame. The
    /// store cannot distinguish the two cases, so a faulty disk lets the store become idle first.
    pub fn close(&mut self) {
        let misplaced = self.disk.counts().misdirected;
        let is_sound = self.misdirects && !self.is_flipped && misplaced == 0;
        let flips = is_sound && self.below(4) == 0;
        if flips || misplaced > 0 {
            self.disk.settle(&Path::new(STATE).join("journal.mark"));
        }
        let is_killed = self.below(3) == 0;
        if !is_killed {
            self.disk.power_off();
        }
        drop(self.open.take());
        self.disk.power_on();
        if flips {
            self.is_flipped = self.disk.flip_bit();
        }
    }
}
