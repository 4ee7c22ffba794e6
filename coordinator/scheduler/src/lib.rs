//! The scheduler: jobs that have not ended, their tiles, the connected workers and the leases.
//!
//! [`Scheduler`] decides which worker gets which tile. It receives an [`Event`] and the time, and returns
//! [`Effect`]s; a call of the store is an effect, and its outcome is a later event
//! (`docs/decisions/0008-scheduler-as-a-state-machine.md`). The store holds the results.
//!
//! # Modules
//!
//! - `state`, `event`, `messages`: the state and the dispatch of events, and the messages to workers.
//! - `jobs`, `leases`, `workers`, `crews`, `failures`, `deaths`, `spot_checks`, `profile_binding`, `shares`,
//!   `grants`: the transitions of their subjects.
//! - `pools`, `queue`: the lists that make the choice of tiles and workers cheap.
//! - `worker_list`, `tile_status`, `counts`, `tile_workers`, `ineligible`, `progress_rate`: reports.
//! - `invariants`, `simulator`: checks that compute all lists and totals a second time; a simulator of a
//!   whole cluster with faults.
//!
//! # Invariants
//!
//! - The state is a function of the events: the crate has no clock, lock, thread or store. Its state can be
//!   derived again from the store and from the introductions of workers.
//! - Totals are derived from the states of tiles, and tests and the simulator count them again.
//! - A tile is set aside after failures on three workers, or after five failures. Faults of machines and
//!   networks are retried with growing delays, and count as failures from the twelfth on. The death of a
//!   worker counts as a failure of the tile that the worker received first, until the same process returns.
//! - All tiles of a job have one numerics profile. `--backend auto` binds a job to a hardware GPU that is
//!   twice as fast as the CPU, and otherwise to the CPU.
//! - A spot check computes a tile without helpers, if possible on a worker that did not compute the tile, and
//!   its output is compared and not stored. A job ends only after the checks of its drawn tiles, or with a
//!   record that checks were impossible. Results that are no longer trusted are opened again in the store,
//!   and outputs of earlier leases do not count.
//!
//! # Limits
//!
//! - No preemption: a tile would restart from its beginning. `pause --now` stops tiles.
//! - No scheduling by cost: tiles follow the order of the plan. A worker holds a second tile only while no
//!   other worker is idle. At the end of a job an idle worker computes the slowest tile once more, except in
//!   bakes in one process and in jobs with a time budget.
//! - No durable leases: after a restart, no worker gets the tiles of a running job for 2.5 s, so that workers
//!   with earlier leases can return.

mod counts;
mod crew;
#[cfg(test)]
mod crew_tests;
mod crews;
mod death;
#[cfg(test)]
mod death_tests;
mod deaths;
mod event;
mod failures;
mod grants;
mod ineligible;
#[cfg(test)]
mod invariants;
mod job;
mod jobs;
#[cfg(test)]
mod lease_tests;
mod leases;
mod messages;
mod pools;
mod profile_binding;
mod profile_choice;
mod progress_rate;
mod queue;
#[cfg(test)]
mod share_tests;
mod shares;
#[cfg(test)]
mod simulator;
mod spot_check;
#[cfg(test)]
mod spot_check_tests;
mod spot_checks;
mod state;
#[cfg(test)]
mod tests;
mod tile_status;
mod tile_workers;
mod worker_list;
mod worker_totals;
mod workers;

pub use self::counts::Counts;
pub use self::event::{Departure, Effect, Event, Failure, Note, StoreCommand};
pub use self::ineligible::Ineligible;
pub use self::job::{OpenJob, Output, cells_total};
pub use self::messages::{
    Grant, Introduction, Joined, NameTaken, Now, ProfileTime, Progress, WorkerCommand,
};
pub use self::profile_choice::choose_profile;
pub use self::state::{Admission, NoTile, Right, Scheduler, Settings};
pub use self::tile_status::TileStatus;
pub use self::tile_workers::TileWorkers;
pub use self::worker_list::{LeasedTile, WorkerStatus};
