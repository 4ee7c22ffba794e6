//! The plan of a bake: a job with its scene and its tiles, in a folder or bucket.

use std::sync::Arc;

use serde::Serialize;
use sightline_coordinator::choose_profile;
use sightline_model::{JobSpec, PlannedJob, TracerChoice};
use sightline_scene::Scene;
use sightline_trace::gpu::AdapterChoice;
use sightline_worker::{Backends, TracedScene, TracerSelection, time_profiles};

use super::place::PlanPlace;
use super::planned::PlannedBake;
use crate::error::Error;
use crate::observer::Observer;
use crate::process::{threads, use_threads};
use crate::tracers::{note_missing, selection};

/// A written plan. Its serialisation is the document that `sightline plan --json` prints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Planned {
    /// The path of the folder, or the address of the bucket's prefix.
    pub output: String,
    /// The number of tiles.
    pub tiles: u32,
    /// The numerics profile with which every tile must be computed.
    pub profile: String,
}

/// Writes the plan of a job to a folder, or to a prefix in a bucket (`s3://BUCKET/PREFIX`). The tracer of
/// this machine that suits the job determines the numerics profile. The [module](super) has an example.
///
/// # Errors
/// [`crate::ErrorKind::Usage`] if the job has a time budget, [`crate::ErrorKind::Input`] if the folder
/// contains another bake, or [`crate::ErrorKind::Internal`] if the machine has no suitable tracer.
pub fn plan(
    scene: &Arc<Scene>,
    job: &JobSpec,
    dir: &str,
    observer: &dyn Observer,
) -> Result<Planned, Error> {
    if job.time_budget().is_some() {
        return Err(Error::usage(
            "--time-budget starts with the submission of a job, but the tiles of a plan are \
             computed at any time; omit --time-budget",
        )
        .about("time-budget"));
    }
    use_threads(threads(None))?;
    let profile = bind_profile(job, scene, observer)?;
    let job = PlannedJob::new(job.clone())?;
    let tiles = job.plan().tiles.len() as u32;
    let bake = PlannedBake {
        place: PlanPlace::open(dir)?,
        job,
        profile,
    };
    bake.write(scene)?;
    Ok(Planned {
        output: dir.to_owned(),
        tiles,
        profile: bake.profile,
    })
}

/// Selects the numerics profile in the same way as a bake on this machine.
fn bind_profile(
    job: &JobSpec,
    scene: &Arc<Scene>,
    observer: &dyn Observer,
) -> Result<String, Error> {
    let choice = job.tracer();
    let selected = match choice {
        None => return Ok(sightline_model::NO_PROFILE.to_owned()),
        Some(TracerChoice::Auto) => TracerSelection::Fast,
        Some(choice) => selection(choice),
    };
    let probed = Backends::probe(selected, AdapterChoice::default());
    note_missing(&probed, observer)?;
    let loaded = TracedScene::new(Arc::clone(scene))?;
    let time = || time_profiles(&probed, &loaded, job, "");
    choose_profile(choice, &probed.profiles(), time).ok_or_else(|| {
        Error::internal(format!(
            "no backend of this machine suits the job; the machine has: {}",
            probed.profiles().join(", ")
        ))
    })
}
