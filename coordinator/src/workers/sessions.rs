//! Worker sessions: joining, the messages of a connected worker, leaving.
//!
//! A message is handled on the thread that receives it. This is fast, because the scheduler's lock is short
//! and all blocking work is returned to the caller as follow-ups.

use std::sync::Arc;

use sightline_records::ids::{JobId, Lease, WorkerId};
use sightline_scheduler::{
    Departure, Event, Failure, Introduction, Joined, NameTaken, ProfileTime, Progress,
};
use tokio::sync::mpsc;

use crate::coordinator::Coordinator;
use crate::dispatch::FollowUps;
use crate::dispatch::outbox::Outbox;
use crate::telemetry::events::{EventKind, LogEvent};
use crate::workers::crews::{CrewChannel, LeaderMessage};

/// A message of a connected worker.
pub(crate) enum Message {
    /// The worker requests this many more tiles.
    Want(u32),
    /// The worker finishes its leased tiles and requests no more.
    Draining,
    /// A tile makes progress.
    Progress(Progress),
    /// A tile failed.
    Failed(Failure),
    /// The worker no longer helps the holder of this lease.
    Helped(Lease),
    /// The worker has timed its backends for a job.
    Timed(JobId, Vec<ProfileTime>),
}

/// Adds a worker.
///
/// # Errors
/// [`NameTaken`] if another worker with the same name is connected.
pub(crate) fn join(
    c: &Coordinator,
    intro: Introduction,
    out: Box<dyn Outbox>,
) -> Result<(Joined, FollowUps), NameTaken> {
    let joining = format!(
        "worker {} has joined, with {}",
        intro.name,
        intro.profiles.join(", ")
    );
    let name = intro.name.clone();
    let (joined, follow_ups) = c
        .dispatcher
        .join(intro, out, c.scheduler_now(), &c.telemetry);
    let joined = joined?;
    c.telemetry.spans.held_again(&name, &joined.kept);
    tracing::info!("{joining}");
    c.record_event(LogEvent::new(EventKind::Worker, joining).on(name));
    Ok((joined, follow_ups))
}

/// Removes a worker whose stream has ended.
pub(crate) fn leave(c: &Coordinator, worker: WorkerId, name: &str) -> FollowUps {
    let (departure, follow_ups) = c.dispatcher.leave(worker, c.scheduler_now(), &c.telemetry);
    let text = match departure {
        Departure::Drained => format!("worker {name} has drained and left"),
        Departure::Lost => format!("worker {name} has disconnected"),
    };
    tracing::info!("{text}");
    c.record_event(LogEvent::new(EventKind::Worker, text).on(name));
    follow_ups
}

/// Opens the crew of a tile for the holder of its lease. Returns `None` if the lease is not valid or belongs
/// to a check, or if the tile has a crew under another valid lease.
pub(crate) fn lead(
    c: &Coordinator,
    lease: Lease,
) -> Option<(Arc<CrewChannel>, mpsc::Receiver<LeaderMessage>, FollowUps)> {
    // Reads a file, so do it before taking the lock.
    let outcomes = c.workers.crews.outcomes.count((lease.job, lease.tile));
    // The lock makes the scheduler receive the crews in the order in which they open and close.
    let _turn = c.workers.crews.turn();
    let may_lead = c.dispatcher.read(|scheduler| {
        let is_leased = |lease: &Lease| scheduler.is_leased(lease);
        // If two workers compute a tile, the first one has the helpers. A check does not use stored outcomes
        // and stores none. Otherwise, the wrong outcomes of one worker would make the next worker agree with
        // it.
        is_leased(&lease)
            && !scheduler.is_check(&lease)
            && !c.workers.crews.is_led_by_another(&lease, is_leased)
    });
    if !may_lead {
        return None;
    }
    let (channel, messages) = c.workers.crews.open(lease, outcomes);
    Some((channel, messages, c.tell(Event::CrewOpened(lease))))
}

/// Ends a crew whose leader no longer needs helpers.
pub(crate) fn crew_ended(c: &Coordinator, channel: &Arc<CrewChannel>) -> FollowUps {
    let _turn = c.workers.crews.turn();
    // The same leader may have opened another crew in the meantime.
    if c.workers.crews.close(channel) {
        c.tell(Event::CrewClosed(channel.lease))
    } else {
        FollowUps::default()
    }
}

/// Handles a message of a worker.
pub(crate) fn heard(c: &Coordinator, worker: WorkerId, message: Message) -> FollowUps {
    c.tell(match message {
        Message::Want(tiles) => Event::Wanted(worker, tiles),
        Message::Draining => Event::Drains(worker),
        // A stale lease was revoked when it became stale, so the worker has been notified.
        Message::Progress(progress) => Event::Progressed(progress),
        Message::Failed(failure) => Event::Failed(worker, failure),
        Message::Helped(lease) => Event::Helped(worker, lease),
        Message::Timed(job, times) => Event::Timed(worker, job, times),
    })
}
