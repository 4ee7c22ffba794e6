//! The dispatch of events: passes them and the time to the scheduler under a short lock, sends commands to
//! workers, and wakes watchers. Effects that block go to the caller as follow-ups.

pub(crate) mod follow_ups;
pub(crate) mod outbox;
pub(crate) mod run;

use std::collections::VecDeque;

use crate::dispatch::follow_ups::FollowUp;
pub(crate) use crate::dispatch::follow_ups::FollowUps;
use crate::dispatch::outbox::{Outbox, Scheduling};
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};
use crate::telemetry::spans;
use sightline_records::ids::{Lease, WorkerId};
use sightline_scheduler::{
    Departure, Effect, Event, Introduction, Joined, NameTaken, Note, WorkerCommand,
};

/// Lets a worker join.
pub(crate) fn join(
    c: &Coordinator,
    intro: Introduction,
    out: Box<dyn Outbox>,
) -> (Result<Joined, NameTaken>, FollowUps) {
    let name = intro.name.clone();
    let mut out = Some(out);
    let (mut answer, mut follow_ups) = (Err(NameTaken { name }), FollowUps::default());
    let scheduling = &mut *c.lock();
    let effects = scheduling
        .scheduler
        .step(Event::Joined(intro), c.now_plain());
    carry_all(
        c,
        scheduling,
        effects,
        &mut follow_ups,
        &mut |scheduling, effect| {
            if let Effect::Joined(joined) = effect {
                if let (Ok(joined), Some(out)) = (&joined, out.take()) {
                    scheduling.outboxes.insert(joined.worker, out);
                }
                answer = joined;
            }
        },
    );
    c.watched().all_changed();
    (answer, follow_ups)
}

/// Lets a worker go.
pub(crate) fn leave(c: &Coordinator, worker: WorkerId) -> (Departure, FollowUps) {
    let (mut departure, mut follow_ups) = (Departure::Lost, FollowUps::default());
    let scheduling = &mut *c.lock();
    scheduling.outboxes.remove(&worker);
    let effects = scheduling
        .scheduler
        .step(Event::Left(worker), c.now_plain());
    carry_all(c, scheduling, effects, &mut follow_ups, &mut |_, effect| {
        if let Effect::Left(how) = effect {
            departure = how;
        }
    });
    c.watched().all_changed();
    (departure, follow_ups)
}

/// Passes an event to the scheduler, without blocking.
pub(crate) fn tell(c: &Coordinator, event: Event) -> FollowUps {
    let mut follow_ups = FollowUps::default();
    // Taken before waiting for the lock, for which workers that have returned may be waiting, too.
    let now = c.now_plain();
    if let Event::JobChanged(record) = &event
        && record.state.phase().ended()
    {
        c.metrics.job_ended(&record.state.phase().to_string());
    }
    let scheduling = &mut *c.lock();
    c.spans.heard(&event);
    let effects = scheduling.scheduler.step(event, now);
    carry_all(c, scheduling, effects, &mut follow_ups, &mut |_, _| {});
    follow_ups
}

/// Carries out effects that do not block. The machine hears of orders that were not delivered after the
/// others were sent, which it took as sent, too: so orders leave in the order of its decisions. `answered`
/// gets the answers to `join` and `leave`.
fn carry_all(
    c: &Coordinator,
    scheduling: &mut Scheduling,
    effects: Vec<Effect>,
    follow_ups: &mut FollowUps,
    answered: &mut dyn FnMut(&mut Scheduling, Effect),
) {
    let mut lost = VecDeque::new();
    let mut next = Some(effects);
    while let Some(effects) = next {
        for effect in effects {
            if matches!(effect, Effect::Joined(_) | Effect::Left(_)) {
                answered(scheduling, effect);
            } else {
                lost.extend(carry(c, scheduling, effect, follow_ups));
            }
        }
        next = lost
            .pop_front()
            .map(|event| scheduling.scheduler.step(event, c.now_plain()));
    }
}

/// Carries out an effect that does not block; returns the event of an order that was not delivered.
fn carry(
    c: &Coordinator,
    scheduling: &mut Scheduling,
    effect: Effect,
    follow_ups: &mut FollowUps,
) -> Option<Event> {
    match effect {
        Effect::Tell(worker, order) => {
            let lost = match &order {
                WorkerCommand::Grant(grant) => Some(Event::Undelivered(worker, grant.lease)),
                WorkerCommand::Help(help) => Some(Event::HelpUndelivered(worker, help.lease)),
                WorkerCommand::Revoke(_) | WorkerCommand::Time { .. } => None,
            };
            if let WorkerCommand::Grant(grant) = &order {
                let name = scheduling.scheduler.name_of(worker).unwrap_or_default();
                let text = format!("tile {} is leased to {name}", grant.lease.tile);
                c.spans.leased(&grant.lease, name, &scheduling.scheduler);
                c.happened(LogEvent::of_lease(Kind::Leased, &grant.lease, text).on(name));
            }
            if let WorkerCommand::Revoke(lease) = &order
                // Helpers are told so, too, while the lease goes on.
                && !scheduling.scheduler.is_leased(lease)
            {
                c.spans.lease_ended(lease, spans::TAKEN_BACK);
            }
            let sent = scheduling
                .outboxes
                .get(&worker)
                .is_some_and(|out| out.offer(order));
            if let Some(Event::Undelivered(_, lease)) = lost.as_ref().filter(|_| !sent) {
                c.spans.lease_ended(lease, spans::TAKEN_BACK);
            }
            return lost.filter(|_| !sent);
        }
        Effect::Run(command) => follow_ups.push(FollowUp::Run(command)),
        Effect::Assemble(job) => follow_ups.push(FollowUp::Assemble(job)),
        Effect::Changed(job) => c
            .watched()
            .changed(job, scheduling.scheduler.job(job).is_none()),
        Effect::Note(note) => write(c, &note),
        // Answers to `join` and `leave`, which look at them themselves.
        Effect::Joined(_) | Effect::Left(_) => {}
    }
    None
}

/// Writes a note to the log and among the events.
fn write(c: &Coordinator, note: &Note) {
    let happening = match note {
        Note::TakenBack(lease @ Lease { job, tile, .. }, from, why) => {
            c.metrics.lease_taken_back();
            c.spans.lease_ended(lease, spans::TAKEN_BACK);
            let origin = from
                .as_ref()
                .map(|name| format!(" from worker {name}"))
                .unwrap_or_default();
            tracing::warn!("tile {tile} of job {job} is taken back{origin}: {why}");
            let text = format!("tile {tile} is taken back{origin}: {why}");
            LogEvent::of_lease(Kind::TakenBack, lease, text).on(from.clone().unwrap_or_default())
        }
        Note::TakenOver(lease @ Lease { job, tile, .. }, from) => {
            let text = format!("queued on the busy worker {from}, goes to an idle worker");
            tracing::info!("tile {tile} of job {job}, {text}");
            LogEvent::of_lease(Kind::TakenBack, lease, format!("tile {tile}, {text}")).on(from)
        }
        Note::Doubled(lease @ Lease { job, tile, .. }) => {
            let text = "takes long; an idle worker computes it, too";
            tracing::info!("tile {tile} of job {job} {text}");
            LogEvent::of_lease(Kind::Job, lease, format!("tile {tile} {text}"))
        }
        Note::TileFailed(lease @ Lease { job, tile, .. }, worker, reason) => {
            c.spans.lease_ended(lease, spans::FAILED);
            tracing::warn!("tile {tile} of job {job} failed on {worker}: {reason}");
            let text = format!("tile {tile} failed on {worker}: {reason}");
            LogEvent::of_lease(Kind::Failed, lease, text).on(worker)
        }
        Note::Died(lease @ Lease { job, tile, .. }, worker) => {
            c.metrics.worker_died();
            c.spans.lease_ended(lease, spans::FAILED);
            let text = format!("worker {worker} ended without a word while it held tile {tile}");
            tracing::warn!("job {job}: {text}");
            LogEvent::of_lease(Kind::Failed, lease, text).on(worker)
        }
        Note::Agrees(job, tile, worker) => {
            c.metrics.spot_check("same");
            let text = format!("tile {tile} was computed again, with the same bytes");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(Kind::Check, *job, text).on(worker)
            }
        }
        Note::Differs(job, tile, workers) => {
            c.metrics.spot_check("different");
            let text = format!(
                "tile {tile} was computed again, with other bytes; until a third worker has said who is \
                 right, these get no tiles: {}",
                workers.join(", ")
            );
            tracing::error!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(Kind::Conflict, *job, text)
            }
        }
        Note::NeedsThird(job, tile) => {
            let text = format!(
                "tile {tile} has two different outputs and nobody is there to say which is right: start \
                 another worker"
            );
            tracing::error!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(Kind::Conflict, *job, text)
            }
        }
        Note::Unchecked(job, tile, why) => {
            c.metrics.spot_check("skipped");
            let text = format!("tile {tile} was to be computed again and was not: {why}");
            tracing::warn!("job {job}: {text}");
            LogEvent {
                tile: Some(*tile),
                ..LogEvent::of_job(Kind::Check, *job, text)
            }
        }
        Note::Draining(name) => {
            let text = format!("worker {name} is draining: it finishes its tile and takes no more");
            tracing::info!("{text}");
            LogEvent::of(Kind::Worker, text).on(name)
        }
        Note::Chosen(job, chosen) => {
            // `sightline bake` shows this line of the log.
            tracing::info!(target: "sightline_coordinator::profile", "job {job}: {chosen}");
            LogEvent::of_job(Kind::Job, *job, chosen)
        }
        Note::GraceOver(job, tiles) => {
            let text = match tiles {
                0 => "all its tiles at work are with their workers again".to_owned(),
                1 => "no worker has come back for one of its tiles".to_owned(),
                n => format!("no worker has come back for {n} of its tiles"),
            };
            tracing::info!("job {job} goes on: {text}");
            LogEvent::of_job(Kind::Job, *job, format!("the job goes on: {text}"))
        }
    };
    c.happened(happening);
}
