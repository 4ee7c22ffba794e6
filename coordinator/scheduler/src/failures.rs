//! Failing tiles: back-off after faults of machines and networks, and tiles that are set aside.

use sightline_records::ids::{JobId, Lease, TileIndex, WorkerId};

use super::event::{Effect, Failure, Note, StoreCommand};
use super::job::Output;
use super::messages::Now;
use super::state::{Scheduler, Timer};

/// The number of workers that a tile must fail on before it is set aside.
const WORKERS_TO_FAIL: u32 = 3;
/// The number of failures after which a tile is set aside, independent of the number of workers.
pub(super) const MAX_ATTEMPTS: u32 = 5;
/// The number of faults of machines and networks from which on each fault of a tile counts as a failure of
/// the tile.
const MAX_FAULTS: u32 = 12;
/// Maximum number of doublings of the wait after a fault of a machine or network. Each fault after the first
/// doubles the wait.
const MOST_DOUBLINGS: u32 = 6;

impl Scheduler {
    /// Counts the failure of a tile.
    pub(super) fn failed(&mut self, worker: WorkerId, failure: Failure, now: Now) {
        let Failure {
            lease,
            reason,
            infrastructure,
        } = failure;
        let Lease { job: id, tile, .. } = lease;
        if self
            .leases
            .table
            .get(&lease.id)
            .is_none_or(|l| (l.job, l.tile) != (id, tile))
        {
            return;
        }
        let checks = self.leases.table.get(&lease.id).is_some_and(|l| l.checks);
        self.end_lease(lease.id, false);
        self.tell_watchers(id);
        let name = self
            .roster
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

    /// Delays a tile after a fault: by about 1 s, doubled with each further fault, and with jitter.
    ///
    /// Because of the jitter, tiles that failed together are not retried together.
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

    /// Sets a tile aside if its failures, of which the store has just recorded one, are too many; otherwise
    /// lets workers try the tile again.
    ///
    /// `on` is the number of workers on which the tile has failed. `died` is true if this failure is a death.
    pub(super) fn judge(&mut self, id: JobId, tile: TileIndex, on: u32, died: bool, reason: &str) {
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
            // Set the dependent tiles aside first: if this is interrupted, the tile is still open and fails
            // again.
            let reason = match on {
                1 => format!("tile {tile} failed {attempts} times on one worker: {reason}"),
                _ => format!("tile {tile} failed on {on} workers: {reason}"),
            };
            let planned = std::sync::Arc::clone(&job.planned);
            self.effects.push(Effect::Run(StoreCommand::SetAside {
                job: id,
                planned,
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
