//! A simulator of a whole cluster: the scheduler's own state machine and the memory store, with a virtual
//! clock, simulated workers, streams and clients, and faults of every kind. A schedule is a function of its
//! seed, so every failure can be repeated.
//!
//! After every event the machine counts its lists again; the world checks that no acknowledged output is
//! lost, that no tile changes its output, that no lease is given twice or outlives its rules, that nothing is
//! leased while an earlier epoch's workers may hold it, and that every job ends once the faults have stopped.
//!
//! ```text
//! SIGHTLINE_SCHEDULES=1000000 cargo test --workspace --release --lib -- --ignored many_schedules
//! ```

mod coordinator;
mod faults;
mod parts;
mod run;
mod seeds;
mod workers;
mod world;
