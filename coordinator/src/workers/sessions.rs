//! Worker sessions: joining, the messages of a connected worker, leaving.
//!
//! Messages are handled where they arrive: the scheduler's lock is short, and the caller gets all
//! work that blocks as follow-ups.

use std::sync::Arc;

use sightline_records::ids::{JobId, Lease, WorkerId};
use sightline_scheduler::{
    Departure, Event, Failure, Introduction, Joined, NameTaken, ProfileTime, Progress,
};
use tokio::sync::mpsc;

use crate::dispatch::outbox::Outbox;
use crate::dispatch::{self, FollowUps, tell};
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};
use crate::workers::crews::{CrewChannel, LeaderMessage};

/// A message of a connected worker.
pub(crate) enum Message {
    /// It wants this many more tiles.
    Want(u32),
    /// It finishes the tiles that it holds and takes no more.
    Draining,
    /// A tile makes progress.
    Progress(Progress),
    /// A tile failed.
    Failed(Failure),
    /// It helps the holder of this lease no more.
    Helped(Lease),
    /// It timed its backends for a job.
    Timed(JobId, Vec<ProfileTime>),
}

/// Adds a worker.
///
/// # Errors
/// [`NameTaken`] when another worker of its name is connected.
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
    let (joined, follow_ups) = dispatch::join(c, intro, out);
    let joined = joined?;
    c.spans.held_again(&name, &joined.kept);
    tracing::info!("{joining}");
    c.happened(LogEvent::of(Kind::Worker, joining).on(name));
    Ok((joined, follow_ups))
}

/// Removes a worker whose stream has ended.
pub(crate) fn leave(c: &Coordinator, worker: WorkerId, name: &str) -> FollowUps {
    let (departure, follow_ups) = dispatch::leave(c, worker);
    let text = match departure {
        Departure::Drained => format!("worker {name} has drained and left"),
        Departure::Lost => format!("worker {name} has gone"),
    };
    tracing::info!("{text}");
    c.happened(LogEvent::of(Kind::Worker, text).on(name));
    follow_ups
}

/// Opens the crew of a tile for the holder of its lease; `None` when the lease is not valid or that of a
/// check, or the tile has a crew under another lease that is.
pub(crate) fn lead(
    c: &Coordinator,
    lease: Lease,
) -> Option<(Arc<CrewChannel>, mpsc::Receiver<LeaderMessage>, FollowUps)> {
    // Reads a file, before anybody has to wait.
    let outcomes = c.crews.outcomes.count((lease.job, lease.tile));
    // The machine hears of crews in the order in which they open and close.
    let _turn = c.crews.turn();
    {
        let scheduling = c.lock();
        let is_leased = |lease: &Lease| scheduling.scheduler.is_leased(lease);
        // Where two workers compute a tile, the first has the helpers.
        // A check goes on from nothing that anybody has kept, and keeps nothing: what a wrong worker has left
        // would make the next one agree with it.
        let is_check = scheduling.scheduler.is_check(&lease);
        if !is_leased(&lease) || is_check || c.crews.is_led_by_another(&lease, is_leased) {
            return None;
        }
    }
    let (room, told) = c.crews.open(lease, outcomes);
    Some((room, told, tell(c, Event::CrewOpened(lease))))
}

/// A crew has ended: its leader has no use for helpers any more.
pub(crate) fn crew_ended(c: &Coordinator, room: &Arc<CrewChannel>) -> FollowUps {
    let _turn = c.crews.turn();
    // The same leader may have opened another crew meanwhile.
    if c.crews.close(room) {
        tell(c, Event::CrewClosed(room.lease))
    } else {
        FollowUps::default()
    }
}

/// Acts on a message of a worker.
pub(crate) fn heard(c: &Coordinator, worker: WorkerId, message: Message) -> FollowUps {
    tell(
        c,
        match message {
            Message::Want(tiles) => Event::Wanted(worker, tiles),
            Message::Draining => Event::Drains(worker),
            // A stale lease was revoked when it became stale, so the worker has been told.
            Message::Progress(progress) => Event::Progressed(progress),
            Message::Failed(failure) => Event::Failed(worker, failure),
            Message::Helped(lease) => Event::Helped(worker, lease),
            Message::Timed(job, times) => Event::Timed(worker, job, times),
        },
    )
}
