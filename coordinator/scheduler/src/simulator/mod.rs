//! A simulator of a whole cluster. The scheduler's own state machine runs with a virtual clock, simulated
//! workers, streams and clients, and faults of every kind. Records are in the memory store, or in the real
//! store and blobs on a simulated disk that fails. A schedule is a function of its seed, so every failure can
//! be repeated.
//!
//! After every event the scheduler recomputes its lists. The world checks that no acknowledged output is
//! lost, that no tile changes its output, and that no lease is given twice or outlives its rules. It checks
//! that no tile is leased while an earlier epoch's workers may hold it, and that every job ends once the
//! faults have stopped.
//!
//! ```text
//! SIGHTLINE_SCHEDULES=1000000 cargo test --workspace --release --lib -- --ignored many_schedules
//! ```

mod coordinator;
mod faults;
mod ground;
mod parts;
mod run;
mod seeds;
mod workers;
mod world;
