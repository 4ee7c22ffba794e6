//! Spot checks: another worker computes a share of the tiles again. If the bytes differ, a third worker
//! decides which answer was wrong.
//!
//! The scheduler draws a tile when it is done, and the job does not end before the check. A check is a lease
//! on a done tile, without helpers. The coordinator compares its output and does not store it. A helper of
//! the tile checks it only if there is no other worker. If two answers differ, all workers that contributed
//! to either are suspects. Until two answers are equal, suspects get only checks of other disputed tiles.
//! Then the scheduler quarantines the workers of the other answer, because the bytes do not show which of
//! them was wrong. A [`StoreCommand`] reopens the tiles that these workers committed after their last
//! confirmed results. If no other worker exists for 10 s, the job continues without the check, and the
//! coordinator's log states that. A job with two different answers waits for a third worker.

use std::collections::BTreeSet;

use sightline_numbers::random::SplitMix64;
use sightline_records::JobPhase;
use sightline_records::ids::{Digest, JobId, Lease, TileIndex, WorkerId};

use super::event::{Effect, Note, StoreCommand};
use super::job::{OpenJob, Output, Tile};
use super::messages::Now;
use super::pools::Profile;
use super::spot_check::{Name, Recomputation, SpotCheck};
use super::state::{Scheduler, Worker};

/// The time for which a job that only lacks a check waits for another worker, in milliseconds.
const LONELY: u64 = 10_000;
/// Maximum number of checks that are leased in one tick.
const MOST_AT_ONCE: usize = 64;
/// Maximum number of checks that are inspected before a worker gets a tile. Other checks wait for the next
/// tick.
const MOST_LOOKED_AT: usize = 256;
/// The number of failures after which a check is dropped while there is only one answer.
const MOST_TRIES: u32 = 3;
/// The base of the wait after a failed check, in milliseconds, and the maximum number of doublings. Each
/// failure, including the first, doubles the wait.
const AFTER_FAILURE: (u64, u32) = (1000, 6);

impl Scheduler {
    /// Decides with a random number if a done tile must be checked, and records the check.
    pub(super) fn draw(&mut self, id: JobId, tile: TileIndex, digest: Digest) {
        let share = self.settings.spot_check;
        let mut draw = SplitMix64::named(&[self.settings.spot_seed, id.0, u64::from(tile.0)]);
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        // With a time budget, two workers finish different amounts of work.
        let timed = job.planned.spec().time_budget().is_some();
        let Tile {
            author,
            contributors,
            ..
        } = &job.tiles[tile.at()];
        // The sender of an output under a lease of an earlier start is unknown.
        if timed || author.is_empty() || self.only.is_some() || draw.unit_f64() >= share {
            return;
        }
        let spot = SpotCheck::new(digest, Name::clone(author), contributors.clone());
        job.spots.insert(tile, spot);
        self.trust.spotted.insert((id, tile));
    }

    /// Handles an output that differs from the tile's output. The output's lease is not a check: two workers
    /// held leases on the tile.
    pub(super) fn differed(&mut self, lease: &Lease, digest: Digest) {
        let Lease { job: id, tile, .. } = *lease;
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        let Some(Output::Done(kept)) = job.tiles.get(tile.at()).map(|t| t.output) else {
            return;
        };
        if self.settings.spot_check <= 0.0 || job.planned.spec().time_budget().is_some() {
            return;
        }
        let Some(name) = job.given_to(lease.id.number, tile) else {
            return;
        };
        // The output of a quarantined worker proves no fault of others, and an unknown author cannot be
        // checked.
        if self.trust.quarantined.contains(&name) || job.tiles[tile.at()].author.is_empty() {
            return;
        }
        let Tile {
            author,
            contributors,
            ..
        } = &job.tiles[tile.at()];
        let first = SpotCheck::new(kept, Name::clone(author), contributors.clone());
        job.spots.entry(tile).or_insert(first);
        self.trust.spotted.insert((id, tile));
        self.take_answer(id, tile, digest, name);
    }

    /// Returns true if a worker with this signature gets no tiles, because it is quarantined or a suspect.
    pub(super) fn is_barred(&self, signature: &str) -> bool {
        self.trust.quarantined.contains(signature) || self.trust.suspects.contains_key(signature)
    }

    /// Returns the signatures of the quarantined workers.
    pub fn quarantined(&self) -> &BTreeSet<Name> {
        &self.trust.quarantined
    }

    /// Quarantines a worker: it gets no tiles, and its leases end.
    pub(super) fn quarantine(&mut self, name: &str) {
        self.trust.quarantined.insert(name.into());
        for id in self.of_signature(name) {
            let leases: Vec<_> = self
                .roster
                .workers
                .get(&id)
                .into_iter()
                .flat_map(|w| w.leases.clone())
                .collect();
            leases
                .into_iter()
                .for_each(|lease| self.end_lease(lease, true));
            self.call_back(id);
            self.list_worker(id);
        }
    }

    /// Restarts open tiles to which quarantined workers contributed, because their outcomes were removed.
    pub(super) fn swept(&mut self) {
        let mut tainted = Vec::new();
        for job in self.jobs.values_mut() {
            for tile in job
                .tiles
                .iter_mut()
                .filter(|tile| tile.output == Output::Open)
            {
                if tile
                    .contributors
                    .iter()
                    .any(|name| self.trust.quarantined.contains(name))
                {
                    tile.contributors.clear();
                    tainted.extend(tile.leases.into_iter().flatten());
                }
            }
        }
        tainted
            .into_iter()
            .for_each(|lease| self.end_lease(lease, true));
    }

    /// Ends the quarantine of a worker.
    pub(super) fn release(&mut self, name: &str) {
        self.trust.quarantined.remove(name);
        self.relist(name);
    }

    fn of_signature(&self, signature: &str) -> Vec<WorkerId> {
        self.roster
            .workers
            .iter()
            .filter(|(_, w)| *w.signature == *signature)
            .map(|(id, _)| *id)
            .collect()
    }

    fn relist(&mut self, name: &str) {
        self.of_signature(name)
            .into_iter()
            .for_each(|id| self.list_worker(id));
    }

    /// Leases checks to idle workers. Called on every tick.
    pub(super) fn grant_checks(&mut self, now: Now) {
        if self.time.paused_until.is_some() {
            return;
        }
        let spotted: Vec<(JobId, TileIndex)> = self.trust.spotted.iter().copied().collect();
        let mut granted = 0;
        for (id, tile) in spotted {
            // A job that was paused when only checks were left has no open tile whose grant would start it.
            // If all workers are suspects, no worker gets an open tile.
            let starts = |job: &OpenJob| {
                let is_disputed = job.spots.get(&tile).is_some_and(SpotCheck::is_disputed);
                (job.open() == 0 || is_disputed) && self.allowed(job)
            };
            if self.jobs.get(&id).is_some_and(starts) {
                self.start(id);
            }
            let Some((profile, spot)) = self.due(id, tile, now) else {
                continue;
            };
            let is_idle = self
                .queues
                .pools
                .by_profile
                .get(&profile)
                .is_some_and(|pool| !pool.hungry[0].is_empty());
            let is_last = self.jobs.get(&id).is_some_and(|job| job.open() == 0);
            if !is_idle && !is_last && !spot.is_disputed() {
                continue;
            }
            match self.checker(&profile, spot) {
                Some(worker) if granted < MOST_AT_ONCE => {
                    granted += 1;
                    self.grant(worker, id, tile, profile, now);
                    self.mark_check(id, tile);
                }
                Some(_) => return,
                None => self.look_for_others(id, tile, &profile, now),
            }
        }
    }

    /// Returns an idle worker that can check a tile. A suspect may check a tile about which the answers of
    /// other workers differ.
    fn checker(&self, profile: &Profile, spot: &SpotCheck) -> Option<WorkerId> {
        if !spot.is_disputed() {
            let mut hungry = self.queues.pools.by_profile.get(profile)?.hungry[0].iter();
            let may = |w: &&WorkerId| {
                self.roster
                    .workers
                    .get(w)
                    .is_some_and(|w| !spot.knows(&w.signature))
            };
            return hungry.find(may).copied();
        }
        let may = |w: &Worker| {
            let idle = w.wants > 0
                && w.leases.is_empty()
                && w.backpressured_until.is_none()
                && !w.unresponsive;
            idle && self.could_check(w, profile, spot)
        };
        self.roster
            .workers
            .iter()
            .find(|(_, w)| may(w))
            .map(|(id, _)| *id)
    }

    /// Returns true if a worker can check a tile once it is idle.
    fn could_check(&self, w: &Worker, profile: &Profile, spot: &SpotCheck) -> bool {
        let name = &*w.signature;
        let barred = if spot.is_disputed() {
            self.trust.quarantined.contains(name)
        } else {
            self.is_barred(name)
        };
        let asks = !w.unresponsive
            && w.backpressured_until.is_none()
            && (w.wants > 0 || !w.leases.is_empty());
        w.profiles.contains(profile) && asks && !w.draining && !barred && !spot.knows(name)
    }

    /// Leases a check that a job waits for to an idle worker, before the worker gets an open tile. Returns
    /// true if the worker got a check.
    pub(super) fn check_first(&mut self, worker: WorkerId, profile: &Profile, now: Now) -> bool {
        let Some(name) = self
            .roster
            .workers
            .get(&worker)
            .map(|w| Name::clone(&w.signature))
        else {
            return false;
        };
        let waits = |(id, tile): &&(JobId, TileIndex)| {
            let due = self
                .due(*id, *tile, now)
                .filter(|(spot_profile, spot)| spot_profile == profile && !spot.knows(&name));
            let is_last = self.jobs.get(id).is_some_and(|job| job.open() == 0);
            due.is_some_and(|(_, spot)| is_last || spot.is_disputed())
        };
        let Some((id, tile)) = self
            .trust
            .spotted
            .iter()
            .take(MOST_LOOKED_AT)
            .find(waits)
            .copied()
        else {
            return false;
        };
        self.grant(worker, id, tile, Profile::clone(profile), now);
        self.mark_check(id, tile);
        true
    }

    /// Returns the check of a tile and the profile of its job, or `None` if the tile has no check or the
    /// check cannot be leased now.
    fn due(&self, id: JobId, tile: TileIndex, now: Now) -> Option<(Profile, &SpotCheck)> {
        let job = self.jobs.get(&id)?;
        let spot = job.spots.get(&tile)?;
        let runs =
            job.record.state.phase() == JobPhase::Running && self.allowed(job) && !job.pending;
        // If needed tiles are open again, the tile must be computed from their new outputs.
        let own = &job.tiles[tile.at()];
        let ready = own.leases == [None; 2] && own.missing == 0;
        let free = ready && spot.not_before <= now.ms && !spot.condemned;
        let profile = job.record.profile.as_deref()?;
        (runs && free).then(|| (Profile::from(profile), spot))
    }

    /// Marks the lease on a done tile as a check.
    fn mark_check(&mut self, id: JobId, tile: TileIndex) {
        let leases = self
            .jobs
            .get(&id)
            .map(|job| job.tiles[tile.at()].leases)
            .unwrap_or_default();
        for lease in leases.into_iter().flatten() {
            if let Some(l) = self.leases.table.get_mut(&lease) {
                l.checks = true;
            }
        }
    }

    /// Decides on a check without an idle checker: waits, admits helpers, or continues without the check.
    fn look_for_others(&mut self, id: JobId, tile: TileIndex, profile: &Profile, now: Now) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let Some(spot) = job.spots.get(&tile) else {
            return;
        };
        let able = self
            .roster
            .workers
            .values()
            .any(|w| self.could_check(w, profile, spot));
        // No worker gets an open tile while disputes bar all workers.
        let may_work = |w: &Worker| {
            w.profiles.contains(profile) && !w.draining && !self.is_barred(&w.signature)
        };
        let waits = job.open() == 0 || !self.roster.workers.values().any(may_work);
        let with_helpers = SpotCheck {
            helpers_may: true,
            ..spot.clone()
        };
        let helped = |w: &Worker| self.could_check(w, profile, &with_helpers);
        let helpers_could = !spot.helpers_may && self.roster.workers.values().any(helped);
        let Some(spot) = self
            .jobs
            .get_mut(&id)
            .and_then(|job| job.spots.get_mut(&tile))
        else {
            return;
        };
        if able || !waits {
            spot.without_checker_since = None;
        } else if now
            .ms
            .saturating_sub(*spot.without_checker_since.get_or_insert(now.ms))
            < LONELY
        {
            // A checker may join or become idle.
        } else if helpers_could {
            spot.helpers_may = true;
        } else if spot.is_disputed() {
            if !std::mem::replace(&mut spot.told, true) {
                self.note(Note::NeedsThird(id, tile));
            }
        } else {
            self.leave_unchecked(id, tile, "no other worker is connected");
        }
    }

    /// Drops the check of a tile and logs the reason.
    fn leave_unchecked(&mut self, id: JobId, tile: TileIndex, why: &'static str) {
        self.forget_spot(id, tile);
        self.note(Note::Unchecked(id, tile, why));
        self.assemble_if_complete(id);
    }

    /// Removes a check from the lists, and the suspicions that came from it.
    fn forget_spot(&mut self, id: JobId, tile: TileIndex) {
        self.trust.spotted.remove(&(id, tile));
        if let Some(job) = self.jobs.get_mut(&id) {
            job.spots.remove(&tile);
        }
        self.clear_suspects(id, Some(tile));
    }

    /// Ends the suspicions that came from a tile, or from all tiles of a job.
    pub(super) fn clear_suspects(&mut self, id: JobId, tile: Option<TileIndex>) {
        let is_meant =
            |spot: &(JobId, TileIndex)| spot.0 == id && tile.is_none_or(|tile| spot.1 == tile);
        let mut free = Vec::new();
        self.trust.suspects.retain(|name, spots| {
            spots.retain(|spot| !is_meant(spot));
            if spots.is_empty() {
                free.push(Name::clone(name));
            }
            !spots.is_empty()
        });
        free.iter().for_each(|name| self.relist(name));
    }

    /// Counts a failure of a check on a worker.
    pub(super) fn check_failed(&mut self, id: JobId, tile: TileIndex, now: Now) {
        let Some(spot) = self
            .jobs
            .get_mut(&id)
            .and_then(|job| job.spots.get_mut(&tile))
        else {
            return;
        };
        spot.tries += 1;
        spot.not_before = now.ms + (AFTER_FAILURE.0 << spot.tries.min(AFTER_FAILURE.1));
        if spot.tries >= MOST_TRIES && !spot.is_disputed() {
            self.leave_unchecked(id, tile, "computing the tile again failed three times");
        }
    }

    /// Records the answer of a worker that has computed a tile again.
    pub(super) fn checked(&mut self, lease: &Lease, digest: Digest) {
        let held = self
            .leases
            .table
            .get(&lease.id)
            .filter(|l| (l.job, l.tile, l.checks) == (lease.job, lease.tile, true));
        let Some(worker) = held.map(|l| l.worker) else {
            return;
        };
        let name = self
            .jobs
            .get(&lease.job)
            .and_then(|job| job.given_to(lease.id.number, lease.tile));
        self.end_lease(lease.id, false);
        if let Some(w) = self.roster.workers.get(&worker) {
            debug_assert!(
                name.as_ref() == Some(&w.signature),
                "a lease has its worker's name"
            );
        }
        let Some(name) = name else { return };
        self.take_answer(lease.job, lease.tile, digest, name);
        self.tell_watchers(lease.job);
    }

    /// Compares an answer with the existing answers.
    fn take_answer(&mut self, id: JobId, tile: TileIndex, digest: Digest, name: Name) {
        let Some(spot) = self
            .jobs
            .get_mut(&id)
            .and_then(|job| job.spots.get_mut(&tile))
        else {
            return;
        };
        if spot.knows(&name) || spot.condemned {
            return;
        }
        let Some(at) = spot
            .answers
            .iter()
            .position(|answer| answer.digest == digest)
        else {
            let workers = BTreeSet::from([Name::clone(&name)]);
            spot.answers.push(Recomputation {
                digest,
                author: Name::clone(&name),
                workers,
            });
            let all: BTreeSet<Name> = spot
                .answers
                .iter()
                .flat_map(|a| a.workers.iter().cloned())
                .collect();
            self.note(Note::Differs(
                id,
                tile,
                all.iter().map(|name| name.to_string()).collect(),
            ));
            for name in all {
                self.trust
                    .suspects
                    .entry(Name::clone(&name))
                    .or_default()
                    .insert((id, tile));
                self.relist(&name);
            }
            return;
        };
        let mut right = spot.answers[at].workers.clone();
        right.insert(Name::clone(&name));
        let others = spot.answers.iter().enumerate().filter(|(n, _)| *n != at);
        let wrong: BTreeSet<Name> = others
            .flat_map(|(_, answer)| answer.guilty(&right))
            .collect();
        let kept_is_right = at == 0;
        spot.condemned = !kept_is_right;
        if kept_is_right {
            self.forget_spot(id, tile);
            let command = StoreCommand::Confirm {
                job: id,
                tile,
                digest,
                worker: name.to_string(),
            };
            self.effects.push(Effect::Run(command));
            self.note(Note::Agrees(id, tile, name.to_string()));
        } else {
            self.clear_suspects(id, Some(tile));
        }
        if !wrong.is_empty() {
            wrong.iter().for_each(|name| self.quarantine(name));
            let reason = format!(
                "the worker's bytes for tile {tile} of job {id} differ from the bytes of two other workers"
            );
            let workers = wrong.iter().map(|name| name.to_string()).collect();
            let condemned = (!kept_is_right).then_some((id, tile));
            self.effects.push(Effect::Run(StoreCommand::Quarantine {
                workers,
                condemned,
                reason,
            }));
        }
        self.assemble_if_complete(id);
    }

    /// Sends the rejected quarantine commands to the store again.
    pub(super) fn ask_again(&mut self) {
        if self.time.paused_until.is_none() {
            let refused = std::mem::take(&mut self.trust.refused);
            self.effects.extend(refused.into_iter().map(Effect::Run));
        }
    }
}
