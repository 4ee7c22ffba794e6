//! The specification of a job: what is computed for a scene, and how.
//!
//! A job is a sum: a task has a method, a method its sampling, a sampler its cells and its parameters. What
//! does not go together cannot be written. `limits.rs` has the few combinations that can be written and are
//! not built.

mod ambient;
pub mod cells;
mod fit;
pub mod json;
mod limits;
pub mod message;
pub mod names;
pub mod numbers;
mod planned;
pub mod sampler;
mod visibility;

use prost::Message as _;
use sightline_viewcells::{DivisionError, PartMaskError, Plan, RegionError, TreeError};

pub use ambient::Ambient;
pub use fit::SceneFacts;
pub use planned::PlannedJob;
pub use visibility::{Method, Visibility};

use names::{TracerChoice, UnknownValue};
use numbers::{OutOfRange, TimeBudget};

/// The version of everything that decides bytes. It changes whenever the same specification would give other
/// bytes, of a result or of a tile's output, so that a stored result is never taken for one of another
/// version. The choices that it stands for are in `crates/bake/src/choices.rs`.
pub const ALGORITHM_VERSION: u32 = 28;

/// A checked specification.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// BLAKE3 digest of the scene.
    pub scene: [u8; 32],
    /// What is computed.
    pub task: Task,
}

/// What a job computes.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// The sets of view cells.
    Visibility(Visibility),
    /// Ambient occlusion at receivers.
    Ambient(Ambient),
}

/// Why a specification is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A value is missing, malformed, or does not fit.
    #[error("the job's {0} cannot be used: {1}")]
    Value(&'static str, &'static str),
    /// Two values go together in no job that is built.
    #[error("{0} cannot be combined with {1} yet; leave one of them out")]
    Combination(&'static str, &'static str),
    /// A number is outside its range.
    #[error(transparent)]
    Range(#[from] OutOfRange),
    /// A name or its number is unknown.
    #[error(transparent)]
    Name(#[from] UnknownValue),
    /// The view box cannot be divided.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// The boxes are no tree.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// The marks of viewpoints cannot be read.
    #[error(transparent)]
    Viewpoints(#[from] PartMaskError),
    /// The region of viewpoints cannot be read.
    #[error(transparent)]
    Region(#[from] RegionError),
}

impl SpecError {
    /// The error of a message that needs the scene's bounds as its view box, where they are not known.
    pub const NO_VIEW_BOX: Self = Self::new("view-box", "give x0,y0,z0,x1,y1,z1");

    pub(crate) const fn new(option: &'static str, remedy: &'static str) -> Self {
        Self::Value(option, remedy)
    }

    pub(crate) const fn combination(option: &'static str, other: &'static str) -> Self {
        Self::Combination(option, other)
    }

    /// Returns the name of the option at fault, without dashes, where it is one.
    pub fn option(&self) -> Option<&'static str> {
        match self {
            Self::Value(option, _) | Self::Combination(option, _) => Some(option),
            Self::Range(e) => Some(e.option),
            Self::Name(e) => Some(e.parameter),
            Self::Viewpoints(_) | Self::Region(_) => Some("viewpoints"),
            Self::Tree(_) => Some("cells"),
            Self::Division(e) => Some(match e {
                DivisionError::Box { .. } => "view-box",
                DivisionError::Cells { .. }
                | DivisionError::TooFine { .. }
                | DivisionError::TooThin { .. }
                | DivisionError::Plane(_) => "cells",
                DivisionError::Adaptive { .. } => "max-depth",
            }),
        }
    }
}

impl JobSpec {
    /// Makes the job of a method, with the defaults of everything else.
    pub fn new(scene: [u8; 32], method: Method) -> Self {
        let task = Task::Visibility(method.into());
        Self { scene, task }
    }

    /// Makes a job of ambient occlusion.
    pub fn of_receivers(scene: [u8; 32], ambient: Ambient) -> Self {
        let task = Task::Ambient(ambient);
        Self { scene, task }
    }

    /// Returns the task of visibility; `None` for ambient occlusion.
    pub fn visibility(&self) -> Option<&Visibility> {
        match &self.task {
            Task::Visibility(task) => Some(task),
            Task::Ambient(_) => None,
        }
    }

    /// Returns the task of ambient occlusion; `None` for visibility.
    pub fn ambient(&self) -> Option<&Ambient> {
        match &self.task {
            Task::Ambient(ambient) => Some(ambient),
            Task::Visibility(_) => None,
        }
    }

    /// Returns the time after submission when the work stops with what is found by then.
    pub fn time_budget(&self) -> Option<TimeBudget> {
        self.visibility().and_then(Visibility::time_budget)
    }

    /// Returns the choice of a tracer; `None` for a job that needs none and runs on
    /// [`NO_PROFILE`](names::NO_PROFILE).
    pub fn tracer(&self) -> Option<TracerChoice> {
        let sampling = self.visibility().and_then(Visibility::sampling);
        sampling.map(|sampling| sampling.tracer)
    }

    /// Returns true if the result has the scene divided along its walls ([`Visibility::has_portals`]).
    pub fn has_portals(&self) -> bool {
        self.visibility().is_some_and(Visibility::has_portals)
    }

    /// Checks the job against the combinations that are not built.
    ///
    /// # Errors
    /// [`SpecError::Combination`].
    pub fn check(&self) -> Result<(), SpecError> {
        self.visibility().map_or(Ok(()), limits::check)
    }

    /// Computes the job's key: the digest of everything that its result depends on except the numerics
    /// profile, which is bound when the job first runs and is then part of the result.
    pub fn key(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("sightline 2026 job key");
        hasher.update(&ALGORITHM_VERSION.to_le_bytes());
        // Prost writes fields in the order of their numbers, so equal specifications give equal bytes.
        hasher.update(&self.to_message().encode_to_vec());
        *hasher.finalize().as_bytes()
    }

    /// Computes the plan of tiles.
    fn plan(&self) -> Plan {
        match &self.task {
            Task::Visibility(task) => task.plan(),
            Task::Ambient(ambient) => ambient.plan(),
        }
    }
}

#[cfg(test)]
mod tests;
