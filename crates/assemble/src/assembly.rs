//! The job, scene and tile outputs from which a result is written.

use std::fs::File;

use sightline_model::PlannedJob;
use sightline_pvs::Items;

use crate::SceneSummary;

/// A job with the data that its result is written from.
pub struct Assembly<'a, O> {
    /// The job.
    pub job: &'a PlannedJob,
    /// The numerics profile with which the job's tiles were computed.
    pub profile: &'a str,
    /// The number of rays or visibility cubes of the job's finished tiles.
    pub samples: u64,
    /// The facts about the job's scene.
    pub scene: &'a SceneSummary,
    /// The items that the job's sets name ([`items`](crate::items)); `None` for triangles.
    pub items: Option<Items>,
    /// The outputs of the job's tiles.
    pub outputs: &'a O,
    /// A temporary file that stores the certificates until the result is written. If `None`, they are in
    /// memory.
    pub scratch: Option<File>,
}
