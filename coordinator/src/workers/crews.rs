//! Crews: the channels between the leader of a tile and its helpers, and the stored outcomes of phases.
//!
//! The coordinator forwards messages and stores outcomes without decoding them. A member that does not read
//! its stream does not delay other members: helpers read outcomes from the disk at their own pace, and a
//! helper whose mailbox is full is disconnected.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sightline_numbers::ids::PhaseIndex;
use sightline_proto::v1::Chunk;
use sightline_records::ids::{JobId, Lease, TileIndex};
use sightline_store::Outcomes;
use tokio::sync::{mpsc, watch};

/// Maximum number of messages that wait for a member.
pub(crate) const WAITING: usize = 16;

/// The items of a phase that a helper computes.
#[derive(Clone, Debug)]
pub(crate) struct Assignment {
    pub(crate) phase: PhaseIndex,
    pub(crate) items: Vec<u32>,
}

/// A message to the leader.
#[derive(Debug)]
pub(crate) enum LeaderMessage {
    /// The helper with this number has joined.
    Joined(u64),
    /// The helper with this number has left.
    Left(u64),
    /// The outcomes of this many phases are stored.
    Kept(u32),
    /// A helper requests items of this phase.
    Ask { member: u64, phase: PhaseIndex },
    /// A chunk of the results of a helper's items.
    Found {
        member: u64,
        phase: PhaseIndex,
        items: Vec<u32>,
        chunk: Option<Chunk>,
    },
}

/// The crews of all tiles.
pub(crate) struct Crews {
    pub(crate) outcomes: Outcomes,
    channels: Mutex<BTreeMap<(JobId, TileIndex), Arc<CrewChannel>>>,
    /// The lock that a thread holds while it opens or closes a crew and notifies the scheduler.
    turn: Mutex<()>,
}

/// The channel between the members of a crew.
pub(crate) struct CrewChannel {
    pub(crate) lease: Lease,
    pub(crate) to_leader: mpsc::Sender<LeaderMessage>,
    helpers: Mutex<Helpers>,
    /// The number of stored outcomes.
    pub(crate) outcomes: watch::Sender<u32>,
    /// True if the crew has ended.
    pub(crate) is_over: watch::Sender<bool>,
}

/// The helpers of a crew.
#[derive(Default)]
struct Helpers {
    /// The number of the next helper. Numbers are not reused, because a message about a previous helper may
    /// still be in transit.
    next: u64,
    mailboxes: BTreeMap<u64, mpsc::Sender<Assignment>>,
}

impl CrewChannel {
    /// Returns the tile of the crew.
    pub(crate) fn tile(&self) -> (JobId, TileIndex) {
        (self.lease.job, self.lease.tile)
    }

    /// Adds a helper. Returns its number and its mailbox.
    pub(crate) fn enter(&self) -> (u64, mpsc::Receiver<Assignment>) {
        let (send, receive) = mpsc::channel(WAITING);
        let mut helpers = self.helpers();
        let member = helpers.next;
        helpers.next += 1;
        helpers.mailboxes.insert(member, send);
        (member, receive)
    }

    /// Removes a helper. Without its mailbox, the stream of a connected helper ends.
    pub(crate) fn leave(&self, member: u64) {
        self.helpers().mailboxes.remove(&member);
    }

    /// Passes items to a helper. A helper with a full mailbox does not receive them and is removed.
    pub(crate) fn pass(&self, member: u64, assignment: Assignment) {
        let sent = self
            .helpers()
            .mailboxes
            .get(&member)
            .map(|mailbox| mailbox.try_send(assignment));
        if sent.is_some_and(|sent| sent.is_err()) {
            self.leave(member);
        }
    }

    fn helpers(&self) -> MutexGuard<'_, Helpers> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.helpers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Crews {
    /// Creates a table without crews, on the outcomes of earlier crews.
    pub(crate) fn new(outcomes: Outcomes) -> Self {
        Self {
            outcomes,
            channels: Mutex::default(),
            turn: Mutex::default(),
        }
    }

    /// Waits for the lock that orders the opening and closing of crews.
    pub(crate) fn turn(&self) -> MutexGuard<'_, ()> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns true if the tile of this lease has a crew under another valid lease.
    pub(crate) fn is_led_by_another(
        &self,
        lease: &Lease,
        is_valid: impl Fn(&Lease) -> bool,
    ) -> bool {
        let channels = self.channels();
        let channel = channels.get(&(lease.job, lease.tile));
        channel.is_some_and(|channel| channel.lease != *lease && is_valid(&channel.lease))
    }

    /// Opens the crew of a tile for the holder of its lease. `outcomes` is the number of stored outcomes.
    /// Ends the crew of an earlier leader. Returns the crew and the messages to the leader.
    pub(crate) fn open(
        &self,
        lease: Lease,
        outcomes: u32,
    ) -> (Arc<CrewChannel>, mpsc::Receiver<LeaderMessage>) {
        let tile = (lease.job, lease.tile);
        let (to_leader, messages) = mpsc::channel(WAITING);
        let channel = Arc::new(CrewChannel {
            lease,
            to_leader,
            helpers: Mutex::default(),
            outcomes: watch::Sender::new(outcomes),
            is_over: watch::Sender::new(false),
        });
        if let Some(earlier) = self.channels().insert(tile, Arc::clone(&channel)) {
            earlier.is_over.send_replace(true);
        }
        (channel, messages)
    }

    /// Returns the crew that is led under a lease.
    pub(crate) fn find(&self, lease: &Lease) -> Option<Arc<CrewChannel>> {
        self.channels()
            .get(&(lease.job, lease.tile))
            .filter(|channel| channel.lease == *lease)
            .cloned()
    }

    /// Ends a crew. Returns true if it was the tile's current crew.
    pub(crate) fn close(&self, channel: &Arc<CrewChannel>) -> bool {
        channel.is_over.send_replace(true);
        let mut channels = self.channels();
        let is_current = channels
            .get(&channel.tile())
            .is_some_and(|r| Arc::ptr_eq(r, channel));
        if is_current {
            channels.remove(&channel.tile());
        }
        is_current
    }

    fn channels(&self) -> MutexGuard<'_, BTreeMap<(JobId, TileIndex), Arc<CrewChannel>>> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.channels.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
