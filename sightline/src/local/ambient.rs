//! Ambient occlusion in this process.

use std::sync::Arc;
use std::time::Duration;

use sightline_proto::v1;
use sightline_scene::Scene;
use sightline_traces::Traces;
use sightline_worker::{Backends, SceneCache, TracedScene, TracerSelection};

use super::Local;
use super::coordinator::{close, interrupted, open_at, serve};
use super::workers::Workers;
use crate::ambient::{AmbientResult, OrderedReceivers, fetch, submit};
use crate::client::{Job, Submission, follow};
use crate::error::Error;
use crate::observer::{Observer, cancelled, note};
use crate::process::runtime;

/// Computes the ambient occlusion of receivers in this process. Finished tiles are stored in the data
/// directory, so that the same call continues after an interruption. The call does not use `output` and
/// `traces` of `local`. [`OrderedReceivers`] has an example.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the data directory cannot be used, [`crate::ErrorKind::Job`] if the job
/// fails, or [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn ambient(
    scene: &Arc<Scene>,
    receivers: &OrderedReceivers,
    local: &Local,
    observer: &dyn Observer,
) -> Result<AmbientResult, Error> {
    local.check()?;
    let loaded = Arc::new(TracedScene::new(Arc::clone(scene))?);
    // The job does not use a tracer. The search for the cpu backend ends immediately.
    let backends = Arc::new(Backends::probe(TracerSelection::Cpu, Default::default()));
    let (coordinator, data_dir) = open_at(local.data_dir.as_deref(), observer)?;
    let runtime = runtime()?;
    let kept = Arc::clone(&coordinator);
    let done = runtime.block_on(async {
        let (url, server, mut client) = serve(&coordinator).await?;
        let submission = Submission {
            name: local.name.clone(),
            user: Some(String::new()),
            ..Submission::default()
        };
        let (mut job, _) = submit(&mut client, scene, receivers, &submission, observer).await?;
        coordinator.restrict_to(job.id());
        if !job.is_done() {
            if job.is_paused() {
                let request = v1::ShowRequest { job: job.id() };
                let resumed = client.resume(request).await;
                job = Job::from(resumed.map_err(|s| Error::status(&s))?.into_inner());
            }
            let (done, total) = (job.message().tiles_done, job.message().tiles_total);
            if done > 0 {
                note(
                    observer,
                    format!("continuing: {done} of {total} tiles are done"),
                );
            }
            let scenes = Arc::new(SceneCache::holding(scene.digest().0, Arc::clone(&loaded)));
            let mut workers = Workers::start(local, &Traces::default(), &url, &backends, &scenes);
            let ended = tokio::select! {
                job = follow(&mut client, job.id(), observer) => job,
                e = workers.failure() => Err(e),
                () = cancelled(observer) => Err(Error::cancelled("interrupted")),
            };
            workers.end().await;
            job = ended?;
        }
        let openness = fetch(&mut client, &job, receivers).await?;
        server.abort();
        Ok(AmbientResult { job, openness })
    });
    // Running tiles are abandoned.
    runtime.shutdown_timeout(Duration::from_millis(200));
    close(kept);
    done.map_err(|e: Error| e.or_cancelled(|| interrupted(&data_dir)))
}
