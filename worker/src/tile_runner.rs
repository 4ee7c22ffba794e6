//! One tile from grant to commit: its scene and packs are fetched, it runs, and its output is uploaded.

use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_bake::{Alone, BakeError, Control, Crew, Inputs, PackBytes, Watcher as _};
use sightline_model::receivers::Receivers;
use sightline_model::{GridCells, JobSpec, PlannedJob, Sampler, SceneFacts, Visibility};
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_sample::{TileError, auto};
use sightline_trace::{CubeSpec, gpu};
use sightline_traces::Begun;
use sightline_viewcells::Division;

use crate::backends::Backends;
use crate::config::Config;
use crate::crew;
use crate::direct::Direct;
use crate::leased_tile::LeasedTile;
use crate::packs::PackCache;
use crate::planned::PlannedJobs;
use crate::spans::Steps;
use crate::traced_scenes::TracedScene;

/// Why a tile was not committed.
pub enum Failure {
    /// The lease was revoked, the job has ended, or the worker stops.
    Cancelled,
    /// A fault of the network or the machine.
    Infrastructure(String),
    /// A fault of the tile itself.
    Tile(String),
}

/// The failure of a tile; `lost` is called when its backend failed.
fn failure(e: BakeError, lost: impl FnOnce()) -> Failure {
    match e {
        BakeError::Cancelled => Failure::Cancelled,
        BakeError::Backend(e) => {
            lost();
            Failure::Infrastructure(e.to_string())
        }
        BakeError::Tile(reason) => Failure::Tile(reason),
    }
}

/// What is run: a tile's inputs beside its scene and packs.
struct Work<'a> {
    job: &'a PlannedJob,
    profile: &'a str,
    receivers: Option<&'a Receivers>,
    deadline: Option<Instant>,
    crew: &'a dyn Crew,
}

/// Returns true if a crew can share a tile of the job: lines and the queries of portals are shared, cubes and
/// receivers are not.
fn is_shared(job: &PlannedJob) -> bool {
    let is_cubes = |task: &Visibility| {
        let sampling = task.sampling();
        sampling.is_some_and(|sampling| matches!(sampling.sampler, Sampler::Cubes { .. }))
    };
    job.visibility().is_some_and(|task| !is_cubes(task))
}

/// State that the tiles of one worker share.
pub struct TileRunner {
    /// The worker's configuration.
    pub config: Config,
    /// Cache of packs.
    pub packs: PackCache,
    /// The jobs of the last orders.
    pub planned: PlannedJobs,
    /// One tile runs at a time, while the next one fetches its data.
    pub running: tokio::sync::Semaphore,
    /// The way to the store of the blobs.
    pub direct: Direct,
    /// Connection to the coordinator.
    pub client: WorkersClient<Connection>,
}

impl TileRunner {
    /// Runs the tile of `grant` and commits it.
    pub async fn work(
        self: &Arc<Self>,
        grant: v1::Grant,
        held: Arc<LeasedTile>,
    ) -> Result<(), Failure> {
        let steps = Steps::of(&self.config, held.lease, &grant.trace);
        let (begun, profile) = (Begun::now(), grant.profile.clone());
        let result = self.compute_and_commit(grant, &held, &steps).await;
        let end = match &result {
            Ok(()) => "done",
            Err(Failure::Cancelled) => "taken_back",
            Err(Failure::Infrastructure(_) | Failure::Tile(_)) => "failed",
        };
        steps.ended("tile", begun, &profile, held.progress().samples, end);
        result
    }

    async fn compute_and_commit(
        self: &Arc<Self>,
        grant: v1::Grant,
        held: &Arc<LeasedTile>,
        steps: &Steps,
    ) -> Result<(), Failure> {
        let begun = Begun::now();
        let infrastructure = Failure::Infrastructure;
        let job = self.planned.job(grant.spec).map_err(Failure::Tile)?;
        let loaded = self.scene(job.spec().scene).await.map_err(infrastructure)?;
        let mut packs = Vec::with_capacity(grant.packs.len());
        for digest in &grant.packs {
            let digest: [u8; 32] = digest
                .as_slice()
                .try_into()
                .map_err(|_| Failure::Tile("a pack's digest has the wrong length".to_owned()))?;
            let pack = self.pack(digest).await.map_err(infrastructure)?;
            packs.push(pack.ok_or(digest));
        }
        let receivers = match job.ambient() {
            Some(ambient) => {
                let triangles = loaded.scene.scene().len();
                let fetched = self.receivers(ambient.receivers, triangles).await;
                Some(fetched.map_err(infrastructure)?)
            }
            None => None,
        };
        steps.step("fetch", begun);
        let waits = Begun::now();
        let turn = self
            .running
            .acquire()
            .await
            .map_err(|e| infrastructure(e.to_string()))?;
        steps.step("turn", waits);
        if held.cancelled() {
            return Err(Failure::Cancelled);
        }
        held.begin();
        // Members of a crew would not stop at the same place.
        let is_crewed = grant.millis.is_none() && is_shared(&job);
        let leader = match is_crewed {
            true => Some(crew::lead(self.client.clone(), held.lease, held).await),
            false => None,
        };
        let start = Instant::now();
        let (shop, watcher, computing) = (Arc::clone(self), Arc::clone(held), steps.clone());
        let (bytes, rendered) = tokio::task::spawn_blocking(move || {
            let deadline = grant.millis.map(|m| start + Duration::from_millis(m));
            let crew = leader
                .as_deref()
                .map_or(&Alone as &dyn Crew, |leader| leader);
            computing.computing(crew, false, |crew| {
                let work = Work {
                    job: &job,
                    profile: &grant.profile,
                    receivers: receivers.as_deref(),
                    deadline,
                    crew,
                };
                shop.run(&work, &loaded, packs, &watcher)
            })
        })
        .await
        .map_err(|e| Failure::Tile(format!("sampling panicked: {e}")))??;
        drop(turn);
        let header = v1::ResultHeader {
            lease: Some(held.lease),
            digest: blake3::hash(&bytes).as_bytes().to_vec(),
            bytes: bytes.len() as u64,
            samples: rendered,
            cells: held.progress().cells,
            millis: start.elapsed().as_millis() as u64,
            ..v1::ResultHeader::default()
        };
        let (begun, length) = (Begun::now(), header.bytes);
        let mut attempts = 0;
        let sent = self.upload(header, bytes.into(), held, &mut attempts).await;
        steps.uploaded(begun, length, attempts, sent.is_err());
        sent
    }

    /// Helps the leader of a tile until its crew ends or `held` is cancelled.
    ///
    /// # Errors
    /// The reason, when this worker is of no help.
    pub async fn help(
        self: &Arc<Self>,
        help: v1::Help,
        held: Arc<LeasedTile>,
    ) -> Result<(), String> {
        let steps = Steps::of(&self.config, held.lease, &help.trace);
        let (begun, profile) = (Begun::now(), help.profile.clone());
        let result = self.help_leader(help, &held, &steps).await;
        let end = if result.is_ok() { "done" } else { "failed" };
        steps.ended("help", begun, &profile, held.progress().samples, end);
        result
    }

    async fn help_leader(
        self: &Arc<Self>,
        help: v1::Help,
        held: &Arc<LeasedTile>,
        steps: &Steps,
    ) -> Result<(), String> {
        let begun = Begun::now();
        let job = self.planned.job(help.spec)?;
        let loaded = self.scene(job.spec().scene).await?;
        steps.step("fetch", begun);
        let _turn = self.running.acquire().await.map_err(|e| e.to_string())?;
        if held.cancelled() {
            return Ok(());
        }
        let helper = crew::help(self.client.clone(), held.lease, held).await?;
        tracing::info!(
            "worker {} helps with tile {} of job {}",
            self.config.name,
            held.lease.tile,
            held.lease.job
        );
        let (shop, held, computing) = (Arc::clone(self), Arc::clone(held), steps.clone());
        let ended = tokio::task::spawn_blocking(move || {
            computing.computing(&*helper, true, |crew| {
                let work = Work {
                    job: &job,
                    profile: &help.profile,
                    receivers: None,
                    deadline: None,
                    crew,
                };
                shop.run(&work, &loaded, Vec::new(), &held)
            })
        });
        match ended.await.map_err(|e| format!("helping panicked: {e}"))? {
            // A helper has no output: it stops when the last phase is over.
            Ok(_) | Err(Failure::Cancelled) => Ok(()),
            Err(Failure::Infrastructure(reason) | Failure::Tile(reason)) => Err(reason),
        }
    }

    /// Computes the tile on the current thread; returns the output's bytes and the number of samples.
    fn run(
        &self,
        work: &Work<'_>,
        loaded: &TracedScene,
        packs: Vec<Fetched>,
        held: &LeasedTile,
    ) -> Result<(Vec<u8>, u64), Failure> {
        let Work {
            job,
            profile,
            receivers,
            deadline,
            crew,
        } = *work;
        let control = Control {
            watcher: held,
            deadline,
            crew,
        };
        let owner = self.config.name.as_str();
        if profile.starts_with("cpu/") {
            // The device that was opened to see whether it works is not wanted.
            gpu::close_spare();
        }
        let sampling = job.visibility().and_then(Visibility::sampling);
        let tracer = sampling.map(|sampling| {
            let spec = CubeSpec::of(&sampling.sampler);
            loaded
                .backend(&self.config.backends, profile, spec, owner)
                .map_err(|e| Failure::Infrastructure(e.to_string()))
        });
        let tracer = tracer.transpose()?;
        let packs: Vec<PackBytes<'_>> = packs
            .iter()
            .map(|pack| match pack {
                Ok(bytes) => PackBytes::Present(bytes),
                Err(digest) => PackBytes::Lost(*digest),
            })
            .collect();
        let inputs = Inputs {
            scene: &loaded.scene,
            tracer: tracer.as_deref(),
            packs: &packs,
            receivers,
        };
        // A lost device stays lost; the next tile opens the backend again.
        let done = sightline_bake::run(job, held.lease.tile, inputs, control)
            .map_err(|e| failure(e, || loaded.forget(profile)))?;
        for (digest, bytes) in done.recomputed {
            self.packs.put(digest, bytes.into());
        }
        Ok((done.bytes, done.samples))
    }

    /// Times the backends on a job's scene.
    pub async fn time(&self, spec: &v1::JobSpec) -> Result<Vec<v1::ProfileTime>, String> {
        let spec =
            JobSpec::from_message(spec, &SceneFacts::default()).map_err(|e| e.to_string())?;
        let loaded = self.scene(spec.scene).await?;
        let config = self.config.clone();
        let times = tokio::task::spawn_blocking(move || {
            time_profiles(&config.backends, &loaded, &spec, &config.name)
        });
        let times = times.await.map_err(|e| e.to_string())?;
        let message = |(profile, seconds_per_cube)| v1::ProfileTime {
            profile,
            seconds_per_cube,
        };
        Ok(times.into_iter().map(message).collect())
    }
}

/// Times the backends of this machine on a job's scene: the seconds that each takes for a cube, or for as
/// many lines. It skips backends that do not suit the scene, and all of them for a job without a tracer.
/// Each `owner` has a software gpu for itself.
pub fn time_profiles(
    backends: &Backends,
    loaded: &TracedScene,
    spec: &JobSpec,
    owner: &str,
) -> Vec<(String, f64)> {
    let task = spec.visibility();
    let Some((task, sampling)) = task.and_then(|task| Some((task, task.sampling()?))) else {
        return Vec::new();
    };
    // The boxes of a tree have few points of the lattice.
    let whole = match task.division() {
        Division::Tree(_) => GridCells::new(task.view_box(), [1; 3]).ok(),
        Division::Grid(_) | Division::Adaptive { .. } => None,
    };
    let lattice = whole
        .as_ref()
        .map_or(task.lattice(), |whole| whole.cells().lattice());
    let has_region = task.viewpoints().region().is_some();
    let mut times = Vec::new();
    for profile in backends.profiles() {
        let timed = loaded
            .backend(backends, &profile, CubeSpec::of(&sampling.sampler), owner)
            .map_err(TileError::from)
            .and_then(|b| match sampling.sampler {
                Sampler::Cubes { .. } => Ok(auto::time(&*b, lattice)?),
                // A region of viewpoints keeps a device from casting whole rounds.
                Sampler::Lines { .. } if !has_region => {
                    auto::time_rounds(&*b, loaded.scene.sampling(), lattice)
                }
                Sampler::Lines { .. } | Sampler::Guided { .. } => {
                    let ids = loaded.scene.sampling().traced().distinct;
                    Ok(auto::time_lines(&*b, ids, lattice)?)
                }
            });
        match timed {
            Ok(t) => times.push((profile, t.per_cube.as_secs_f64())),
            Err(e) => tracing::warn!("{profile} cannot be used for this scene: {e}"),
        }
    }
    times
}

/// A pack, or the digest of a lost pack that has to be computed again.
type Fetched = Result<bytes::Bytes, [u8; 32]>;
