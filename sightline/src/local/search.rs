//! The search for tracers in the background, because starting drivers may take longer than reading most
//! scenes.

use std::sync::Arc;

use sightline_model::{JobSpec, Sampler, TracerChoice, Visibility};
use sightline_trace::CubeSpec;
use sightline_worker::{Backends, TracedScene, TracerSelection};

use crate::error::Error;
use crate::tracers::{TracerOption, selection};

/// A search for tracers that runs in the background.
///
/// ```no_run
/// use sightline::{JobOptions, Local, LoadOptions, SceneSource, Silent, TracerSearch, read_scene};
///
/// let search = TracerSearch::begin(Default::default());
/// let source = SceneSource::File("level.glb".into());
/// let scene = read_scene(&source, &LoadOptions::default(), &Silent)?;
/// let job = JobOptions::default().resolve(&scene, &Silent)?;
/// let baked = sightline::bake_after(search, &scene, &job, &Local::default(), &Silent)?;
/// # Ok::<(), sightline::Error>(())
/// ```
pub struct TracerSearch(Option<std::thread::JoinHandle<Arc<Backends>>>);

impl std::fmt::Debug for TracerSearch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("TracerSearch")
    }
}

impl TracerSearch {
    /// Starts the search for the tracer of a job. A job without a tracer accepts any tracer, or none.
    pub fn begin(tracer: TracerOption) -> Self {
        Self::begin_for(match selection(tracer.0.unwrap_or(TracerChoice::Auto)) {
            TracerSelection::Auto => TracerSelection::Fast,
            selection => selection,
        })
    }

    /// Starts the search for a selection of tracers.
    pub(super) fn begin_for(selection: TracerSelection) -> Self {
        Self(Some(std::thread::spawn(move || {
            Arc::new(Backends::probe(selection, Default::default()))
        })))
    }

    /// Prepares the tracing of sight lines after the search, while the scene is stored and the job is
    /// planned.
    pub(super) fn then_warm(mut self, loaded: &Arc<TracedScene>, job: &JobSpec) -> Self {
        let sampling = job.visibility().and_then(Visibility::sampling);
        if let Some(sampling) = sampling
            && !matches!(sampling.sampler, Sampler::Cubes { .. })
            && let Some(search) = self.0.take()
        {
            let (loaded, cubes) = (
                Arc::clone(loaded),
                CubeSpec::from_sampler(&sampling.sampler),
            );
            self.0 = Some(std::thread::spawn(move || {
                let backends = search
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                loaded.warm(&backends, cubes);
                backends
            }));
        }
        self
    }

    /// Waits for the end of the search.
    pub(super) async fn end(mut self) -> Result<Arc<Backends>, Error> {
        let panicked = || Error::internal("the search for backends panicked; report this fault");
        let thread = self.0.take().ok_or_else(panicked)?;
        let joined = tokio::task::spawn_blocking(move || thread.join()).await;
        joined.map_err(Error::internal)?.map_err(|_| panicked())
    }
}

impl Drop for TracerSearch {
    /// Waits for the thread, because some drivers crash when the process ends while they start.
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            // The outcome is no longer needed.
            drop(thread.join());
        }
    }
}
