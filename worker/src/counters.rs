//! What a worker tells of itself to who watches machines: whether it is connected, and what it has done.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Changed by the worker, read by anybody.
#[derive(Debug, Default)]
pub struct WorkerCounters {
    connected: AtomicBool,
    done: AtomicU64,
    cancelled: AtomicU64,
    failed: AtomicU64,
    /// Blobs and their bytes, by direction and way.
    moved: [[[AtomicU64; 2]; 3]; 2],
}

/// Whether a blob came here or left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    In,
    Out,
}

/// How a blob went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// Between this worker and the store.
    Direct,
    Coordinator,
    /// Through the coordinator, after the store did not do.
    Fallback,
}

/// Blobs that went one way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moved {
    /// `in` or `out`.
    pub direction: &'static str,
    /// `direct`, `coordinator`, or `fallback`: through the coordinator, after the store did not do.
    pub way: &'static str,
    /// How many.
    pub blobs: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// How a tile ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    Done,
    /// The coordinator has taken it back, or the worker was told to stop.
    Cancelled,
    Failed,
}

impl WorkerCounters {
    /// Whether the coordinator has welcomed the worker and the stream goes on.
    pub fn is_connected(&self) -> bool {
        self.connected.load(Ordering::Relaxed)
    }

    /// Tiles by how they ended.
    pub fn tiles(&self) -> [(&'static str, u64); 3] {
        [
            ("done", &self.done),
            ("cancelled", &self.cancelled),
            ("failed", &self.failed),
        ]
        .map(|(name, count)| (name, count.load(Ordering::Relaxed)))
    }

    /// Scenes, packs and outputs by how they went.
    pub fn transfers(&self) -> Vec<Moved> {
        let mut all = Vec::new();
        for (direction, of) in ["in", "out"].into_iter().zip(&self.moved) {
            for (way, counts) in ["direct", "coordinator", "fallback"].into_iter().zip(of) {
                let [blobs, bytes] = [0, 1].map(|i| counts[i].load(Ordering::Relaxed));
                all.push(Moved {
                    direction,
                    way,
                    blobs,
                    bytes,
                });
            }
        }
        all
    }

    pub(crate) fn moved(&self, direction: Direction, way: Way, bytes: usize) {
        let [blobs, sum] = &self.moved[direction as usize][way as usize];
        blobs.fetch_add(1, Ordering::Relaxed);
        sum.fetch_add(bytes as u64, Ordering::Relaxed);
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
