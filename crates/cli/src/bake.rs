//! `sightline bake`: a coordinator and workers in one process. They speak the same gRPC as in a cluster,
//! except that the scene is shared in memory.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_coordinator::store::StoreError;
use sightline_coordinator::{Config, Coordinator, OpenError};
use sightline_model::{BackendChoice, Method, Sampler};
use sightline_portals::Partition;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_sampling::CubeSpec;
use sightline_scene::kinds::Kind;
use sightline_scene::{Object, Scene};
use sightline_worker::{Backends, Choice, Loaded, SceneCache, Stop};
use tokio::sync::watch;
use tonic::transport::Channel;

use crate::args::BakeArgs;
use crate::backends;
use crate::client;
use crate::error::CliError;
use crate::inspect::Summary;
use crate::opening::{self, plural};
use crate::output::{Format, Output};
use crate::progress::{human, say};
use crate::result_args::ViewArgs;
use crate::serve::{self, threads};
use crate::view;

/// Runs a bake.
pub fn run(args: BakeArgs, json: bool) -> Result<(), CliError> {
    let start = Instant::now();
    if args.view && json {
        return Err(CliError::Usage(
            "--view serves a page until it is interrupted, and --json prints one document; leave one of them \
             out, and give `sightline view` the result afterwards"
                .to_owned(),
        ));
    }
    let output = Output::check(&args.output, Format::Pvs, Some(&args.scene))?;
    serve::use_threads(threads(None))?;
    let choice = match backends::choice(args.job.backend) {
        Choice::Auto => Choice::Fast,
        choice => choice,
    };
    // Starting drivers may take longer than reading most scenes.
    let probing = Probing::begin(choice);
    let scene = Arc::new(opening::scene(&args.scene, &args.kinds)?);
    let spec = args.job.spec(&args.scene, &scene)?;
    say(&format!(
        "{}: {} in {}, read in {}",
        args.scene.display(),
        plural(scene.len() as usize, "triangle"),
        plural(scene.objects().len(), "object"),
        human(start.elapsed())
    ));
    opening::scene_in_words(&scene).iter().for_each(|line| say(line));
    let loaded = Arc::new(Loaded::new(Arc::clone(&scene))?);
    let probing = probing.then_warm(&loaded, &spec);
    let has_doors = (0..scene.len()).any(|id| scene.kinds().kind(id) == Kind::Door);
    if spec.method == Method::Portals || spec.has_portals() && has_doors && spec.time_budget_ms == 0 {
        // The workers of this process find it made.
        let partition = loaded.scene.partition(&spec, &|| false).map_err(CliError::internal)?;
        let lines = partition_in_words(&partition, &scene);
        lines.iter().for_each(|line| say(line));
    }
    let data_dir = match &args.data_dir {
        Some(dir) => dir.clone(),
        None => default_data_dir()?,
    };
    let coordinator = Coordinator::open(Config::new(data_dir.clone())).map_err(|e| match e {
        OpenError::Store(StoreError::InUse { pid, .. }) => CliError::Input(format!(
            "{} is in use by process {pid}, probably another bake; wait for it, or give this one another \
             --data-dir",
            data_dir.display()
        )),
        OpenError::Store(e) => CliError::Input(format!("{e} (--data-dir names another)")),
        OpenError::Blobs(e) => CliError::Input(e.to_string()),
    })?;
    let runtime = serve::runtime()?;
    let outcome = runtime.block_on(async {
        let work = bake(&args, coordinator, &loaded, &spec, probing, &output);
        tokio::select! {
            r = work => r,
            () = serve::stop_signal() => Err(CliError::Interrupted(format!(
                "interrupted; finished tiles are kept in {}: the same command goes on from there",
                data_dir.display()
            ))),
        }
    });
    // Running tiles are abandoned; waiting for them could take minutes.
    runtime.shutdown_timeout(Duration::from_millis(200));
    let outcome = outcome?;
    report(&args, &outcome, start.elapsed(), json)?;
    if !args.view {
        return Ok(());
    }
    let BakeArgs { scene, output, kinds, .. } = args;
    view::run(&ViewArgs::of(output, scene, kinds), json)
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
    let names = scene.objects().iter().filter(is_door).map(|o| o.name.as_str());
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
    fn begin(choice: sightline_worker::Choice) -> Self {
        Self(Some(std::thread::spawn(move || Arc::new(Backends::probe(choice, Default::default())))))
    }

    /// After the search, prepares the tracing of sight lines while the scene is stored and the job planned.
    fn then_warm(mut self, loaded: &Arc<Loaded>, spec: &sightline_model::JobSpec) -> Self {
        if spec.sampling.sampler != Sampler::Cubes
            && spec.backend != BackendChoice::None
            && let Some(probe) = self.0.take()
        {
            let (loaded, spec) = (Arc::clone(loaded), CubeSpec::of(&spec.sampling));
            self.0 = Some(std::thread::spawn(move || {
                let backends = probe.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                loaded.warm(&backends, spec);
                backends
            }));
        }
        self
    }

    fn end(mut self) -> Result<Arc<Backends>, CliError> {
        let panicked = || CliError::Internal("looking for backends panicked".to_owned());
        self.0.take().ok_or_else(panicked)?.join().map_err(|_| panicked())
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
struct Outcome {
    job: v1::Job,
    from_store: bool,
}

async fn bake(
    args: &BakeArgs,
    coordinator: Arc<Coordinator>,
    loaded: &Arc<Loaded>,
    spec: &sightline_model::JobSpec,
    probing: Probing,
    output: &Output,
) -> Result<Outcome, CliError> {
    let listener =
        sightline_coordinator::listen(([127, 0, 0, 1], 0).into(), false).await.map_err(CliError::internal)?;
    let url = format!("http://{}", listener.local_addr().map_err(CliError::internal)?);
    let server = tokio::spawn(sightline_coordinator::serve(
        Arc::clone(&coordinator),
        listener,
        std::future::pending(),
    ));
    let mut client = JobsClient::new(client::channel(&url).await?);
    let (taker, here) = (Arc::clone(&coordinator), Arc::clone(loaded));
    tokio::task::spawn_blocking(move || taker.take_scene(here.scene.scene()))
        .await
        .map_err(CliError::internal)?
        .map_err(|e| CliError::Input(format!("{e} (--data-dir names another place)")))?;
    let mut answer = submit(&mut client, args, spec).await?;
    let mut job = answer.job.take().unwrap_or_default();
    if job.state() == v1::JobState::Done && job.tiles_set_aside > 0 {
        say(&format!("an earlier run set {} tiles aside: trying them again", job.tiles_set_aside));
        let request = v1::ShowRequest { job: job.id };
        job = client.retry(request).await.map_err(|s| CliError::status(&s))?.into_inner();
    }
    let mut backends = None;
    if job.state() != v1::JobState::Done {
        let mut probed =
            tokio::task::spawn_blocking(move || probing.end()).await.map_err(CliError::internal)??;
        // An earlier run may have begun the job on a software rasteriser, before Embree was installed.
        if probed.skipped_software() && job.profile.starts_with("gpu/") {
            let again = Probing::begin(Choice::Auto);
            probed = tokio::task::spawn_blocking(move || again.end()).await.map_err(CliError::internal)??;
        }
        let needs_backend = spec.backend != BackendChoice::None;
        if needs_backend {
            backends::say_missing(&probed)?;
        }
        if needs_backend && !job.profile.is_empty() && !probed.profiles().contains(&job.profile) {
            say(&format!(
                "an earlier run began this bake on {}, which is gone or has another version now; the bake \
                 starts over",
                job.profile
            ));
            client.cancel(v1::ShowRequest { job: job.id }).await.map_err(|s| CliError::status(&s))?;
            answer = submit(&mut client, args, spec).await?;
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
            say(&format!("going on: {} of {} tiles are done", job.tiles_done, job.tiles_total));
        }
        let (stop, workers) = start_workers(args, &url, &backends, loaded, spec)?;
        job = tokio::select! {
            j = client::follow(&mut client, job.id, true) => j?,
            e = workers => return Err(e),
        };
        // The send fails only if all workers have ended already.
        let _ = stop.send(Stop::Now);
    } else {
        say(match spec.time_budget_ms {
            0 => "this bake is in the store already",
            // The time runs on while a bake is interrupted, so the result may come from far less work.
            _ => {
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
    client: &mut JobsClient<Channel>,
    args: &BakeArgs,
    spec: &sightline_model::JobSpec,
) -> Result<v1::SubmitResponse, CliError> {
    let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
    let request = v1::SubmitRequest {
        request_id: client::fresh_request_id(),
        name: name.chars().filter(|c| !c.is_control()).take(32).collect(),
        spec: Some(spec.to_proto()),
        ..v1::SubmitRequest::default()
    };
    client.submit(request).await.map(tonic::Response::into_inner).map_err(|s| CliError::status(&s))
}

/// Starts the workers; the future resolves only when one of them ends with an error.
fn start_workers(
    args: &BakeArgs,
    url: &str,
    backends: &Arc<Backends>,
    loaded: &Arc<Loaded>,
    spec: &sightline_model::JobSpec,
) -> Result<(watch::Sender<Stop>, impl Future<Output = CliError> + use<>), CliError> {
    let count = args.workers.map_or_else(|| threads(None), usize::from);
    // The scene is in this process already.
    let scenes = Arc::new(SceneCache::holding(spec.scene, Arc::clone(loaded)));
    let (stop, stopped) = watch::channel(Stop::No);
    let mut set = tokio::task::JoinSet::new();
    for i in 0..count {
        let config = sightline_worker::Config {
            coordinator: url.to_owned(),
            name: format!("in-process-{i}"),
            backends: Arc::clone(backends),
            scenes: Arc::clone(&scenes),
            // They share the threads of this process.
            helps: false,
            give_up_after: Some(Duration::from_secs(30)),
        };
        set.spawn(sightline_worker::run(config, stopped.clone()));
    }
    Ok((stop, async move {
        while let Some(ended) = set.join_next().await {
            match ended {
                Ok(Ok(())) => {}
                Ok(Err(e)) => return CliError::internal(e),
                Err(e) => return CliError::internal(e),
            }
        }
        std::future::pending().await
    }))
}

fn default_data_dir() -> Result<PathBuf, CliError> {
    let from = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    from("XDG_CACHE_HOME")
        .or_else(|| from("HOME").map(|h| h.join(".cache")))
        .map(|d| d.join("sightline"))
        .ok_or_else(|| {
            CliError::Usage("neither XDG_CACHE_HOME nor HOME is set; name a --data-dir".to_owned())
        })
}

fn report(args: &BakeArgs, outcome: &Outcome, took: Duration, json: bool) -> Result<(), CliError> {
    let summary = Summary::of(&args.output)?;
    let job = &outcome.job;
    let peak = peak_memory();
    if json {
        let mut value = serde_json::to_value(&summary).map_err(CliError::internal)?;
        value["output"] = args.output.display().to_string().into();
        value["job"] = job.id.into();
        value["from_store"] = outcome.from_store.into();
        value["seconds"] = took.as_secs_f64().into();
        value["samples"] = job.samples.into();
        value["tiles_set_aside"] = job.tiles_set_aside.into();
        value["cpu_seconds"] = cpu_seconds().into();
        value["peak_memory_bytes"] = peak.into();
        serve::print(&value.to_string())
    } else {
        let mut lines = summary.lines();
        let peak = peak.map_or("not known here".to_owned(), |p| format!("{:.0} MB", p as f64 / 1e6));
        lines.push(if outcome.from_store {
            format!(
                "answered from the store in {}, where it was baked before with {} samples; peak memory \
                 {peak}",
                human(took),
                job.samples
            )
        } else {
            format!("baked in {}, {} samples, peak memory {peak}", human(took), job.samples)
        });
        if summary.sees_nothing() {
            // An exact bake finds small triangles too.
            let small = match summary.is_decided() {
                false => " Triangles that look very small from there need --method exact.",
                true => "",
            };
            lines.push(format!(
                "ATTENTION: no triangle is seen from any cell. Is the view box where viewpoints are, in the \
                 scene's units and axes?{small}"
            ));
        }
        if job.tiles_set_aside > 0 {
            lines.push(format!(
                "ATTENTION: {} tiles failed and were set aside; their cells show everything. Run the same \
                 command again to try them again; the log above says why they failed.",
                job.tiles_set_aside
            ));
        }
        lines.push(format!("wrote {}", args.output.display()));
        serve::print(&lines.join("\n"))
    }
}

/// The peak memory of this process in bytes, from Linux's /proc; `None` on other systems.
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// The CPU seconds of all threads of this process so far, user and system; `None` where the system does not
/// tell.
#[cfg(unix)]
fn cpu_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
}

#[cfg(not(unix))]
fn cpu_seconds() -> Option<f64> {
    None
}
