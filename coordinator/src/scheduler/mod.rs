//! The scheduler: jobs that have not ended, their tiles, the connected workers and the leases.
//!
//! [`Machine`] decides which worker gets which tile, from events and the time only; the store keeps the
//! results. Its state can be derived again from the store and from the workers' introductions.
//!
//! `machine` has the state and the dispatch of events. `jobs`, `leases`, `workers`, `crews`, `failures`,
//! `deaths`, `checking`, `profiles`, `shares` and `granting` have the transitions of their subjects. `pools`
//! and `queue` are the lists that make these cheap. `roster`, `standing`, `counts`, `team`, `unable` and
//! `pace` compute reports, and `checks` counts everything again.

mod binding;
mod checking;
#[cfg(test)]
mod checks;
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
mod granting;
mod job;
mod jobs;
#[cfg(test)]
mod lease_tests;
mod leases;
mod ledger;
mod machine;
mod messages;
mod pace;
mod pools;
mod profiles;
mod queue;
mod roster;
#[cfg(test)]
mod share_tests;
mod shares;
mod spot;
#[cfg(test)]
mod spot_tests;
mod standing;
mod team;
#[cfg(test)]
mod tests;
mod unable;
mod workers;

pub(crate) use self::counts::Counts;
pub(crate) use self::event::{Command, Departure, Effect, Event, Failure, Note};
pub(crate) use self::job::{Job, Output, Work, cells_total};
pub(crate) use self::machine::{Admitted, Machine, NoTile, Settings};
#[cfg(test)]
pub(crate) use self::messages::Grant;
pub(crate) use self::messages::{
    Introduction, Joined, NameTaken, Now, Order, ProfileTime, Progress,
};
pub(crate) use self::roster::{Held, Member};
pub(crate) use self::standing::Standing;
pub(crate) use self::team::Team;
pub(crate) use self::unable::Unable;
