//! What a result costs and why: cells over a budget with the objects that cost most there, and *blame*: from
//! how many cells an object is seen, through which opening, and what closing the opening would save.
//!
//! Costs are counted from the sets and are exact. Blame is an estimate from sampled segments, as
//! [`blame()`] says. [`page()`] writes both, with the error that `sightline-measure` found, as one document.

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
pub use page::{About, page};

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The result cannot be read.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// Rays cannot be traced.
    #[error(transparent)]
    Backend(#[from] sightline_trace::BackendError),
}
