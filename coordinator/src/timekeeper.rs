//! The timekeeper of a coordinator: each reading of its clock is also observed by the clock of retention.

use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Instant;

use sightline_scheduler::Now;

use crate::clock::{Clock, Moment};
use crate::jobs::retention_clock::{Ages, FutureBlobs, RetentionClock};

/// The clock of the coordinator, with the clock of retention and the origin of the scheduler's time.
pub(crate) struct Timekeeper {
    clock: Box<dyn Clock>,
    /// The origin of the scheduler's time, on the monotonic clock.
    origin: Instant,
    /// The clock of retention. A thread may lock it while it holds any other lock.
    retention: Mutex<RetentionClock>,
    /// The lock of stamps of this clock. It prevents an earlier stamp from replacing a later one.
    stamping: Mutex<()>,
    /// The unreferenced blobs whose recorded times are in the future.
    future_blobs: Mutex<FutureBlobs>,
}

impl Timekeeper {
    /// Creates a timekeeper. `retention` continues from the last stamp of the store.
    pub(crate) fn new(clock: Box<dyn Clock>, retention: RetentionClock) -> Self {
        Self {
            origin: clock.now().at,
            clock,
            retention: Mutex::new(retention),
            stamping: Mutex::default(),
            future_blobs: Mutex::default(),
        }
    }

    /// Returns the current time, after the clock of retention has observed it. `ages` are the ages at which
    /// retention deletes.
    pub(crate) fn now(&self, ages: Ages) -> Moment {
        let now = self.clock.now();
        self.retention().observe(now, ages);
        now
    }

    /// Returns the wall clock in milliseconds since 1970, for log entries.
    pub(crate) fn unix_ms(&self) -> u64 {
        self.clock.now().unix_ms
    }

    /// Converts a moment into the scheduler's time base.
    pub(crate) fn scheduler_time(&self, moment: Moment) -> Now {
        let elapsed = moment.at.saturating_duration_since(self.origin);
        Now {
            ms: elapsed.as_millis() as u64,
            unix_ms: moment.unix_ms,
        }
    }

    /// Locks the clock of retention.
    pub(crate) fn retention(&self) -> MutexGuard<'_, RetentionClock> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.retention
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the unreferenced blobs whose recorded times are in the future.
    pub(crate) fn future_blobs(&self) -> MutexGuard<'_, FutureBlobs> {
        self.future_blobs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the lock of stamps, or `None` if another thread holds it.
    pub(crate) fn try_stamping(&self) -> Option<MutexGuard<'_, ()>> {
        match self.stamping.try_lock() {
            Ok(right) => Some(right),
            Err(TryLockError::Poisoned(e)) => Some(e.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Waits for the lock of stamps and returns it.
    pub(crate) fn stamping(&self) -> MutexGuard<'_, ()> {
        self.stamping.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
