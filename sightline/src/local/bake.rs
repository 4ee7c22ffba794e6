//! A bake in this process.

use std::sync::Arc;
use std::time::Duration;

use sightline_coordinator::Coordinator;
use sightline_model::JobSpec;
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_traces::{SpanTime, Traces};
use sightline_worker::{Backends, SceneCache, TracedScene, TracerSelection};
use tonic::{Response, Status};

use super::Local;
use super::coordinator::{close, interrupted, open_at, serve};
use super::partition::partition;
use super::search::TracerSearch;
use super::workers::Workers;
use crate::client::{Job, Submission, fetch, fetch_to, follow, send_spans};
use crate::error::Error;
use crate::observer::{Observer, cancelled, note};
use crate::output::{Format, Output};
use crate::process::{default_name, runtime, threads, use_threads};
use crate::result::open;
use crate::tracers::{TracerOption, note_missing};

/// The outcome of a bake.
#[derive(Debug)]
pub struct Baked {
    /// The job in its last state.
    pub job: Job,
    /// True if the data directory already contained the result, so that this call computed no tile.
    pub from_store: bool,
    /// The result.
    pub pvs: Pvs,
}

/// Bakes a scene in this process. Finished tiles are stored in the data directory, so that the same call
/// continues after an interruption.
///
/// ```no_run
/// use sightline::{Cells, JobOptions, LoadOptions, Local, SceneSource, Silent};
///
/// let source = SceneSource::File("level.glb".into());
/// let scene = sightline::read_scene(&source, &LoadOptions::default(), &Silent)?;
/// let options = JobOptions { cells: Some(Cells::Grid([16, 4, 16])), ..Default::default() };
/// let job = options.resolve(&scene, &Silent)?;
/// let baked = sightline::bake(&scene, &job, &Local::default(), &Silent)?;
/// println!("{} cells", baked.pvs.cells());
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the data directory cannot be used, [`crate::ErrorKind::Usage`] if the
/// output file cannot be written, [`crate::ErrorKind::Job`] if the job fails, or
/// [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn bake(
    scene: &Arc<Scene>,
    job: &JobSpec,
    local: &Local,
    observer: &dyn Observer,
) -> Result<Baked, Error> {
    let search = TracerSearch::begin(TracerOption(job.tracer()));
    bake_after(search, scene, job, local, observer)
}

/// Bakes a scene like [`bake`], with the tracers of a search that was started before.
///
/// # Errors
/// As for [`bake`].
pub fn bake_after(
    search: TracerSearch,
    scene: &Arc<Scene>,
    job: &JobSpec,
    local: &Local,
    observer: &dyn Observer,
) -> Result<Baked, Error> {
    local.check()?;
    use_threads(threads(None))?;
    let output = local.output.as_deref();
    let output = output.map(|path| Output::check(path, Format::Pvs, None));
    let output = output.transpose()?;
    let loaded = Arc::new(TracedScene::new(Arc::clone(scene))?);
    let search = search.then_warm(&loaded, job);
    partition(&loaded, job, observer)?;
    let traces = local.traces.start("sightline-bake", &default_name()?)?;
    let _flush_guard = traces.flush_guard();
    let (coordinator, data_dir) = open_at(local.data_dir.as_deref(), observer)?;
    coordinator.send_traces(traces.clone());
    let runtime = runtime()?;
    let kept = Arc::clone(&coordinator);
    let bake = LocalBake {
        coordinator,
        loaded,
        spec: job,
        local,
        traces,
        observer,
    };
    let outcome = runtime.block_on(bake.run(search, output.as_ref()));
    // Running tiles are abandoned, because waiting for them could take minutes.
    runtime.shutdown_timeout(Duration::from_millis(200));
    close(kept);
    let (job, from_store, bytes) =
        outcome.map_err(|e| e.or_cancelled(|| interrupted(&data_dir)))?;
    let pvs = match &output {
        Some(output) => open(output.path())?,
        None => Pvs::from_bytes(bytes)?,
    };
    Ok(Baked {
        job,
        from_store,
        pvs,
    })
}

/// Returns the job in an answer of the coordinator.
fn job_of(answer: Result<Response<v1::Job>, Status>) -> Result<Job, Error> {
    let answer = answer.map_err(|s| Error::status(&s))?;
    Ok(answer.into_inner().into())
}

/// A bake with its coordinator.
struct LocalBake<'a> {
    coordinator: Arc<Coordinator>,
    loaded: Arc<TracedScene>,
    spec: &'a JobSpec,
    local: &'a Local,
    traces: Traces,
    observer: &'a dyn Observer,
}

impl LocalBake<'_> {
    fn note(&self, text: impl Into<String>) {
        note(self.observer, text);
    }

    /// Submits the job, computes it unless the store has its result, and downloads the result. The result
    /// goes to the output file, or is returned as bytes if there is none.
    async fn run(
        self,
        search: TracerSearch,
        output: Option<&Output>,
    ) -> Result<(Job, bool, Vec<u8>), Error> {
        let (url, server, mut client) = serve(&self.coordinator).await?;
        let begun = SpanTime::now();
        let (taker, here) = (Arc::clone(&self.coordinator), Arc::clone(&self.loaded));
        tokio::task::spawn_blocking(move || taker.take_scene(here.scene.scene()))
            .await
            .map_err(Error::internal)?
            .map_err(|e| Error::input(format!("{e}; --data-dir selects another directory")))?;
        let uploaded = SpanTime::now();
        let mut answer = self.submit(&mut client).await?;
        send_spans(&self.traces, &answer, begun, uploaded);
        let mut job = Job::from(answer.job.take().unwrap_or_default());
        if job.is_done() && job.message().tiles_set_aside > 0 {
            let aside = job.message().tiles_set_aside;
            self.note(format!(
                "an earlier run set {aside} tiles aside; this run computes these tiles again"
            ));
            let request = v1::ShowRequest { job: job.id() };
            job = job_of(client.retry(request).await)?;
        }
        let mut backends = None;
        if !job.is_done() {
            let found = self.tracers(search, &job).await?;
            if self.has_lost_profile(&found, &job) {
                self.note(format!(
                    "an earlier run began this bake with the numerics profile {}, which this machine does \
                     not have now; the bake starts again from the first tile",
                    job.message().profile
                ));
                job_of(client.cancel(v1::ShowRequest { job: job.id() }).await)?;
                answer = self.submit(&mut client).await?;
                job = answer.job.take().unwrap_or_default().into();
            }
            backends = Some(found);
        }
        self.coordinator.restrict_to(job.id());
        let from_store = backends.is_none();
        if let Some(backends) = backends {
            if job.is_paused() {
                let request = v1::ShowRequest { job: job.id() };
                job = job_of(client.resume(request).await)?;
            }
            if answer.existing {
                let message = job.message();
                self.note(format!(
                    "continuing: {} of {} tiles are done; the others continue from their last \
                     finished phase",
                    message.tiles_done, message.tiles_total
                ));
            }
            job = self.compute(&mut client, &url, &backends, &job).await?;
        } else {
            self.note(match self.spec.time_budget() {
                None => "the result of this bake is in the store already",
                // The time budget continues to run while a bake is interrupted, so the result may come from
                // far less work.
                Some(_) => {
                    "the result of this bake is in the store already, with the quality that its time \
                     budget allowed; another --time-budget or --data-dir starts a new bake"
                }
            });
        }
        job.ensure_done()?;
        let mut bytes = Vec::new();
        match output {
            Some(output) => fetch(&mut client, &job, output).await?,
            None => {
                let take = |data: &[u8]| {
                    bytes.extend_from_slice(data);
                    Ok(())
                };
                fetch_to(&mut client, &job, take).await?
            }
        };
        server.abort();
        Ok((job, from_store, bytes))
    }

    async fn submit(
        &self,
        client: &mut JobsClient<Connection>,
    ) -> Result<v1::SubmitResponse, Error> {
        let submission = Submission {
            name: self.local.name.clone(),
            user: Some(String::new()),
            ..Submission::default()
        };
        let answer = client.submit(submission.request(self.spec)).await;
        Ok(answer.map_err(|s| Error::status(&s))?.into_inner())
    }

    /// Waits for the search, and returns the tracers of this machine for a job.
    async fn tracers(&self, search: TracerSearch, job: &Job) -> Result<Arc<Backends>, Error> {
        let mut found = search.end().await?;
        // An earlier run may have bound the job to a software rasteriser.
        if found.skipped_software() && job.message().profile.starts_with("gpu/") {
            found = TracerSearch::begin_for(TracerSelection::Auto).end().await?;
        }
        if self.spec.tracer().is_some() {
            note_missing(&found, self.observer)?;
        }
        Ok(found)
    }

    /// Returns true if the job is bound to a numerics profile that this machine no longer has.
    fn has_lost_profile(&self, found: &Backends, job: &Job) -> bool {
        let profile = &job.message().profile;
        self.spec.tracer().is_some() && !profile.is_empty() && !found.profiles().contains(profile)
    }

    /// Computes the tiles of a job with workers in this process. Returns the job in its last state.
    async fn compute(
        &self,
        client: &mut JobsClient<Connection>,
        url: &str,
        backends: &Arc<Backends>,
        job: &Job,
    ) -> Result<Job, Error> {
        // The scene is already in the memory of this process.
        let scenes = Arc::new(SceneCache::holding(
            self.spec.scene,
            Arc::clone(&self.loaded),
        ));
        let mut workers = Workers::start(self.local, &self.traces, url, backends, &scenes);
        let ended = tokio::select! {
            job = follow(client, job.id(), self.observer) => job,
            e = workers.failure() => Err(e),
            () = cancelled(self.observer) => Err(Error::cancelled("interrupted")),
        };
        workers.end().await;
        ended
    }
}
