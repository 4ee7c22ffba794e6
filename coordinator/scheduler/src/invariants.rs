//! Checks that recompute the scheduler's lists and totals from its jobs, workers and leases.

use std::collections::{BTreeMap, BTreeSet};

use sightline_records::ids::{LeaseId, WorkerId};

use super::job::{OpenJob, Output};
use super::messages::Now;
use super::pools::List;
use super::queue::User;
use super::state::{Leased, Scheduler, Timer};

impl Scheduler {
    /// Returns the workers, the leases and the open jobs as text, for the message of a failed test.
    #[cfg(test)]
    pub fn state_text(&self) -> String {
        let mut out: Vec<String> = self
            .roster
            .workers
            .iter()
            .map(|(id, w)| format!("{id:?} {w:?}"))
            .collect();
        out.extend(
            self.leases
                .table
                .iter()
                .map(|(id, l)| format!("{id:?} {l:?}")),
        );
        for job in self.jobs.values() {
            let tiles = job
                .indices()
                .zip(&job.tiles)
                .filter(|(_, t)| t.output == Output::Open);
            out.push(format!(
                "{:?} spots {:?} ready {:?}",
                job.record, job.spots, job.ready
            ));
            out.push(format!(
                "assembling {} no space {:?}",
                job.assembling, job.no_space_until
            ));
            out.extend(tiles.map(|(tile, status)| format!("{tile:?} {status:?}")));
        }
        out.push(format!(
            "suspects {:?} quarantined {:?}",
            self.trust.suspects, self.trust.quarantined
        ));
        out.join("\n")
    }

    /// Compares all derived data with the data that it is derived from.
    ///
    /// # Errors
    /// The description of the first difference.
    pub fn check(&self) -> Result<(), String> {
        let ensure = |fine: bool, what: &str| fine.then_some(()).ok_or_else(|| what.to_owned());
        let mut held: BTreeMap<LeaseId, u32> = BTreeMap::new();
        for job in self.jobs.values() {
            self.check_job(job)?;
            job.tiles
                .iter()
                .flat_map(|t| t.leases)
                .flatten()
                .for_each(|l| *held.entry(l).or_default() += 1);
            for tile in job
                .indices()
                .filter(|t| job.tiles[t.at()].leases != [None; 2])
            {
                let open = job.tiles[tile.at()].output == Output::Open;
                ensure(
                    open || job.spots.contains_key(&tile),
                    "a tile with an output is leased",
                )?;
                ensure(
                    !job.record.state.phase().ended(),
                    "a job that has ended has leases",
                )?;
            }
        }
        ensure(held.values().all(|n| *n == 1), "a lease is on two tiles")?;
        ensure(
            held.keys().eq(self.leases.table.keys()),
            "the tiles' leases are not those of the list",
        )?;
        for (id, l) in &self.leases.table {
            ensure(
                self.time.timers.contains(&(l.timer, Timer::Lease(*id))),
                "a lease has no timer",
            )?;
            ensure(
                self.roster
                    .workers
                    .get(&l.worker)
                    .is_some_and(|w| w.leases.contains(id))
                    == l.gone.is_none(),
                "a lease's worker does not hold it",
            )?;
        }
        for (worker, missing) in &self.deaths.missing {
            let held = |l: &Leased| l.worker == *worker && l.gone.is_some();
            ensure(
                self.leases.table.get(&missing.lease.id).is_some_and(held),
                "a missing worker's lease has ended",
            )?;
        }
        for (id, w) in &self.roster.workers {
            ensure(
                w.leases.iter().all(|l| self.leases.table[l].worker == *id),
                "a worker holds another's lease",
            )?;
            self.check_worker(*id)?;
        }
        for pool in self.queues.pools.by_profile.values() {
            let ready: usize = pool
                .jobs
                .all()
                .map(|(_, id)| self.jobs[id].ready.len())
                .sum();
            ensure(ready == pool.ready, "a pool's ready tiles are miscounted")?;
            ensure(
                pool.begun.iter().all(|(at, id)| {
                    self.leases
                        .table
                        .get(id)
                        .is_some_and(|l| l.begun == Some(*at))
                }),
                "a pool's list of begun tiles is stale",
            )?;
            ensure(
                pool.waiting
                    .iter()
                    .all(|(_, _, id)| self.leases.table.get(id).is_some_and(|l| l.waits)),
                "a pool's list of waiting tiles is stale",
            )?;
        }
        let spots = self
            .jobs
            .iter()
            .flat_map(|(id, job)| job.spots.keys().map(|tile| (*id, *tile)));
        ensure(
            spots.eq(self.trust.spotted.iter().copied()),
            "the list of checks is not that of the jobs",
        )?;
        self.check_crews()?;
        self.check_shares()?;
        self.check_work_conservation()
    }

    /// Checks after a tick that every expired lease has ended.
    ///
    /// # Errors
    /// The description of an expired lease that exists.
    pub fn check_expiries(&self, now: Now) -> Result<(), String> {
        let over = |l: &&Leased| self.deadline(l).0 < now.ms && self.time.patient_until <= now.ms;
        match self.leases.table.values().find(over) {
            Some(l) => Err(format!(
                "a lease on tile {} of job {} should have ended",
                l.tile, l.job
            )),
            None => Ok(()),
        }
    }

    fn check_job(&self, job: &OpenJob) -> Result<(), String> {
        let ensure = |fine: bool, what: &str| {
            fine.then_some(())
                .ok_or_else(|| format!("job {}: {what}", job.record.id))
        };
        let ready: BTreeSet<_> = job.indices().filter(|t| job.is_ready(*t)).collect();
        ensure(ready == job.ready, "the ready tiles are others")?;
        let count =
            |f: &dyn Fn(&Output) -> bool| job.tiles.iter().filter(|t| f(&t.output)).count() as u32;
        ensure(
            count(&|o| matches!(o, Output::Done(_))) == job.done,
            "done tiles",
        )?;
        ensure(
            count(&|o| matches!(o, Output::SetAside(_))) == job.set_aside,
            "tiles set aside",
        )?;
        let leases: Vec<_> = self
            .leases
            .table
            .values()
            .filter(|l| l.job == job.record.id)
            .collect();
        ensure(leases.len() as u32 == job.running, "leases")?;
        ensure(
            leases.iter().map(|l| l.cells).sum::<u64>() == job.running_cells,
            "cells of leased tiles",
        )?;
        ensure(
            leases.iter().map(|l| l.samples).sum::<u64>() == job.running_samples,
            "samples",
        )?;
        for (tile, planned_tile) in job.tiles.iter().zip(&job.planned.plan().tiles) {
            let open = |n: &&u32| !matches!(job.tiles[**n as usize].output, Output::Done(_));
            ensure(
                planned_tile.needs.iter().filter(open).count() as u32 == tile.missing,
                "needed tiles",
            )?;
        }
        let listed = match &job.listed {
            Some((List::Bound(p), n)) => {
                *n == job.ready.len()
                    && self
                        .queues
                        .pools
                        .by_profile
                        .get(p)
                        .is_some_and(|pool| pool.jobs.has(&job.key, &job.record.id))
            }
            Some((List::Unbound(c), _)) => self.queues.pools.unbound[*c].contains(&job.place()),
            None => {
                let bound = job.record.profile.is_some() || !job.pending;
                !(self.allowed(job)
                    && !job.ready.is_empty()
                    && !job.grace
                    && job.parked.is_none()
                    && bound)
            }
        };
        ensure(listed, "it is in the wrong list")
    }

    fn check_worker(&self, id: WorkerId) -> Result<(), String> {
        let w = &self.roster.workers[&id];
        let fit = !w.draining && !self.is_barred(&w.signature);
        let hungry = fit && w.wants > 0 && w.backpressured_until.is_none() && !w.unresponsive;
        let idle = w.leases.is_empty();
        let fine = w.profiles.iter().all(|p| {
            self.queues.pools.by_profile.get(p).is_some_and(|pool| {
                pool.idle.contains(&id) == (idle && fit)
                    && pool.hungry[0].contains(&id) == (hungry && idle)
                    && pool.hungry[1].contains(&id) == (hungry && !idle)
                    && pool.helpers.contains(&id)
                        == (hungry && idle && w.can_help && w.helps.is_none())
            })
        });
        fine.then_some(())
            .ok_or_else(|| format!("worker {} is in the wrong lists", id.0))
    }

    /// Checks the lease and the helpers of every crew. Also checks that no crew lacks an available helper.
    fn check_crews(&self) -> Result<(), String> {
        let ensure = |fine: bool, what: &str| fine.then_some(()).ok_or_else(|| what.to_owned());
        for (id, crew) in &self.queues.crews {
            ensure(self.is_leased(&crew.lease), "a crew has no lease")?;
            let helpers = crew.helpers.len();
            // Workers that helped an earlier crew of this lease are still returning.
            let helps = |w: &WorkerId| {
                self.roster
                    .workers
                    .get(w)
                    .is_some_and(|w| w.helps == Some(crew.lease))
            };
            ensure(
                crew.helpers.keys().all(helps),
                "a crew has a helper who does not know it",
            )?;
            let pool = self.queues.pools.by_profile.get(&crew.profile);
            ensure(
                pool.is_some_and(|p| p.crews.has(&crew.key, &(helpers, *id))),
                "a crew is in no list",
            )?;
        }
        let listed: usize = self
            .queues
            .pools
            .by_profile
            .values()
            .map(|p| p.crews.all().count())
            .sum();
        let counted: usize = self
            .queues
            .pools
            .by_profile
            .values()
            .map(|p| p.crew_count)
            .sum();
        let fine = listed == self.queues.crews.len() && counted == listed;
        ensure(fine, "a crew that has ended is in a list")?;
        let wasted = |p: &super::pools::Pool| p.crew_with_room().is_some() && !p.helpers.is_empty();
        let paused = self.time.paused_until.is_some();
        ensure(
            paused || !self.queues.pools.by_profile.values().any(wasted),
            "a crew could have another helper",
        )?;
        // Helpers that were called back for a tile cannot move.
        let called = self
            .roster
            .workers
            .values()
            .any(|w| w.helps.is_some() && (!w.leases.is_empty() || w.draining));
        let uneven = self.queues.pools.by_profile.values().any(|p| {
            let few = p.crew_with_room().map(|(turn, _)| turn.0);
            let many = p.crews.richest(|crew| crew.0 > 0).map(|(turn, _)| turn.0);
            few.zip(many).is_some_and(|(few, many)| many > few)
        });
        ensure(
            paused || called || !uneven,
            "a crew of lower priority has helpers",
        )
    }

    /// Checks every user's share, and that the lists are ordered by the shares.
    fn check_shares(&self) -> Result<(), String> {
        let mut workers: BTreeMap<&User, (u32, u32)> = BTreeMap::new();
        self.jobs
            .values()
            .for_each(|job| workers.entry(&job.key.user).or_default().0 += 1);
        let leased = self.leases.table.values().map(|l| (l.job, 1));
        let helped = self
            .queues
            .crews
            .values()
            .map(|crew| (crew.lease.job, crew.helpers.len() as u32));
        for (job, n) in leased.chain(helped) {
            workers.entry(&self.jobs[&job].key.user).or_default().1 += n;
        }
        let counted = workers
            .iter()
            .map(|(user, (jobs, workers))| (*user, *jobs, *workers));
        let kept = self
            .queues
            .accounts
            .iter()
            .map(|(user, a)| (user, a.jobs, a.share.workers));
        if !counted.eq(kept) {
            return Err("the users' shares are miscounted".to_owned());
        }
        let ordered = |p: &super::pools::Pool| {
            p.jobs.is_in_order(|user| self.share(user))
                && p.crews.is_in_order(|user| self.share(user))
        };
        let fine = self.queues.pools.by_profile.values().all(ordered);
        fine.then_some(())
            .ok_or_else(|| "a list is not in the order of the users' shares".to_owned())
    }

    /// Checks that no worker is idle while a tile that it could compute is ready.
    fn check_work_conservation(&self) -> Result<(), String> {
        if self.time.paused_until.is_some() {
            return Ok(());
        }
        for (profile, pool) in &self.queues.pools.by_profile {
            let waits_for_store = pool
                .jobs
                .first()
                .is_some_and(|(_, id)| self.jobs[id].pending);
            if !pool.hungry[0].is_empty() && pool.ready > 0 && !waits_for_store {
                return Err(format!(
                    "tiles for {profile} are ready and a worker is idle"
                ));
            }
        }
        Ok(())
    }
}
