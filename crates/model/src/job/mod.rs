//! The specification of a job: a computation for a scene.
//!
//! A job is a sum: a task has a method, a method its sampling, a sampler its cells and its parameters.
//! Choices that exclude each other cannot be written. `limits.rs` has the few combinations that can be
//! written and are not built.

mod ambient;
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
pub use error::{OutOfRange, SpecError, UnknownValue};
pub use field::FieldValue;
pub use fit::SceneFacts;
pub use planned::PlannedJob;
pub use spec::{ALGORITHM_VERSION, JobSpec, Task};
pub use visibility::{Method, Visibility};

#[cfg(test)]
mod tests;
