//! Clocks of the coordinator: the system's clocks, and a clock that a test moves by hand.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A point in time on the monotonic clock and on the wall clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Monotonic time, for leases and waits.
    pub at: Instant,
    /// The wall clock in milliseconds since 1970, for human-readable records and for time budgets.
    pub unix_ms: u64,
}

/// A source of time.
pub trait Clock: Send + Sync {
    /// Returns the current time.
    fn now(&self) -> Moment;
}

/// The clocks of the operating system.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Moment {
        let unix_ms = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |d| d.as_millis() as u64);
        Moment {
            at: Instant::now(),
            unix_ms,
        }
    }
}

/// A clock for tests that only [`ManualClock::advance`] and [`ManualClock::step`] move.
#[derive(Debug)]
pub struct ManualClock(Mutex<Moment>);

impl Default for ManualClock {
    /// Creates a clock that starts at the system's current time.
    fn default() -> Self {
        Self(Mutex::new(SystemClock.now()))
    }
}

impl ManualClock {
    /// Moves both clocks forward by `by`.
    pub fn advance(&self, by: Duration) {
        let mut now = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *now = Moment {
            at: now.at + by,
            unix_ms: now.unix_ms + by.as_millis() as u64,
        };
    }
}

impl ManualClock {
    /// Steps the wall clock by `by_ms` milliseconds, forward or back. The monotonic clock does not step.
    pub fn step(&self, by_ms: i64) {
        let mut now = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        now.unix_ms = now.unix_ms.saturating_add_signed(by_ms);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Moment {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<C: Clock + ?Sized> Clock for std::sync::Arc<C> {
    fn now(&self) -> Moment {
        (**self).now()
    }
}
