//! The specification of a job, and its key.

use prost::Message as _;
use sightline_viewcells::Plan;

use super::names::TracerChoice;
use super::numbers::TimeBudget;
use super::{Ambient, Method, SpecError, Visibility, limits};

/// The version of everything that decides bytes. It changes whenever the same specification would give other
/// bytes, of a result or of a tile's output, so that a stored result is never taken for one of another
/// version. The choices that it stands for are in `crates/bake/src/choices.rs`.
pub const ALGORITHM_VERSION: u32 = 28;

/// A checked specification.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// BLAKE3 digest of the scene.
    pub scene: [u8; 32],
    /// The computation.
    pub task: Task,
}

/// A computation for a scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// The sets of view cells.
    Visibility(Visibility),
    /// Ambient occlusion at receivers.
    Ambient(Ambient),
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

    /// Returns the time after submission when the work stops.
    pub fn time_budget(&self) -> Option<TimeBudget> {
        self.visibility().and_then(Visibility::time_budget)
    }

    /// Returns the choice of a tracer; `None` for a job that needs none and runs on
    /// [`NO_PROFILE`](super::names::NO_PROFILE).
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
    pub(super) fn plan(&self) -> Plan {
        match &self.task {
            Task::Visibility(task) => task.plan(),
            Task::Ambient(ambient) => ambient.plan(),
        }
    }
}
