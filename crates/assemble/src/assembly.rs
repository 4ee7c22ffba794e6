//! The parts of a result that is to be written.

use std::fs::File;

use sightline_model::PlannedJob;
use sightline_pvs::Items;

use crate::SceneSummary;

/// A job whose result is written.
pub struct Assembly<'a, O> {
    /// The job.
    pub job: &'a PlannedJob,
    /// The numerics profile that its tiles were computed with.
    pub profile: &'a str,
    /// The number of samples of its done tiles.
    pub samples: u64,
    /// The facts about its scene.
    pub scene: &'a SceneSummary,
    /// The items that its sets name ([`items`](crate::items)); `None` for triangles.
    pub items: Option<Items>,
    /// The outputs of its tiles.
    pub outputs: &'a O,
    /// A file for certificates until they have their place in the result; without one they are in memory.
    pub scratch: Option<File>,
}
