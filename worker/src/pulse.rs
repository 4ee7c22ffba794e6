//! What a worker tells of itself to who watches machines: whether it is connected, and what it has done.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Changed by the worker, read by anybody.
#[derive(Debug, Default)]
pub struct Pulse {
    connected: AtomicBool,
    done: AtomicU64,
    cancelled: AtomicU64,
    failed: AtomicU64,
}

/// How a tile ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    Done,
    /// The coordinator has taken it back, or the worker was told to stop.
    Cancelled,
    Failed,
}

impl Pulse {
    /// Whether the coordinator has welcomed the worker and the stream goes on.
    pub fn is_connected(&self) -> bool {
        self.connected.load(Ordering::Relaxed)
    }

    /// Tiles by how they ended.
    pub fn tiles(&self) -> [(&'static str, u64); 3] {
        [("done", &self.done), ("cancelled", &self.cancelled), ("failed", &self.failed)]
            .map(|(name, count)| (name, count.load(Ordering::Relaxed)))
    }

    pub(crate) fn connected(&self, is: bool) {
        self.connected.store(is, Ordering::Relaxed);
    }

    pub(crate) fn ended(&self, how: Ended) {
        let count = match how {
            Ended::Done => &self.done,
            Ended::Cancelled => &self.cancelled,
            Ended::Failed => &self.failed,
        };
        count.fetch_add(1, Ordering::Relaxed);
    }
}
