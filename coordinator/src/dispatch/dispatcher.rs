//! The dispatcher: the scheduler under its lock, with the channels to workers and watchers.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard};

use sightline_records::ids::{JobId, WorkerId};
use sightline_scheduler::{
    Departure, Effect, Event, Introduction, Joined, NameTaken, Now, Scheduler, WorkerCommand,
};
use tokio::sync::watch;

use crate::dispatch::follow_ups::{FollowUp, FollowUps};
use crate::dispatch::notes::log_note;
use crate::dispatch::outbox::Outbox;
use crate::dispatch::watchers::Watchers;
use crate::locks::{self, Rank, Ranked};
use crate::telemetry::events::{EventKind, LogEvent};
use crate::telemetry::spans;
use crate::telemetry::state::Telemetry;

/// The scheduler and the channels to its workers.
struct Scheduling {
    scheduler: Scheduler,
    outboxes: BTreeMap<WorkerId, Box<dyn Outbox>>,
}

/// The scheduler of a coordinator. No guard of its lock leaves this type, so no call of the store can run
/// under the lock.
pub(crate) struct Dispatcher {
    scheduling: Mutex<Scheduling>,
    watchers: Mutex<Watchers>,
}

/// The execution of the effects of one event, under the lock of the scheduler.
struct Round<'a> {
    scheduling: &'a mut Scheduling,
    watchers: &'a Mutex<Watchers>,
    telemetry: &'a Telemetry,
    now: Now,
    follow_ups: FollowUps,
}

impl Dispatcher {
    /// Creates a dispatcher without workers and watchers.
    pub(crate) fn new(scheduler: Scheduler) -> Self {
        Self {
            scheduling: Mutex::new(Scheduling {
                scheduler,
                outboxes: BTreeMap::new(),
            }),
            watchers: Mutex::default(),
        }
    }

    /// Reads the scheduler with `read`, which must not block.
    pub(crate) fn read<T>(&self, read: impl FnOnce(&Scheduler) -> T) -> T {
        read(&self.lock().scheduler)
    }

    /// Subscribes to the changes of a job. The value is true if the job has ended.
    pub(crate) fn watch_job(&self, job: JobId) -> watch::Receiver<bool> {
        self.watchers().subscribe(job)
    }

    /// Subscribes to the changes of all jobs and of the workers.
    pub(crate) fn watch_all(&self) -> watch::Receiver<()> {
        self.watchers().any()
    }

    /// Wakes the watchers of a job that was deleted.
    pub(crate) fn job_deleted(&self, job: JobId) {
        self.watchers().changed(job, true);
    }

    /// Adds a worker to the scheduler. The worker receives its commands through `outbox`.
    pub(crate) fn join(
        &self,
        introduction: Introduction,
        outbox: Box<dyn Outbox>,
        now: Now,
        telemetry: &Telemetry,
    ) -> (Result<Joined, NameTaken>, FollowUps) {
        let name = introduction.name.clone();
        let mut outbox = Some(outbox);
        let mut answer = Err(NameTaken { name });
        let scheduling = &mut *self.lock();
        let effects = scheduling.scheduler.step(Event::Joined(introduction), now);
        let mut round = self.round(scheduling, now, telemetry);
        round.carry_out(effects, &mut |scheduling, effect| {
            if let Effect::Joined(joined) = effect {
                if let (Ok(joined), Some(outbox)) = (&joined, outbox.take()) {
                    scheduling.outboxes.insert(joined.worker, outbox);
                }
                answer = joined;
            }
        });
        let follow_ups = round.follow_ups;
        self.watchers().all_changed();
        (answer, follow_ups)
    }

    /// Removes a worker whose stream has ended.
    pub(crate) fn leave(
        &self,
        worker: WorkerId,
        now: Now,
        telemetry: &Telemetry,
    ) -> (Departure, FollowUps) {
        let mut departure = Departure::Lost;
        let scheduling = &mut *self.lock();
        scheduling.outboxes.remove(&worker);
        let effects = scheduling.scheduler.step(Event::Left(worker), now);
        let mut round = self.round(scheduling, now, telemetry);
        round.carry_out(effects, &mut |_, effect| {
            if let Effect::Left(how) = effect {
                departure = how;
            }
        });
        let follow_ups = round.follow_ups;
        self.watchers().all_changed();
        (departure, follow_ups)
    }

    /// Passes an event to the scheduler, without blocking.
    pub(crate) fn tell(&self, event: Event, now: Now, telemetry: &Telemetry) -> FollowUps {
        if let Event::JobChanged(record) = &event
            && record.state.phase().ended()
        {
            telemetry
                .metrics
                .job_ended(&record.state.phase().to_string());
        }
        let scheduling = &mut *self.lock();
        telemetry.spans.heard(&event);
        let effects = scheduling.scheduler.step(event, now);
        let mut round = self.round(scheduling, now, telemetry);
        round.carry_out(effects, &mut |_, _| {});
        round.follow_ups
    }

    fn round<'a>(
        &'a self,
        scheduling: &'a mut Scheduling,
        now: Now,
        telemetry: &'a Telemetry,
    ) -> Round<'a> {
        Round {
            scheduling,
            watchers: &self.watchers,
            telemetry,
            now,
            follow_ups: FollowUps::default(),
        }
    }

    /// Locks the scheduler. The scheduler's state is derived from the store: a panic in the middle of a
    /// change can lose a lease, but no result.
    fn lock(&self) -> Ranked<MutexGuard<'_, Scheduling>> {
        locks::lock(Rank::Scheduler, &self.scheduling)
    }

    /// Locks the watchers. A thread that holds the lock of the scheduler may call this.
    fn watchers(&self) -> Ranked<MutexGuard<'_, Watchers>> {
        locks::lock(Rank::Watchers, &self.watchers)
    }
}

impl Round<'_> {
    /// Carries out effects in the order of the scheduler's decisions. Undelivered commands return to the
    /// scheduler only after the other commands were sent, because the scheduler assumed that all of them are
    /// sent. `answered` receives the answers to [`Dispatcher::join`] and [`Dispatcher::leave`].
    fn carry_out(
        &mut self,
        effects: Vec<Effect>,
        answered: &mut dyn FnMut(&mut Scheduling, Effect),
    ) {
        let mut undelivered = VecDeque::new();
        let mut next = Some(effects);
        while let Some(effects) = next {
            for effect in effects {
                match effect {
                    Effect::Joined(_) | Effect::Left(_) => answered(self.scheduling, effect),
                    Effect::Tell(worker, command) => undelivered.extend(self.send(worker, command)),
                    Effect::Run(command) => self.follow_ups.push(FollowUp::Run(command)),
                    Effect::Assemble(job) => self.follow_ups.push(FollowUp::Assemble(job)),
                    Effect::Changed(job) => {
                        let ended = self.scheduling.scheduler.job(job).is_none();
                        locks::lock(Rank::Watchers, self.watchers).changed(job, ended);
                    }
                    Effect::Note(note) => log_note(self.telemetry, self.now, &note),
                }
            }
            next = undelivered
                .pop_front()
                .map(|event| self.scheduling.scheduler.step(event, self.now));
        }
    }

    /// Sends a command to a worker. Returns the event of a failed delivery if the command was not delivered.
    fn send(&mut self, worker: WorkerId, command: WorkerCommand) -> Option<Event> {
        let Scheduling {
            scheduler,
            outboxes,
        } = &*self.scheduling;
        let Telemetry {
            spans, event_log, ..
        } = self.telemetry;
        let undelivered = match &command {
            WorkerCommand::Grant(grant) => {
                let name = scheduler.name_of(worker).unwrap_or_default();
                let text = format!("tile {} is leased to {name}", grant.lease.tile);
                spans.leased(&grant.lease, name, scheduler);
                let event = LogEvent::of_lease(EventKind::Leased, &grant.lease, text).on(name);
                event_log.record(self.now.unix_ms, event);
                Some(Event::Undelivered(worker, grant.lease))
            }
            WorkerCommand::Help(help) => Some(Event::HelpUndelivered(worker, help.lease)),
            WorkerCommand::Revoke(lease) => {
                // Helpers receive this command as well, while the lease of their crew's leader continues.
                if !scheduler.is_leased(lease) {
                    spans.lease_ended(lease, spans::TAKEN_BACK);
                }
                None
            }
            WorkerCommand::Time { .. } => None,
        };
        let sent = outboxes
            .get(&worker)
            .is_some_and(|outbox| outbox.offer(command));
        if sent {
            return None;
        }
        if let Some(Event::Undelivered(_, lease)) = &undelivered {
            spans.lease_ended(lease, spans::TAKEN_BACK);
        }
        undelivered
    }
}
