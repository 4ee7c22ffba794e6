//! The shared code of the integration tests: the program under test, its folders and processes, and parsed
//! results.
//!
//! The tests run the program only from outside, like a user; no code here links against it. A test waits by
//! polling, never by sleeping for a fixed time. The limits only convert a hang into a failure.

// The permissions for tests cover only `#[test]` functions, but this code runs inside of them. A helper that
// panics with its observation makes failures readable.
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
pub use collector::{Collector, ReceivedSpan};
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

/// Maximum duration of a single command or wait. Anything longer hangs.
pub const LIMIT: Duration = Duration::from_secs(300);

/// Calls `look` until it returns a value. Panics with `what` if this takes longer than [`LIMIT`].
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

/// Panics unless both results are equal. The message contains the first different offset.
pub fn assert_same(a: &[u8], b: &[u8], what: &str) {
    let first = a.iter().zip(b).position(|(x, y)| x != y);
    assert!(
        a == b,
        "{what}: {} bytes against {}, first different at {first:?}",
        a.len(),
        b.len()
    );
}
