//! The specification of a job, and the job's key.

use prost::Message as _;
use sightline_viewcells::Plan;

use super::names::TracerChoice;
use super::numbers::TimeBudget;
use super::{Ambient, Method, SpecError, Visibility, limits};

/// The version of all code and constants that determine bytes.
///
/// The version changes if the same specification would result in other bytes of a result or of a tile's
/// output. A stored result is therefore never mistaken for a result of another version.
/// `crates/bake/src/choices.rs` lists the choices that the version covers.
pub const ALGORITHM_VERSION: u32 = 31;

/// A checked specification.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// The BLAKE3 digest of the scene.
    pub scene: [u8; 32],
    /// The computation.
    pub task: Task,
}

/// A computation for a scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// The visible sets of view cells.
    Visibility(Visibility),
    /// Ambient occlusion at receivers.
    Ambient(Ambient),
}

impl JobSpec {
    /// Creates a job of this method, with the defaults of all other values.
    pub fn new(scene: [u8; 32], method: Method) -> Self {
        let task = Task::Visibility(method.into());
        Self { scene, task }
    }

    /// Creates a job of ambient occlusion.
    pub fn of_receivers(scene: [u8; 32], ambient: Ambient) -> Self {
        let task = Task::Ambient(ambient);
        Self { scene, task }
    }

    /// Returns the task of visibility, or `None` for ambient occlusion.
    pub fn visibility(&self) -> Option<&Visibility> {
        match &self.task {
            Task::Visibility(task) => Some(task),
            Task::Ambient(_) => None,
        }
    }

    /// Returns the task of ambient occlusion, or `None` for visibility.
    pub fn ambient(&self) -> Option<&Ambient> {
        match &self.task {
            Task::Ambient(ambient) => Some(ambient),
            Task::Visibility(_) => None,
        }
    }

    /// Returns the duration from submission until the work stops, or `None` for unlimited time.
    pub fn time_budget(&self) -> Option<TimeBudget> {
        self.visibility().and_then(Visibility::time_budget)
    }

    /// Returns the choice of a tracer. Returns `None` for a job that needs no tracer and runs on
    /// [`NO_PROFILE`](super::names::NO_PROFILE).
    pub fn tracer(&self) -> Option<TracerChoice> {
        let sampling = self.visibility().and_then(Visibility::sampling);
        sampling.map(|sampling| sampling.tracer)
    }

    /// Returns true if the result contains the scene's division along its walls
    /// ([`Visibility::has_portals`]).
    pub fn has_portals(&self) -> bool {
        self.visibility().is_some_and(Visibility::has_portals)
    }

    /// Checks that the job is a combination that is implemented.
    ///
    /// # Errors
    /// [`SpecError::Combination`] for the first combination that is not implemented.
    pub fn check(&self) -> Result<(), SpecError> {
        self.visibility().map_or(Ok(()), limits::check)
    }

    /// Computes the job's key: the digest of all values that the result depends on, except the numerics
    /// profile. The profile is fixed when the job first runs and is part of the result.
    pub fn key(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("sightline 2026 job key");
        hasher.update(&ALGORITHM_VERSION.to_le_bytes());
        // Prost writes fields in the order of their numbers, so equal specifications result in equal bytes.
        hasher.update(&self.to_message().encode_to_vec());
        *hasher.finalize().as_bytes()
    }

    /// Computes the plan of tiles.
    pub(super) fn plan(&self) -> Plan {
        match &self.task {
            Task::Visibility(task) => task.plan(),
            Task::Ambient(ambient) => ambient.plan(),
        }
    }
}
