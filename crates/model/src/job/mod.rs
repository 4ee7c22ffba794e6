//! The specification of a job: a computation for a scene.
//!
//! A job is a sum type: a task has a method, a method has a sampling, and a sampler has cells and parameters.
//! Choices that exclude each other cannot be expressed. `limits.rs` lists the few combinations that can be
//! expressed and are not implemented.

mod ambient;
mod by_cost;
pub mod cells;
mod error;
mod field;
mod fit;
pub mod json;
mod limits;
pub mod message;
pub mod names;
pub mod numbers;
mod planned;
pub mod sampler;
mod spec;
mod visibility;

pub use ambient::Ambient;
pub use by_cost::{CellBudget, CellsByCost};
pub use error::{OutOfRange, SpecError, UnknownValue};
pub use field::FieldValue;
pub use fit::{MOST_FINE_BYTES, SceneFacts};
pub use planned::PlannedJob;
pub use spec::{ALGORITHM_VERSION, JobSpec, Task};
pub use visibility::{Method, Visibility};

#[cfg(test)]
mod tests;
