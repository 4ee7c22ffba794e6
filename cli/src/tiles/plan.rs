//! `sightline plan`: a job with its scene and its plan, in a folder.

use std::sync::Arc;

use serde_json::json;
use sightline_coordinator::choose_profile;
use sightline_model::{JobSpec, PlannedJob, TracerChoice};
use sightline_sampling::gpu::AdapterChoice;
use sightline_worker::{Backends, TracedScene, TracerSelection, time_profiles};

use super::place::PlanPlace;
use super::planned::PlannedBake;
use crate::backends;
use crate::error::CliError;
use crate::opening::{self, Source, plural};
use crate::serve::{self, threads};
use crate::tiles_args::PlanArgs;

/// Writes a planned bake.
///
/// # Errors
/// [`CliError`].
pub fn plan(args: &PlanArgs, json: bool) -> Result<(), CliError> {
    if args.job.has_time_budget() {
        return Err(CliError::Usage(
            "--time-budget counts from the submission of a job, and the tiles of a plan are computed at any \
             time; leave it out"
                .to_owned(),
        ));
    }
    serve::use_threads(threads(None))?;
    let source = Source::File(args.scene.clone());
    let scene = Arc::new(opening::read(&source, &args.kinds)?);
    let spec = args.job.spec(source.path(), &scene)?;
    let profile = bound_profile(&spec, &scene)?;
    let job = PlannedJob::new(spec).map_err(|e| CliError::Usage(e.to_string()))?;
    let tiles = job.plan().tiles.len();
    let place = PlanPlace::open(&args.output)?;
    let bake = PlannedBake {
        place,
        job,
        profile,
    };
    bake.write(&scene)?;
    if json {
        let value = json!({ "output": args.output, "tiles": tiles, "profile": bake.profile });
        return serve::print(&value.to_string());
    }
    serve::print(&format!(
        "{}: {} for {}; compute each with `sightline tile {} N`",
        args.output,
        plural(tiles, "tile"),
        bake.profile,
        args.output
    ))
}

/// Chooses the numerics profile as a bake on this machine does.
fn bound_profile(spec: &JobSpec, scene: &Arc<sightline_scene::Scene>) -> Result<String, CliError> {
    let choice = spec.tracer();
    let selection = match choice {
        None => return Ok(sightline_model::NO_PROFILE.to_owned()),
        Some(TracerChoice::Auto) => TracerSelection::Fast,
        Some(choice) => backends::choice(choice),
    };
    let probed = Backends::probe(selection, AdapterChoice::default());
    backends::say_missing(&probed)?;
    let loaded = TracedScene::new(Arc::clone(scene)).map_err(CliError::internal)?;
    let time = || time_profiles(&probed, &loaded, spec, "");
    choose_profile(choice, &probed.profiles(), time).ok_or_else(|| {
        CliError::Internal(format!(
            "no backend of this machine suits the job; it has: {}",
            probed.profiles().join(", ")
        ))
    })
}
