//! Jobs of ambient occlusion in this process: a coordinator on loopback, its data directory, and workers.
//! What is finished is kept, so that the same command goes on after an interruption.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use sightline_model::openness::Openness;
use sightline_model::receivers::Receivers;
use sightline_proto::v1;
use sightline_scene::Scene;
use sightline_traces::Traces;
use sightline_worker::{Backends, SceneCache, TracedScene, TracerSelection};

use crate::ambient_job::{self, Whom};
use crate::baking::{self, Workers};
use crate::client;
use crate::error::CliError;
use crate::progress::{Progress, say};
use crate::serve;

/// Computes receivers with so many workers.
///
/// # Errors
/// [`CliError`]: a data directory in use, a job that fails, or an interruption.
pub fn compute(
    scene: &Arc<Scene>,
    receivers: &Receivers,
    whom: &Whom,
    (workers, data_dir): (usize, Option<&Path>),
) -> Result<(v1::Job, Openness), CliError> {
    let loaded = Arc::new(TracedScene::new(Arc::clone(scene))?);
    // No backend takes part. Embree is there at once, or not at all.
    let backends = Arc::new(Backends::probe(TracerSelection::Cpu, Default::default()));
    let (coordinator, data_dir) = baking::open_at(data_dir)?;
    let runtime = serve::runtime()?;
    let kept = Arc::clone(&coordinator);
    let progress = Progress::new();
    let done = runtime.block_on(async {
        let (url, server, mut client) = baking::on_loopback(&coordinator).await?;
        let mut job = ambient_job::submit(&mut client, scene, receivers, whom).await?;
        coordinator.restrict_to(job.id);
        if job.state() != v1::JobState::Done {
            if job.state() == v1::JobState::Paused {
                let request = v1::ShowRequest { job: job.id };
                job = client
                    .resume(request)
                    .await
                    .map_err(|s| CliError::status(&s))?
                    .into_inner();
            }
            if job.tiles_done > 0 {
                say(&format!(
                    "going on: {} of {} tiles are done",
                    job.tiles_done, job.tiles_total
                ));
            }
            let scenes = Arc::new(SceneCache::holding(scene.digest().0, Arc::clone(&loaded)));
            let mut workers = Workers::start(workers, &Traces::default(), &url, &backends, &scenes);
            let mut show = |job: &v1::Job| progress.job(job, true);
            let ended = tokio::select! {
                job = client::follow(&mut client, job.id, &mut show) => job,
                e = workers.failure() => Err(e),
                () = serve::stop_signal() => Err(CliError::Interrupted("interrupted".to_owned())),
            };
            workers.end().await;
            job = ended?;
        }
        let openness = ambient_job::fetch(&mut client, &job, receivers).await?;
        server.abort();
        Ok((job, openness))
    });
    progress.end();
    // Running tiles are abandoned.
    runtime.shutdown_timeout(Duration::from_millis(200));
    baking::close(kept);
    done.map_err(|e| match e {
        CliError::Interrupted(_) => CliError::Interrupted(format!(
            "interrupted; finished tiles are kept in {}: the same command goes on from there",
            data_dir.display()
        )),
        e => e,
    })
}
