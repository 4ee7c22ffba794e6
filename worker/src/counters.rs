//! Worker metrics: the connection state and the finished work.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The counters of a worker. The worker updates them; other threads may read them.
#[derive(Debug, Default)]
pub struct WorkerCounters {
    connected: AtomicBool,
    done: AtomicU64,
    cancelled: AtomicU64,
    failed: AtomicU64,
    /// The numbers of blobs and of their bytes, by direction and route.
    transferred: [[[AtomicU64; 2]; 3]; 2],
}

/// The direction of a blob's transfer, seen from the worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    In,
    Out,
}

/// The route of a blob's transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BlobRoute {
    /// Between the worker and the blob store.
    Direct,
    Coordinator,
    /// Through the coordinator, after the blob store failed.
    Fallback,
}

/// The number and size of the blobs transferred in one direction on one route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransferTotals {
    /// The direction: `in` or `out`.
    pub direction: &'static str,
    /// The route: `direct`, `coordinator`, or `fallback` (through the coordinator after the blob store
    /// failed).
    pub route: &'static str,
    /// The number of blobs.
    pub blobs: u64,
    /// The total size of the blobs, in bytes.
    pub bytes: u64,
}

/// The way in which a tile ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    Done,
    /// The coordinator revoked the lease, or the worker received a command to stop.
    Cancelled,
    Failed,
}

impl WorkerCounters {
    /// Returns true if the coordinator has welcomed the worker and the stream is open.
    pub fn is_connected(&self) -> bool {
        self.connected.load(Ordering::Relaxed)
    }

    /// Returns the number of tiles by the way in which they ended.
    pub fn tiles(&self) -> [(&'static str, u64); 3] {
        [
            ("done", &self.done),
            ("cancelled", &self.cancelled),
            ("failed", &self.failed),
        ]
        .map(|(name, count)| (name, count.load(Ordering::Relaxed)))
    }

    /// Returns the transfers of scenes, packs and outputs by direction and route.
    pub fn transfers(&self) -> Vec<TransferTotals> {
        let mut all = Vec::new();
        for (direction, counter) in ["in", "out"].into_iter().zip(&self.transferred) {
            for (route, counts) in ["direct", "coordinator", "fallback"]
                .into_iter()
                .zip(counter)
            {
                let [blobs, bytes] = [0, 1].map(|i| counts[i].load(Ordering::Relaxed));
                all.push(TransferTotals {
                    direction,
                    route,
                    blobs,
                    bytes,
                });
            }
        }
        all
    }

    pub(crate) fn transferred(&self, direction: Direction, route: BlobRoute, bytes: usize) {
        let [blobs, sum] = &self.transferred[direction as usize][route as usize];
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
