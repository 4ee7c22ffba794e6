//! What the tests in `tests/` share: the program under test, folders to run it in, processes that are ended
//! with the test, and results read back.
//!
//! The program is only ever run from outside, as a user runs it; nothing here links against it. What is
//! waited for is waited for by looking, never by sleeping a fixed time; the limits only turn a hang into a
//! failure.

// The permissions for tests reach `#[test]` functions only; all of this runs inside of them, and a helper
// that panics with what it saw is what makes their failures readable.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod balancer;
mod browser;
mod collector;
mod compose;
mod dump;
mod house;
mod http;
mod postgres;
mod process;
mod program;
mod python;
mod site;
pub mod spec;
mod strace;

use std::time::{Duration, Instant};

pub use balancer::Balancer;
pub use browser::Browser;
pub use collector::{Collector, Taken};
pub use compose::{Compose, docker, logged, run};
pub use dump::{Cell, Dump};
pub use house::{across, house};
pub use http::{ask, ask_with_head};
pub use postgres::Postgres;
pub use process::{Background, Coordinator, Run, Sandbox};
pub use program::{example, in_ci, program};
pub use python::{libraries, python, python_folder};
pub use site::Site;
pub use strace::{FILE_CALLS, Strace, SystemCall};

/// A single command or wait that takes longer hangs.
pub const LIMIT: Duration = Duration::from_secs(300);

/// Looks until `look` has seen what it looks for. Panics, saying `what`, when that takes past [`LIMIT`].
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(seen) = look() {
            return seen;
        }
        assert!(began.elapsed() < LIMIT, "waited {LIMIT:?} in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Panics unless both results are the same, telling where they begin to differ.
pub fn assert_same(a: &[u8], b: &[u8], what: &str) {
    let first = a.iter().zip(b).position(|(x, y)| x != y);
    assert!(
        a == b,
        "{what}: {} bytes against {}, first different at {first:?}",
        a.len(),
        b.len()
    );
}
