//! Transitions of workers: they join, request tiles, and leave.

use std::collections::BTreeSet;

use sightline_model::{NamedValue as _, TracerChoice};
use sightline_records::ids::{LeaseId, WorkerId};

use super::event::{Departure, Effect, Note};
use super::job::Parked;
use super::messages::{Introduction, Joined, NameTaken, Now};
use super::pools::{CHOICES, Profile, index};
use super::profile_choice::{Binding, profile_for};
use super::state::{Scheduler, Timer, Worker};
use super::worker_totals::WorkerTotals;

/// The time for which a worker that could not receive a command gets none, in milliseconds.
const BACKPRESSURE_MS: u64 = 1000;
/// Maximum number of tiles that a worker may hold: one that it computes and one that it fetches.
pub(super) const MOST_HELD: u32 = 2;

impl Scheduler {
    /// Adds a worker whose stream has begun.
    ///
    /// If the same worker, identified by its instance, is connected, the new stream replaces its earlier
    /// stream. A worker that sends no instance is accepted and replaces no stream.
    pub(super) fn join(&mut self, intro: Introduction, now: Now) {
        let Introduction {
            name,
            signature,
            version,
            instance,
            profiles,
            held,
            helps,
        } = intro;
        if instance != 0 {
            if let Some(other) = self
                .roster
                .names
                .get(&name)
                .and_then(|id| self.roster.workers.get(id))
                && other.instance != instance
            {
                self.effects.push(Effect::Joined(Err(NameTaken { name })));
                return;
            }
            // The coordinator may not have noticed yet that the worker's earlier stream is broken.
            if let Some(earlier) = self.roster.instances.get(&instance).copied() {
                self.remove_worker(earlier, now, false);
            }
        }
        self.note_return(&name, instance);
        self.roster.count += 1;
        let number = WorkerId(self.roster.count);
        if instance != 0 {
            self.roster.names.insert(name.clone(), number);
            self.roster.instances.insert(instance, number);
        }
        let serves = |choice| !matches!(profile_for(choice, &profiles), Binding::Cannot);
        let mut of_choice = [false; CHOICES];
        let choices = TracerChoice::ALL.iter().copied().map(Some);
        choices
            .chain([None])
            .for_each(|choice| of_choice[index(choice)] = serves(choice));
        let alone = alone(&profiles);
        let worker = Worker {
            name,
            signature: signature.into(),
            version,
            joined: now.unix_ms,
            heard: now.unix_ms,
            done: WorkerTotals::default(),
            instance,
            profiles: profiles.iter().map(|p| Profile::from(p.as_str())).collect(),
            serves: of_choice,
            wants: 0,
            draining: false,
            backpressured_until: None,
            unresponsive: false,
            unheard: None,
            leases: BTreeSet::new(),
            can_help: helps,
            helps: None,
            timing: BTreeSet::new(),
        };
        for profile in &worker.profiles {
            let pool = self.queues.pools.at(profile);
            pool.able += 1;
            pool.alone += u64::from(alone.as_deref() == Some(&**profile));
        }
        self.roster.workers.insert(number, worker);
        let kept = self.claim(number, held, now);
        self.list_worker(number);
        let epoch = self.settings.epoch;
        self.effects.push(Effect::Joined(Ok(Joined {
            worker: number,
            epoch,
            kept,
        })));
    }

    /// Removes a worker whose stream has ended.
    pub(super) fn leave(&mut self, worker: WorkerId, now: Now) {
        let departure = self.remove_worker(worker, now, true);
        self.effects.push(Effect::Left(departure));
    }

    /// Removes a worker. Its leases continue for a grace period, so that the worker can return for them.
    ///
    /// If the worker was draining, only the leases of tiles that it has begun continue. `is_missing` is true
    /// if the worker has not returned yet.
    fn remove_worker(&mut self, id: WorkerId, now: Now, is_missing: bool) -> Departure {
        let Some(mut w) = self.roster.workers.remove(&id) else {
            return Departure::Lost;
        };
        if is_missing && !w.draining {
            self.miss(id, &w);
        }
        self.unlist_worker(id, &w);
        if let Some(helped) = w.helps.take() {
            self.has_left(helped.id, id);
        }
        if self.roster.names.get(&w.name) == Some(&id) {
            self.roster.names.remove(&w.name);
        }
        if self.roster.instances.get(&w.instance) == Some(&id) {
            self.roster.instances.remove(&w.instance);
        }
        let profiles: Vec<String> = w.profiles.iter().map(|p| p.to_string()).collect();
        let alone = alone(&profiles);
        for profile in &w.profiles {
            let pool = self.queues.pools.at(profile);
            pool.able -= 1;
            pool.alone -= u64::from(alone.as_deref() == Some(&**profile));
        }
        let leases: Vec<LeaseId> = std::mem::take(&mut w.leases).into_iter().collect();
        for lease in leases {
            let Some(l) = self.leases.table.get_mut(&lease) else {
                continue;
            };
            l.gone = Some(now.ms);
            let begun = l.begun.is_some();
            self.stop_waiting(lease);
            if w.draining && !begun {
                // The worker will not return for a tile that was granted while it announced that it drains.
                self.end_lease(lease, false);
            } else {
                self.arm(lease);
            }
        }
        w.profiles.iter().for_each(|p| self.queues.pools.tidy(p));
        let timed: Vec<_> = w.timing.iter().copied().collect();
        for job in timed {
            self.unpark(job, Parked::Timing(id));
        }
        if w.draining {
            Departure::Drained
        } else {
            Departure::Lost
        }
    }

    /// Records that a worker requests this many additional tiles.
    pub(super) fn want(&mut self, worker: WorkerId, tiles: u32) {
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            // A worker that requests more tiles than it may hold is faulty.
            let room = MOST_HELD.saturating_sub(w.leases.len() as u32);
            w.wants = w.wants.saturating_add(tiles).min(room);
            (w.unresponsive, w.unheard) = (false, None);
            self.list_worker(worker);
        }
    }

    /// Records that a worker accepts no further tiles.
    pub(super) fn drain(&mut self, worker: WorkerId) {
        let Some(w) = self.roster.workers.get_mut(&worker) else {
            return;
        };
        w.wants = 0;
        if !std::mem::replace(&mut w.draining, true) {
            let name = w.name.clone();
            self.note(Note::Draining(name));
        }
        self.list_worker(worker);
    }

    /// Sends no commands for a while to a worker that could not receive one.
    pub(super) fn backpressure(&mut self, worker: WorkerId, now: Now) {
        if let Some(w) = self.roster.workers.get_mut(&worker) {
            w.backpressured_until = Some(now.ms + BACKPRESSURE_MS);
            self.set_timer(now.ms + BACKPRESSURE_MS, Timer::Backpressure(worker));
            self.list_worker(worker);
        }
    }

    /// Adds a worker to the lists of idle, requesting and helping workers that it belongs to now, and removes
    /// it from the others.
    pub(super) fn list_worker(&mut self, id: WorkerId) {
        let Some(w) = self.roster.workers.get(&id) else {
            return;
        };
        let (idle, fit) = (
            w.leases.is_empty(),
            !w.draining && !self.is_barred(&w.signature),
        );
        let hungry = fit && w.wants > 0 && w.backpressured_until.is_none() && !w.unresponsive;
        let helps = hungry && idle && w.can_help && w.helps.is_none();
        let belongs = [fit && idle, hungry && idle, hungry && !idle, helps];
        for (choice, serves) in w.serves.into_iter().enumerate() {
            set(&mut self.queues.pools.hungry[choice], id, hungry && serves);
        }
        for profile in &w.profiles {
            let pool = self.queues.pools.at(profile);
            let [without, with] = &mut pool.hungry;
            for (list, belongs) in [&mut pool.idle, without, with, &mut pool.helpers]
                .into_iter()
                .zip(belongs)
            {
                set(list, id, belongs);
            }
        }
    }

    fn unlist_worker(&mut self, id: WorkerId, w: &Worker) {
        for hungry in &mut self.queues.pools.hungry {
            hungry.remove(&id);
        }
        for profile in &w.profiles {
            let pool = self.queues.pools.at(profile);
            pool.idle.remove(&id);
            pool.helpers.remove(&id);
            pool.hungry.iter_mut().for_each(|h| {
                h.remove(&id);
            });
        }
    }

    /// Returns the index of a job's tracer choice.
    pub(super) fn choice_of(job: &super::job::OpenJob) -> usize {
        index(job.planned.spec().tracer())
    }
}

/// Adds a worker to a list, or removes it from the list.
fn set(list: &mut BTreeSet<WorkerId>, id: WorkerId, belongs: bool) {
    if belongs {
        list.insert(id);
    } else {
        list.remove(&id);
    }
}

/// Returns the only profile that `auto` considers for a worker with these profiles, or `None`.
pub(super) fn alone(profiles: &[String]) -> Option<String> {
    match profile_for(Some(TracerChoice::Auto), profiles) {
        Binding::Bind(profile) => Some(profile),
        Binding::Time | Binding::Cannot => None,
    }
}
