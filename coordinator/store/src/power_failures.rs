//! Schedules of the store and the blobs on a disk that loses power, fails and fills up. A schedule is a
//! function of its seed.
//!
//! Every acknowledged change exists after each restart, and no number is assigned twice. If the disk
//! misplaces a write, an acknowledged change may be lost. The start of the store then fails, or reading the
//! blob reports the damage.

use std::collections::BTreeMap;

use sightline_numbers::random::SplitMix64;
use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{CommitOutcome, NewJob, SceneRecord, TileResult, TileState, TileStats};

use super::blobs::{BlobError, Blobs as _};
use super::disk::simulated::Counts;
use super::error::{JournalError, StoreError};
use super::failing::{FailingDisk, Loss};
use super::{Queries as _, Store as _};

const TILES: u32 = 6;

struct World {
    random: SplitMix64,
    disk: FailingDisk,
    /// The acknowledged jobs and their keys.
    jobs: BTreeMap<u64, Digest>,
    /// The acknowledged outputs, and the bytes of their blobs.
    outputs: BTreeMap<(u64, u32), Vec<u8>>,
    /// The highest job number that a store has assigned, acknowledged or not.
    highest: u64,
    next_key: u64,
}

fn digest(bytes: &[u8]) -> Digest {
    *blake3::hash(bytes).as_bytes()
}

impl World {
    fn new(seed: u64) -> Self {
        Self {
            random: SplitMix64::named(&[seed, 8]),
            disk: FailingDisk::new(seed),
            jobs: BTreeMap::new(),
            outputs: BTreeMap::new(),
            highest: 0,
            next_key: 0,
        }
    }

    fn below(&mut self, n: u64) -> u64 {
        self.random.bits() % n.max(1)
    }

    /// Opens the store and the blobs, and checks that all acknowledged changes exist, apart from changes that
    /// a repair reports as lost. Then enables faults of the disk.
    fn start(&mut self) -> Result<(), String> {
        if let Some(loss) = self.disk.open()? {
            self.forget_lost(&loss)?;
        }
        self.check()?;
        self.disk.fail();
        Ok(())
    }

    /// Removes the jobs that a repair lost. Returns an error for a lost job that the repair did not report.
    fn forget_lost(&mut self, loss: &Loss) -> Result<(), String> {
        let Some((store, _)) = self.disk.get() else {
            return Ok(());
        };
        for job in self.jobs.keys().copied().collect::<Vec<_>>() {
            if store.job(JobId(job)).map_err(|e| e.to_string())?.is_none() {
                if !loss.names(job) {
                    return Err(format!("job {job} is lost and not named: {loss:?}"));
                }
                self.jobs.remove(&job);
                self.outputs.retain(|(owner, _), _| *owner != job);
            }
        }
        if loss.is_unmeasured {
            // Neither the journal's header nor a watermark survived, so the assigned numbers are unknown.
            self.highest = store
                .jobs()
                .map_err(|e| e.to_string())?
                .last()
                .map_or(0, |job| job.id.0);
        } else if !loss.is_loss {
            return Ok(());
        }
        let jobs = self.jobs.clone();
        self.outputs.retain(|(job, tile), _| {
            jobs.contains_key(job)
                && store
                    .tile(JobId(*job), TileIndex(*tile))
                    .is_ok_and(|tile| matches!(tile.state, TileState::Done { .. }))
        });
        Ok(())
    }

    fn check(&mut self) -> Result<(), String> {
        let Some((store, blobs)) = self.disk.get() else {
            return Ok(());
        };
        let text = |e: StoreError| e.to_string();
        for (job, key) in &self.jobs {
            match store.job(JobId(*job)).map_err(text)? {
                Some(found) if found.key == *key => {}
                other => return Err(format!("acknowledged job {job} became {other:?}")),
            }
        }
        for ((job, tile), bytes) in &self.outputs {
            let state = store
                .tile(JobId(*job), TileIndex(*tile))
                .map_err(text)?
                .state;
            let TileState::Done { digest: kept, .. } = state else {
                return Err(format!(
                    "the acknowledged output of tile {tile} of job {job} became {state:?}"
                ));
            };
            if kept != digest(bytes) {
                return Err(format!("tile {tile} of job {job} has another output"));
            }
            match blobs.read(&kept) {
                Ok(read) if read == *bytes => {}
                Ok(_) => return Err("a blob has other bytes than its digest".to_owned()),
                // A misplaced write may have hit this file.
                Err(BlobError::Damaged { .. } | BlobError::Missing { .. })
                    if self.disk.misdirects() => {}
                Err(e) => return Err(format!("the blob of tile {tile} of job {job}: {e}")),
            }
        }
        for job in store.jobs().map_err(text)? {
            self.highest = self.highest.max(job.id.0);
        }
        Ok(())
    }

    /// Runs a command; returns false if the store cannot continue.
    fn command(&mut self) -> Result<bool, String> {
        let pick = self.random.bits();
        let Some((store, blobs)) = self.disk.get() else {
            return Ok(false);
        };
        let outcome = match pick % 4 {
            0 => {
                let scene = SceneRecord {
                    digest: [7; 32],
                    bytes: 1,
                    triangles: 1,
                    objects: 1,
                    owners: Default::default(),
                };
                self.next_key += 1;
                let key = digest(&self.next_key.to_le_bytes());
                let new = NewJob {
                    key,
                    request_id: String::new(),
                    name: String::new(),
                    owner: String::new(),
                    user: String::new(),
                    priority: 0,
                    scene: [7; 32],
                    spec: vec![0; (pick >> 8) as usize % 600],
                    tiles: TILES,
                    submitted_at_ms: 1,
                };
                match store
                    .record_scene(scene)
                    .and_then(|()| store.submit_job(new))
                {
                    Ok(submitted) => {
                        let id = submitted.id.0;
                        if id <= self.highest {
                            return Err(format!("number {id} is given out again"));
                        }
                        self.highest = id;
                        self.jobs.insert(id, key);
                        Ok(())
                    }
                    Err(e) => Err(e),
                }
            }
            1 => store.begin_epoch().map(drop),
            _ => {
                let Some(job) = self
                    .jobs
                    .keys()
                    .copied()
                    .nth((pick >> 8) as usize % self.jobs.len().max(1))
                else {
                    return Ok(true);
                };
                let tile = (pick >> 40) as u32 % TILES;
                // All outputs of one tile are equal.
                let bytes =
                    format!("{job} {tile} ").repeat(1 + (job as usize * 31 + tile as usize) % 300);
                let bytes = bytes.into_bytes();
                match blobs.put(&bytes) {
                    Err(_) => return Ok(true),
                    Ok(digest) => {
                        let stats = TileStats {
                            worker: "w".to_owned(),
                            ..TileStats::default()
                        };
                        let result = TileResult {
                            digest,
                            bytes: bytes.len() as u64,
                            stats,
                        };
                        match store.commit_tile(JobId(job), TileIndex(tile), result) {
                            Ok(CommitOutcome::Conflict { .. }) => {
                                return Err(format!(
                                    "tile {tile} of job {job} conflicts with itself"
                                ));
                            }
                            Ok(_) => {
                                self.outputs.insert((job, tile), bytes);
                                Ok(())
                            }
                            Err(e) => Err(e),
                        }
                    }
                }
            }
        };
        Ok(match outcome {
            Ok(())
            | Err(StoreError::Journal(JournalError::NoSpace { .. } | JournalError::Write { .. })) => {
                true
            }
            // The state of the disk is unknown, so only a restart helps.
            Err(StoreError::Journal(JournalError::Unusable { .. })) => false,
            Err(e) => return Err(format!("a command failed otherwise: {e}")),
        })
    }
}

/// Runs a schedule.
fn run(seed: u64) -> Result<Counts, String> {
    let mut world = World::new(seed);
    for _ in 0..4 {
        world.start()?;
        for _ in 0..5 + world.below(40) {
            if !world.command()? {
                break;
            }
        }
        world.disk.close();
    }
    world.start()?;
    Ok(world.disk.counts())
}

fn schedules(first: u64, count: u64) {
    let mut all = Counts::default();
    for seed in first..first + count {
        match run(seed) {
            Ok(counts) => all.add(&counts),
            Err(what) => panic!("schedule {seed}: {what}"),
        }
    }
    println!("{all:?}");
    // Schedules without faults would test too little.
    if count >= 100 {
        assert!(all.power_failures > 0 && all.lost > 0 && all.full > 0 && all.misdirected > 0);
        assert!(all.failed_reads > 0 && all.failed_writes > 0 && all.failed_syncs > 0);
    }
}

#[test]
fn store_survives_five_hundred_schedules() {
    schedules(0, 500);
}

#[test]
#[ignore = "runs as many schedules as SIGHTLINE_SCHEDULES names; scripts/nightly.sh runs it"]
fn store_survives_many_schedules() {
    let number = |name: &str, default| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    schedules(
        number("SIGHTLINE_FIRST", 1 << 32),
        number("SIGHTLINE_SCHEDULES", 100_000),
    );
}
