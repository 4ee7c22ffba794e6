//! Crews: where the leader of a tile and its helpers meet, and the outcomes that they leave.
//!
//! The coordinator passes messages on and keeps outcomes; it does not look into them. A member that does not
//! read its stream delays nobody: helpers read outcomes from the disk at their own pace, and a helper whose
//! mailbox is full is sent away.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sightline_proto::v1::Chunk;
use sightline_records::ids::{JobId, Lease, TileIndex};
use sightline_store::Outcomes;
use tokio::sync::{mpsc, watch};

/// Messages to a member that wait until it reads them.
pub(crate) const WAITING: usize = 16;

/// Items of a phase for a helper.
#[derive(Clone, Debug)]
pub(crate) struct Assignment {
    pub(crate) phase: u32,
    pub(crate) items: Vec<u32>,
}

/// What the leader is told.
#[derive(Debug)]
pub(crate) enum LeaderMessage {
    Joined(u64),
    Left(u64),
    /// The outcomes of this many phases are there.
    Kept(u32),
    Ask {
        member: u64,
        phase: u32,
    },
    /// A chunk of a helper's finds.
    Found {
        member: u64,
        phase: u32,
        items: Vec<u32>,
        chunk: Option<Chunk>,
    },
}

/// All crews.
pub(crate) struct Crews {
    pub(crate) outcomes: Outcomes,
    rooms: Mutex<BTreeMap<(JobId, TileIndex), Arc<CrewChannel>>>,
    /// Held while a crew opens or closes and the scheduler hears of it.
    turn: Mutex<()>,
}

/// A crew with a leader.
pub(crate) struct CrewChannel {
    pub(crate) lease: Lease,
    pub(crate) to_leader: mpsc::Sender<LeaderMessage>,
    helpers: Mutex<Helpers>,
    /// Number of outcomes that are there.
    pub(crate) outcomes: watch::Sender<u32>,
    /// Whether the crew has ended.
    pub(crate) is_over: watch::Sender<bool>,
}

/// The helpers of a crew.
#[derive(Default)]
struct Helpers {
    /// Numbers are not used again: a message about the last bearer may be on its way.
    next: u64,
    mailboxes: BTreeMap<u64, mpsc::Sender<Assignment>>,
}

impl CrewChannel {
    /// The tile of the crew.
    pub(crate) fn tile(&self) -> (JobId, TileIndex) {
        (self.lease.job, self.lease.tile)
    }

    /// Lets a helper in; its number and its mailbox.
    pub(crate) fn enter(&self) -> (u64, mpsc::Receiver<Assignment>) {
        let (send, receive) = mpsc::channel(WAITING);
        let mut helpers = self.helpers();
        let member = helpers.next;
        helpers.next += 1;
        helpers.mailboxes.insert(member, send);
        (member, receive)
    }

    /// A helper has gone, or has to go: without its mailbox its stream ends.
    pub(crate) fn leave(&self, member: u64) {
        self.helpers().mailboxes.remove(&member);
    }

    /// Passes items to a helper. One with a full mailbox does not get them, and has to go.
    pub(crate) fn pass(&self, member: u64, take: Assignment) {
        let sent = self
            .helpers()
            .mailboxes
            .get(&member)
            .map(|mailbox| mailbox.try_send(take));
        if sent.is_some_and(|sent| sent.is_err()) {
            self.leave(member);
        }
    }

    fn helpers(&self) -> MutexGuard<'_, Helpers> {
        // Each change is whole before anything can panic.
        self.helpers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Crews {
    /// No crews, and the outcomes of earlier ones.
    pub(crate) fn new(outcomes: Outcomes) -> Self {
        Self {
            outcomes,
            rooms: Mutex::default(),
            turn: Mutex::default(),
        }
    }

    /// Waits for the turn to open or close a crew.
    pub(crate) fn turn(&self) -> MutexGuard<'_, ()> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the tile of this lease has a crew under another lease that is still valid.
    pub(crate) fn is_led_by_another(
        &self,
        lease: &Lease,
        is_valid: impl Fn(&Lease) -> bool,
    ) -> bool {
        let rooms = self.rooms();
        let room = rooms.get(&(lease.job, lease.tile));
        room.is_some_and(|room| room.lease != *lease && is_valid(&room.lease))
    }

    /// Opens the crew of a tile, of which so many outcomes are there, for the holder of its lease. A crew of
    /// an earlier leader ends. Returns the messages to the leader as well.
    pub(crate) fn open(
        &self,
        lease: Lease,
        outcomes: u32,
    ) -> (Arc<CrewChannel>, mpsc::Receiver<LeaderMessage>) {
        let tile = (lease.job, lease.tile);
        let (to_leader, told) = mpsc::channel(WAITING);
        let room = Arc::new(CrewChannel {
            lease,
            to_leader,
            helpers: Mutex::default(),
            outcomes: watch::Sender::new(outcomes),
            is_over: watch::Sender::new(false),
        });
        if let Some(earlier) = self.rooms().insert(tile, Arc::clone(&room)) {
            earlier.is_over.send_replace(true);
        }
        (room, told)
    }

    /// The crew that is led under a lease.
    pub(crate) fn find(&self, lease: &Lease) -> Option<Arc<CrewChannel>> {
        self.rooms()
            .get(&(lease.job, lease.tile))
            .filter(|room| room.lease == *lease)
            .cloned()
    }

    /// Ends a crew; returns whether it was still the tile's.
    pub(crate) fn close(&self, room: &Arc<CrewChannel>) -> bool {
        room.is_over.send_replace(true);
        let mut rooms = self.rooms();
        let is_current = rooms
            .get(&room.tile())
            .is_some_and(|r| Arc::ptr_eq(r, room));
        if is_current {
            rooms.remove(&room.tile());
        }
        is_current
    }

    fn rooms(&self) -> MutexGuard<'_, BTreeMap<(JobId, TileIndex), Arc<CrewChannel>>> {
        // Each change is whole before anything can panic.
        self.rooms.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
