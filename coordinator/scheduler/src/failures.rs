//! Tiles that fail: back-off after faults of machines and networks, and tiles that are set aside.

use sightline_records::ids::{JobId, Lease, TileIndex, WorkerId};

use super::event::{Effect, Failure, Note, StoreCommand};
use super::job::Output;
use super::messages::Now;
use super::state::{Scheduler, Timer};

/// Different workers that a tile must fail on before it is set aside.
const WORKERS_TO_FAIL: u32 = 3;
/// Failures of one tile after which it is set aside, when fewer than three workers are there to try it.
pub(super) const MAX_ATTEMPTS: u32 = 5;
/// Faults of machines or networks after which the failures of a tile count against the tile.
const MAX_FAULTS: u32 = 12;
/// The wait after a first fault of a machine or network doubles with each further one, this many times at
/// most.
const MOST_DOUBLINGS: u32 = 6;

impl Scheduler {
    /// Counts a tile's failure.
    pub(super) fn failed(&mut self, worker: WorkerId, failure: Failure, now: Now) {
        let Failure {
            lease,
            reason,
            infrastructure,
        } = failure;
        let Lease { job: id, tile, .. } = lease;
        if self
            .leases
            .get(&lease.id)
            .is_none_or(|l| (l.job, l.tile) != (id, tile))
        {
            return;
        }
        let checks = self.leases.get(&lease.id).is_some_and(|l| l.checks);
        self.end_lease(lease.id, false);
        self.tell_watchers(id);
        let name = self
            .workers
            .get(&worker)
            .map(|w| w.name.clone())
            .unwrap_or_default();
        self.note(Note::TileFailed(lease, name.clone(), reason.clone()));
        if checks {
            self.check_failed(id, tile, now);
        }
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let t = &mut job.tiles[tile.at()];
        if t.output != Output::Open {
            return;
        }
        if infrastructure {
            t.faults += 1;
            if t.faults < MAX_FAULTS {
                self.back_off(id, tile, now);
                return;
            }
        }
        if !std::mem::replace(&mut t.judged, true) {
            self.effects.push(Effect::Run(StoreCommand::Fail {
                job: id,
                tile,
                worker: name,
                reason,
            }));
        }
        job.update_ready(tile);
        self.list_job(id);
    }

    /// Lets a tile wait, longer after each fault, and a different time for each tile: those that failed
    /// together are not tried again together.
    pub(super) fn back_off(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let jitter = 0.75 + 0.5 * self.random.unit_f64();
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let t = &mut job.tiles[tile.at()];
        let wait = 1000u64 << t.faults.saturating_sub(1).min(MOST_DOUBLINGS);
        let until = now.ms + (wait as f64 * jitter) as u64;
        t.not_before = Some(until);
        job.update_ready(tile);
        self.set_timer(until, Timer::Tile(id, tile));
        self.list_job(id);
    }

    /// Decides on a tile whose failure is recorded: on how many workers it has failed, and whether this one
    /// is a death.
    pub(super) fn judge(
        &mut self,
        id: JobId,
        tile: TileIndex,
        (on, died): (u32, bool),
        reason: &str,
    ) {
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(t) = job.tiles.get_mut(tile.at()) else {
            return;
        };
        t.judged = false;
        t.attempts += u32::from(!died);
        let attempts = t.attempts.saturating_add(t.deaths.len() as u32);
        if t.output == Output::Open && (on >= WORKERS_TO_FAIL || attempts >= MAX_ATTEMPTS) {
            let tiles = job.lost_with(tile);
            for lost in &tiles {
                job.tiles[lost.at()].judged = true;
                job.update_ready(*lost);
            }
            // The tiles that need it first: if this is interrupted half-way, the tile is still open and fails
            // again.
            let reason = match on {
                1 => format!("tile {tile} failed {attempts} times on one worker: {reason}"),
                _ => format!("tile {tile} failed on {on} workers: {reason}"),
            };
            let work = std::sync::Arc::clone(&job.work);
            self.effects.push(Effect::Run(StoreCommand::SetAside {
                job: id,
                work,
                tiles,
                reason,
            }));
        }
        if let Some(job) = self.jobs.get_mut(&id) {
            job.update_ready(tile);
        }
        self.set_orphan_aside(id, tile);
        self.list_job(id);
        self.tell_watchers(id);
    }
}
