//! The plan of a bake: a job with its scene and its tiles, in a folder.

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

/// A plan that was written. Serialised, it is the document that `sightline plan --json` prints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Planned {
    /// The folder, or the place in a bucket.
    pub output: String,
    /// The number of tiles.
    pub tiles: u32,
    /// The numerics profile with which every tile must be computed.
    pub profile: String,
}

/// Writes the plan of a job to a folder, or to a prefix in a bucket (`s3://BUCKET/PREFIX`). The tracer of
/// this machine that suits the job decides the numerics profile. The [module](super) has an example.
///
/// # Errors
/// [`crate::ErrorKind::Usage`] for a job with a time budget, [`crate::ErrorKind::Input`] for a folder that
/// holds another bake, [`crate::ErrorKind::Internal`] for a machine without a suitable tracer.
pub fn plan(
    scene: &Arc<Scene>,
    job: &JobSpec,
    dir: &str,
    observer: &dyn Observer,
) -> Result<Planned, Error> {
    if job.time_budget().is_some() {
        return Err(Error::usage(
            "--time-budget counts from the submission of a job, and the tiles of a plan are computed at any \
             time; leave it out",
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

/// Chooses the numerics profile as a bake on this machine does.
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
            "no backend of this machine suits the job; it has: {}",
            probed.profiles().join(", ")
        ))
    })
}
