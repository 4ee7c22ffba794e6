//! A bake in this process: a coordinator and workers. They speak the same gRPC as in a cluster, except that
//! the scene is shared in memory.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_coordinator::store::StoreError;
use sightline_coordinator::{
    Config, ConnectionLimits, Connections, Coordinator, Listener, OpenError,
};
use sightline_model::{JobSpec, Method, Sampler, TracerChoice, Visibility};
use sightline_portals::Partition;
use sightline_proto::connecting::{Connection, Credentials};
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_sampling::CubeSpec;
use sightline_scene::kinds::Kind;
use sightline_scene::{Object, Scene};
use sightline_traces::{Begun, Traces};
use sightline_worker::{Backends, SceneCache, Stop, TracedScene, TracerSelection, WorkerError};
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use crate::args::BakeArgs;
use crate::backends;
use crate::client;
use crate::error::CliError;
use crate::opening::{self, Source, plural};
use crate::output::Output;
use crate::progress::{human, say};
use crate::serve::{self, threads};
use crate::traces;

/// Time that stopped workers have to say that they have.
const TO_STOP: Duration = Duration::from_secs(2);
/// Bakes of one user at a time that find a data directory of their own.
const MOST_AT_ONCE: u32 = 16;
/// Time that the coordinator has to end what it does in the background.
const TO_CLOSE: Duration = Duration::from_secs(2);

/// What a bake tells while it runs, and how it is told to stop.
pub struct Hooks<'a> {
    /// Takes each state of the job.
    pub follow: &'a mut dyn FnMut(&v1::Job),
    /// Whether to stop, for work that is done before there is a job.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Resolves when the job is to stop.
    pub stopped: Pin<Box<dyn Future<Output = ()> + 'a>>,
}

fn interrupted() -> CliError {
    CliError::Interrupted("interrupted".to_owned())
}

/// Bakes the scene of `source` into `output`.
pub fn bake(
    args: &BakeArgs,
    source: &Source,
    output: &Output,
    hooks: &mut Hooks<'_>,
) -> Result<Outcome, CliError> {
    let start = Instant::now();
    serve::use_threads(threads(None))?;
    // A job that needs no tracer runs with any backend, or with none.
    let choice = match backends::choice(args.job.backend.0.unwrap_or(TracerChoice::Auto)) {
        TracerSelection::Auto => TracerSelection::Fast,
        choice => choice,
    };
    // Starting drivers may take longer than reading most scenes.
    let probing = Probing::begin(choice);
    let scene = Arc::new(opening::read(source, &args.kinds)?);
    let spec = args.job.spec(source.path(), &scene)?;
    say(&format!(
        "{}: {} in {}, read in {}",
        source.path().display(),
        plural(scene.len() as usize, "triangle"),
        plural(scene.objects().len(), "object"),
        human(start.elapsed())
    ));
    opening::scene_in_words(&scene)
        .iter()
        .for_each(|line| say(line));
    let loaded = Arc::new(TracedScene::new(Arc::clone(&scene))?);
    let probing = probing.then_warm(&loaded, &spec);
    let has_doors = (0..scene.len()).any(|id| scene.kinds().kind(id) == Kind::Door);
    if let Some(task) = spec.visibility()
        && (matches!(task.method, Method::Portals { .. })
            || task.has_portals() && has_doors && task.time_budget().is_none())
    {
        // The workers of this process find it made.
        let partition =
            loaded
                .scene
                .partition(task, hooks.stop)
                .map_err(|e| match (hooks.stop)() {
                    true => interrupted(),
                    false => CliError::internal(e),
                })?;
        let lines = partition_in_words(&partition, &scene);
        lines.iter().for_each(|line| say(line));
    }
    let traces = args
        .traces
        .start("sightline-bake", &serve::default_name()?)?;
    let _sends_the_rest = traces.closing();
    let (coordinator, data_dir) = open_at(args.data_dir.as_deref())?;
    coordinator.send_traces(traces.clone());
    let runtime = serve::runtime()?;
    let kept = Arc::clone(&coordinator);
    let from = (args, source, &traces);
    let outcome = runtime.block_on(run(
        from,
        coordinator,
        &loaded,
        &spec,
        probing,
        output,
        hooks,
    ));
    // Running tiles are abandoned; waiting for them could take minutes.
    runtime.shutdown_timeout(Duration::from_millis(200));
    close(kept);
    outcome.map_err(|e| match e {
        CliError::Interrupted(_) => CliError::Interrupted(format!(
            "interrupted; finished tiles are kept in {}: the same command goes on from there",
            data_dir.display()
        )),
        e => e,
    })
}

/// Opens a data directory, or the usual one.
pub(crate) fn open_at(data_dir: Option<&Path>) -> Result<(Arc<Coordinator>, PathBuf), CliError> {
    match data_dir {
        Some(dir) => Ok((open(dir)?, dir.to_owned())),
        None => open_free(&default_data_dir()?),
    }
}

/// Opens a data directory.
fn open(data_dir: &Path) -> Result<Arc<Coordinator>, CliError> {
    Coordinator::open(Config::new(data_dir.to_owned())).map_err(|e| match e {
        OpenError::Store(StoreError::InUse { pid, .. }) => CliError::Input(format!(
            "{} is in use by process {pid}, probably another bake; wait for it, or give this one another \
             --data-dir",
            data_dir.display()
        )),
        OpenError::Store(e) => CliError::Input(format!("{e} (--data-dir names another)")),
        OpenError::Blobs(e) => CliError::Input(e.to_string()),
    })
}

/// Opens the usual data directory, or, while other bakes use it, another one beside it. What one of them has
/// stored is not known in the others.
fn open_free(usual: &Path) -> Result<(Arc<Coordinator>, PathBuf), CliError> {
    for number in 1..=MOST_AT_ONCE {
        let dir = match number {
            1 => usual.to_owned(),
            number => usual.with_extension(number.to_string()),
        };
        match Coordinator::open(Config::new(dir.clone())) {
            Err(OpenError::Store(StoreError::InUse { pid, .. })) => {
                say(&format!(
                    "note: {} is in use by process {pid}; this bake uses another one",
                    dir.display()
                ));
            }
            Ok(coordinator) => return Ok((coordinator, dir)),
            Err(_) => return open(&dir).map(|coordinator| (coordinator, dir)),
        }
    }
    open(usual).map(|coordinator| (coordinator, usual.to_owned()))
}

/// Closes the coordinator's store, so that this process can open it again. Threads that still hold it after
/// the time keep it open.
pub(crate) fn close(mut coordinator: Arc<Coordinator>) {
    let begin = Instant::now();
    while begin.elapsed() < TO_CLOSE {
        match Arc::try_unwrap(coordinator) {
            Ok(last) => return drop(last),
            Err(again) => coordinator = again,
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// What portals can do for a scene, before the work starts.
fn partition_in_words(partition: &Partition, scene: &Scene) -> Vec<String> {
    let mut lines = vec![match partition.leaves() {
        0 | 1 => "walls divide the space of the viewpoints into no parts, so they hide nothing within it; \
                  exact queries hide more (--method verified)"
            .to_owned(),
        parts => format!("divided along its walls into {}", plural(parts, "part")),
    }];
    let doors = partition.doors();
    let is_door = |o: &&Object| o.count > 0 && scene.kinds().kind(o.first) == Kind::Door;
    let names = scene
        .objects()
        .iter()
        .filter(is_door)
        .map(|o| o.name.as_str());
    let useless: BTreeSet<&str> = names.filter(|name| !doors.contains(name)).collect();
    if !useless.is_empty() {
        lines.push(format!(
            "note: {} cannot be shut at run time, because no opening is covered: a door must lie exactly in \
             the plane of its wall, or within a thick wall",
            useless.into_iter().collect::<Vec<_>>().join(", ")
        ));
    }
    lines
}

/// The search for backends, and the preparations that need its outcome, on a separate thread.
struct Probing(Option<std::thread::JoinHandle<Arc<Backends>>>);

impl Probing {
    fn begin(choice: TracerSelection) -> Self {
        Self(Some(std::thread::spawn(move || {
            Arc::new(Backends::probe(choice, Default::default()))
        })))
    }

    /// After the search, prepares the tracing of sight lines while the scene is stored and the job planned.
    fn then_warm(mut self, loaded: &Arc<TracedScene>, spec: &JobSpec) -> Self {
        let sampling = spec.visibility().and_then(Visibility::sampling);
        if let Some(sampling) = sampling
            && !matches!(sampling.sampler, Sampler::Cubes { .. })
            && let Some(probe) = self.0.take()
        {
            let (loaded, spec) = (Arc::clone(loaded), CubeSpec::of(&sampling.sampler));
            self.0 = Some(std::thread::spawn(move || {
                let backends = probe
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                loaded.warm(&backends, spec);
                backends
            }));
        }
        self
    }

    fn end(mut self) -> Result<Arc<Backends>, CliError> {
        let panicked = || CliError::Internal("looking for backends panicked".to_owned());
        self.0
            .take()
            .ok_or_else(panicked)?
            .join()
            .map_err(|_| panicked())
    }
}

impl Drop for Probing {
    /// Waits for the thread, because some drivers crash when the process ends while they start.
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            // The outcome is no longer needed.
            drop(thread.join());
        }
    }
}

/// The end of a bake: its job, and whether the store had the result already.
pub struct Outcome {
    /// The job in its last state.
    pub job: v1::Job,
    /// Whether nothing had to be computed.
    pub from_store: bool,
}

/// Serves a coordinator on a free port of loopback: its address, what ends the serving, and a client.
pub(crate) async fn on_loopback(
    coordinator: &Arc<Coordinator>,
) -> Result<(String, AbortHandle, JobsClient<Connection>), CliError> {
    let connections = Connections::new(ConnectionLimits::of_process().map_err(CliError::internal)?);
    let listener = Listener::bind(([127, 0, 0, 1], 0).into(), false, &connections);
    let listener = listener.await.map_err(CliError::internal)?;
    let url = format!(
        "http://{}",
        listener.local_addr().map_err(CliError::internal)?
    );
    let coordinator = Arc::clone(coordinator);
    let server = tokio::spawn(sightline_coordinator::serve(
        coordinator,
        listener,
        None,
        std::future::pending(),
    ));
    let client = JobsClient::new(client::connect(&url, &Credentials::default()).await?);
    Ok((url, server.abort_handle(), client))
}

async fn run(
    (args, source, traces): (&BakeArgs, &Source, &Traces),
    coordinator: Arc<Coordinator>,
    loaded: &Arc<TracedScene>,
    spec: &JobSpec,
    probing: Probing,
    output: &Output,
    hooks: &mut Hooks<'_>,
) -> Result<Outcome, CliError> {
    let (url, server, mut client) = on_loopback(&coordinator).await?;
    let begun = Begun::now();
    let (taker, here) = (Arc::clone(&coordinator), Arc::clone(loaded));
    tokio::task::spawn_blocking(move || taker.take_scene(here.scene.scene()))
        .await
        .map_err(CliError::internal)?
        .map_err(|e| CliError::Input(format!("{e} (--data-dir names another place)")))?;
    let uploaded = Begun::now();
    let mut answer = submit(&mut client, source, spec).await?;
    traces::submitted(traces, &answer, begun, uploaded);
    let mut job = answer.job.take().unwrap_or_default();
    if job.state() == v1::JobState::Done && job.tiles_set_aside > 0 {
        say(&format!(
            "an earlier run set {} tiles aside: trying them again",
            job.tiles_set_aside
        ));
        let request = v1::ShowRequest { job: job.id };
        job = client
            .retry(request)
            .await
            .map_err(|s| CliError::status(&s))?
            .into_inner();
    }
    let mut backends = None;
    if job.state() != v1::JobState::Done {
        let mut probed = tokio::task::spawn_blocking(move || probing.end())
            .await
            .map_err(CliError::internal)??;
        // An earlier run may have begun the job on a software rasteriser, before Embree was installed.
        if probed.skipped_software() && job.profile.starts_with("gpu/") {
            let again = Probing::begin(TracerSelection::Auto);
            probed = tokio::task::spawn_blocking(move || again.end())
                .await
                .map_err(CliError::internal)??;
        }
        let needs_backend = spec.tracer().is_some();
        if needs_backend {
            backends::say_missing(&probed)?;
        }
        if needs_backend && !job.profile.is_empty() && !probed.profiles().contains(&job.profile) {
            say(&format!(
                "an earlier run began this bake on {}, which is gone or has another version now; the bake \
                 starts over",
                job.profile
            ));
            client
                .cancel(v1::ShowRequest { job: job.id })
                .await
                .map_err(|s| CliError::status(&s))?;
            answer = submit(&mut client, source, spec).await?;
            job = answer.job.take().unwrap_or_default();
        }
        backends = Some(probed);
    }
    coordinator.restrict_to(job.id);
    let from_store = backends.is_none();
    if let Some(backends) = backends {
        if job.state() == v1::JobState::Paused {
            job = client
                .resume(v1::ShowRequest { job: job.id })
                .await
                .map_err(|s| CliError::status(&s))?
                .into_inner();
        }
        if answer.existing {
            say(&format!(
                "going on: {} of {} tiles are done",
                job.tiles_done, job.tiles_total
            ));
        }
        let count = args.workers.map_or_else(|| threads(None), usize::from);
        // The scene is in this process already.
        let scenes = Arc::new(SceneCache::holding(spec.scene, Arc::clone(loaded)));
        let mut workers = Workers::start(count, traces, &url, &backends, &scenes);
        let ended = tokio::select! {
            j = client::follow(&mut client, job.id, hooks.follow) => j,
            e = workers.failure() => Err(e),
            () = &mut hooks.stopped => Err(interrupted()),
        };
        workers.end().await;
        job = ended?;
    } else {
        say(match spec.time_budget() {
            None => "this bake is in the store already",
            // The time runs on while a bake is interrupted, so the result may come from far less work.
            Some(_) => {
                "this bake is in the store already, with the result of its time budget; another \
                 --time-budget or --data-dir starts a new bake"
            }
        });
    }
    client::must_be_done(&job)?;
    client::fetch(&mut client, &job, output).await?;
    server.abort();
    Ok(Outcome { job, from_store })
}

async fn submit(
    client: &mut JobsClient<Connection>,
    source: &Source,
    spec: &JobSpec,
) -> Result<v1::SubmitResponse, CliError> {
    let name = source
        .path()
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let request = v1::SubmitRequest {
        request_id: client::fresh_request_id(),
        name: name.chars().filter(|c| !c.is_control()).take(32).collect(),
        spec: Some(spec.to_message()),
        ..v1::SubmitRequest::default()
    };
    client
        .submit(request)
        .await
        .map(tonic::Response::into_inner)
        .map_err(|s| CliError::status(&s))
}

/// The workers of this process.
pub(crate) struct Workers {
    stop: watch::Sender<Stop>,
    running: JoinSet<Result<(), WorkerError>>,
}

impl Workers {
    /// Starts so many.
    pub(crate) fn start(
        count: usize,
        traces: &Traces,
        url: &str,
        backends: &Arc<Backends>,
        scenes: &Arc<SceneCache>,
    ) -> Self {
        let (stop, stopped) = watch::channel(Stop::No);
        let mut running = JoinSet::new();
        for i in 0..count {
            let config = sightline_worker::Config {
                coordinator: url.to_owned(),
                credentials: Credentials::default(),
                name: format!("in-process-{i}"),
                backends: Arc::clone(backends),
                scenes: Arc::clone(scenes),
                receivers: Arc::default(),
                // They share the threads of this process.
                helps: false,
                direct: false,
                give_up_after: Some(Duration::from_secs(30)),
                pulse: Arc::default(),
                traces: traces.clone(),
            };
            running.spawn(sightline_worker::run(config, stopped.clone()));
        }
        Self { stop, running }
    }

    /// Resolves only when a worker ends with an error.
    pub(crate) async fn failure(&mut self) -> CliError {
        while let Some(ended) = self.running.join_next().await {
            match ended {
                Ok(Ok(())) => {}
                Ok(Err(e)) => return CliError::internal(e),
                Err(e) => return CliError::internal(e),
            }
        }
        std::future::pending().await
    }

    /// Tells the workers and their tiles to stop.
    pub(crate) async fn end(mut self) {
        // The send fails only if all workers have ended already.
        let _ = self.stop.send(Stop::Now);
        let all = async { while self.running.join_next().await.is_some() {} };
        // A worker that does not answer in time is dropped.
        let _ = tokio::time::timeout(TO_STOP, all).await;
    }
}

fn default_data_dir() -> Result<PathBuf, CliError> {
    let from = |name: &str| {
        std::env::var_os(name)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    };
    from("XDG_CACHE_HOME")
        .or_else(|| from("HOME").map(|h| h.join(".cache")))
        .map(|d| d.join("sightline"))
        .ok_or_else(|| {
            CliError::Usage("neither XDG_CACHE_HOME nor HOME is set; name a --data-dir".to_owned())
        })
}
