//! The scheduler: jobs that have not ended, their tiles, the connected workers and the leases.
//!
//! [`Scheduler`] decides which worker gets which tile, from events and the time only; the store keeps the
//! results. Its state can be derived again from the store and from the workers' introductions.
//!
//! `state` has the state and the dispatch of events. `jobs`, `leases`, `workers`, `crews`, `failures`,
//! `deaths`, `spot_checks`, `profile_binding`, `shares` and `grants` have the transitions of their subjects.
//! `pools` and `queue` are the lists that make these cheap. `worker_list`, `tile_status`, `counts`,
//! `tile_workers`, `ineligible` and `progress_rate` compute reports, and `invariants` counts everything
//! again.

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
pub use self::ineligible::Unable;
pub use self::job::{Job, Output, cells_total};
pub use self::messages::{
    Grant, Introduction, Joined, NameTaken, Now, ProfileTime, Progress, WorkerCommand,
};
pub use self::profile_choice::choose_profile;
pub use self::state::{Admitted, NoTile, Scheduler, Settings};
pub use self::tile_status::TileStatus;
pub use self::tile_workers::Team;
pub use self::worker_list::{LeasedTile, WorkerStatus};
