//! Reports on the costs of a result and their reasons.
//!
//! A report lists the cells over a budget with their costliest objects, and *blame*: the number of cells that
//! see an object, the opening through which these cells see the object, and the saving if the opening were
//! closed. `docs/report.md` describes the command.
//!
//! # Modules
//!
//! - `costs`, `budget`: [`Costs`] of objects, and the cells over a [`Budget`].
//! - `blame`, `openings`: [`blame()`], from sampled segments, and the [`Opening`]s that most segments pass.
//! - `page`, `plots`: [`page()`] writes all parts as one HTML document, with the error that `crates/measure`
//!   found.
//!
//! # Invariants
//!
//! - Costs are counted from the sets and are exact. Blame is an estimate from sampled segments.
//! - The document contains no scripts.

pub mod blame;
pub mod budget;
pub mod costs;
pub mod openings;
pub mod page;
pub mod plots;

pub use blame::{Blame, Blamed, blame};
pub use budget::{Budget, OverBudget, over_budget};
pub use costs::{Costs, Group};
pub use openings::Opening;
pub use page::{Divisions, PageHeader, page};

/// The reason why a report cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The result cannot be read.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// Rays cannot be traced.
    #[error(transparent)]
    Backend(#[from] sightline_trace::TracerError),
}
