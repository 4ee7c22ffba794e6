//! A job with its key and its plan, which each process creates once.

use sightline_viewcells::{DivisionError, Lattice, Plan};

use super::{Ambient, JobSpec, Task, Visibility};

/// A job, decoded and planned.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedJob {
    spec: JobSpec,
    key: [u8; 32],
    plan: Plan,
}

impl PlannedJob {
    /// Plans a new job.
    ///
    /// # Errors
    /// [`DivisionError::TooThin`] if the job's cells are thinner than the rounding of sight lines.
    pub fn new(spec: JobSpec) -> Result<Self, DivisionError> {
        if let Task::Visibility(task) = &spec.task {
            task.rounding_displacement()?;
        }
        Ok(Self::stored(spec))
    }

    /// Plans a job that this version or another version accepted earlier, without the check of [`Self::new`].
    pub fn stored(spec: JobSpec) -> Self {
        Self {
            key: spec.key(),
            plan: spec.plan(),
            spec,
        }
    }

    /// Creates a job with a plan that differs from the specification's, for simulations.
    pub fn with_plan(spec: JobSpec, plan: Plan) -> Self {
        Self {
            key: spec.key(),
            spec,
            plan,
        }
    }

    /// Returns the specification.
    pub fn spec(&self) -> &JobSpec {
        &self.spec
    }

    /// Returns the job's key.
    pub fn key(&self) -> [u8; 32] {
        self.key
    }

    /// Returns the plan of tiles.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Returns the task of visibility; `None` for ambient occlusion.
    pub fn visibility(&self) -> Option<&Visibility> {
        self.spec.visibility()
    }

    /// Returns the task of ambient occlusion; `None` for visibility.
    pub fn ambient(&self) -> Option<&Ambient> {
        self.spec.ambient()
    }

    /// Returns the lattice of sample positions; `None` for a job without cells.
    pub fn lattice(&self) -> Option<&Lattice> {
        self.visibility().map(Visibility::lattice)
    }
}
