//! The execution of one tile from grant to commit.
//!
//! The worker fetches the scene and packs of the tile, computes the tile, and uploads its output.

use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_bake::{BakeError, Control, Crew, Inputs, PackBytes, SoleMember, Watcher as _};
use sightline_model::receivers::Receivers;
use sightline_model::{
    GridCells, JobSpec, PlannedJob, Sampler, SceneFacts, TracerChoice, Visibility,
};
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_sample::{TileError, auto};
use sightline_trace::{CubeSpec, gpu};
use sightline_traces::SpanTime;
use sightline_viewcells::{Division, TileIndex};

use crate::backends::Backends;
use crate::config::Config;
use crate::crew;
use crate::direct::Direct;
use crate::leased_tile::LeasedTile;
use crate::packs::PackCache;
use crate::planned::PlannedJobs;
use crate::spans::Steps;
use crate::traced_scenes::TracedScene;

/// The reason why a tile was not committed.
pub enum Failure {
    /// The lease was revoked, the job has ended, or the worker stops.
    Cancelled,
    /// A fault of the network or the machine.
    Infrastructure(String),
    /// A fault of the tile itself.
    Tile(String),
}

/// Converts the error of a tile to a failure. Calls `lost` if the backend failed.
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

/// The inputs of a tile in addition to its scene and packs.
struct TileInputs<'a> {
    job: &'a PlannedJob,
    profile: &'a str,
    receivers: Option<&'a Receivers>,
    deadline: Option<Instant>,
    crew: &'a dyn Crew,
}

/// Returns true if a crew can share a tile of the job.
///
/// Crews share lines and the queries of portals, but not cubes and receivers.
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
    /// The cache of packs.
    pub packs: PackCache,
    /// The jobs of the last grants.
    pub planned: PlannedJobs,
    /// The semaphore of the running tile. One tile runs at a time, while the next one fetches its data.
    pub running: tokio::sync::Semaphore,
    /// The direct access to the blob store.
    pub direct: Direct,
    /// The connection to the coordinator.
    pub client: WorkersClient<Connection>,
}

impl TileRunner {
    /// Runs the tile of `grant` and commits it.
    pub async fn work(
        self: &Arc<Self>,
        grant: v1::Grant,
        leased: Arc<LeasedTile>,
    ) -> Result<(), Failure> {
        let steps = Steps::new(&self.config, leased.lease, &grant.trace);
        let (begun, profile) = (SpanTime::now(), grant.profile.clone());
        let result = self.compute_and_commit(grant, &leased, &steps).await;
        let end = match &result {
            Ok(()) => "done",
            Err(Failure::Cancelled) => "taken_back",
            Err(Failure::Infrastructure(_) | Failure::Tile(_)) => "failed",
        };
        steps.ended("tile", begun, &profile, leased.progress().samples, end);
        result
    }

    async fn compute_and_commit(
        self: &Arc<Self>,
        grant: v1::Grant,
        leased: &Arc<LeasedTile>,
        steps: &Steps,
    ) -> Result<(), Failure> {
        let begun = SpanTime::now();
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
        let waits = SpanTime::now();
        let turn = self
            .running
            .acquire()
            .await
            .map_err(|e| infrastructure(e.to_string()))?;
        steps.step("turn", waits);
        if leased.cancelled() {
            return Err(Failure::Cancelled);
        }
        leased.begin();
        // With a time limit, the members of a crew would not stop at the same item.
        let is_crewed = grant.millis.is_none() && is_shared(&job);
        let leader = match is_crewed {
            true => Some(crew::lead(self.client.clone(), leased.lease, leased).await),
            false => None,
        };
        let start = Instant::now();
        let (runner, watcher, computing) = (Arc::clone(self), Arc::clone(leased), steps.clone());
        let (bytes, rendered) = tokio::task::spawn_blocking(move || {
            let deadline = grant.millis.map(|m| start + Duration::from_millis(m));
            let crew = leader
                .as_deref()
                .map_or(&SoleMember as &dyn Crew, |leader| leader);
            computing.computing(crew, false, |crew| {
                let tile_inputs = TileInputs {
                    job: &job,
                    profile: &grant.profile,
                    receivers: receivers.as_deref(),
                    deadline,
                    crew,
                };
                runner.run(&tile_inputs, &loaded, packs, &watcher)
            })
        })
        .await
        .map_err(|e| Failure::Tile(format!("the computation of the tile panicked: {e}")))??;
        drop(turn);
        let header = v1::ResultHeader {
            lease: Some(leased.lease),
            digest: blake3::hash(&bytes).as_bytes().to_vec(),
            bytes: bytes.len() as u64,
            samples: rendered,
            cells: leased.progress().cells,
            millis: start.elapsed().as_millis() as u64,
            ..v1::ResultHeader::default()
        };
        let (begun, length) = (SpanTime::now(), header.bytes);
        let mut attempts = 0;
        let sent = self
            .upload(header, bytes.into(), leased, &mut attempts)
            .await;
        steps.uploaded(begun, length, attempts, sent.is_err());
        sent
    }

    /// Helps the leader of a tile until its crew ends or `leased` is cancelled.
    ///
    /// # Errors
    /// The reason, if this worker cannot help.
    pub async fn help(
        self: &Arc<Self>,
        help: v1::Help,
        leased: Arc<LeasedTile>,
    ) -> Result<(), String> {
        let steps = Steps::new(&self.config, leased.lease, &help.trace);
        let (begun, profile) = (SpanTime::now(), help.profile.clone());
        let result = self.help_leader(help, &leased, &steps).await;
        let end = if result.is_ok() { "done" } else { "failed" };
        steps.ended("help", begun, &profile, leased.progress().samples, end);
        result
    }

    async fn help_leader(
        self: &Arc<Self>,
        help: v1::Help,
        leased: &Arc<LeasedTile>,
        steps: &Steps,
    ) -> Result<(), String> {
        let begun = SpanTime::now();
        let job = self.planned.job(help.spec)?;
        let loaded = self.scene(job.spec().scene).await?;
        steps.step("fetch", begun);
        let _turn = self.running.acquire().await.map_err(|e| e.to_string())?;
        if leased.cancelled() {
            return Ok(());
        }
        let helper = crew::help(self.client.clone(), leased.lease, leased).await?;
        tracing::info!(
            "worker {} helps with tile {} of job {}",
            self.config.name,
            leased.lease.tile,
            leased.lease.job
        );
        let (runner, leased, computing) = (Arc::clone(self), Arc::clone(leased), steps.clone());
        let ended = tokio::task::spawn_blocking(move || {
            computing.computing(&*helper, true, |crew| {
                let tile_inputs = TileInputs {
                    job: &job,
                    profile: &help.profile,
                    receivers: None,
                    deadline: None,
                    crew,
                };
                runner.run(&tile_inputs, &loaded, Vec::new(), &leased)
            })
        });
        match ended
            .await
            .map_err(|e| format!("the computation for another worker's tile panicked: {e}"))?
        {
            // A helper has no output: it stops after the last phase.
            Ok(_) | Err(Failure::Cancelled) => Ok(()),
            Err(Failure::Infrastructure(reason) | Failure::Tile(reason)) => Err(reason),
        }
    }

    /// Computes the tile on the current thread. Returns the output's bytes and the number of samples.
    fn run(
        &self,
        tile_inputs: &TileInputs<'_>,
        loaded: &TracedScene,
        packs: Vec<Fetched>,
        leased: &LeasedTile,
    ) -> Result<(Vec<u8>, u64), Failure> {
        let TileInputs {
            job,
            profile,
            receivers,
            deadline,
            crew,
        } = *tile_inputs;
        let control = Control {
            watcher: leased,
            deadline,
            crew,
        };
        let owner = self.config.name.as_str();
        if !TracerChoice::Gpu.accepts(profile) {
            // The device that was opened for the probe is not needed.
            gpu::close_spare();
        }
        let sampling = job.visibility().and_then(Visibility::sampling);
        let tracer = sampling.map(|sampling| {
            let spec = CubeSpec::from_sampler(&sampling.sampler);
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
        let done = sightline_bake::run(job, TileIndex(leased.lease.tile), inputs, control)
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

/// Times the backends of this machine on a job's scene. Returns each profile with its seconds per cube.
///
/// If the job samples lines, the time is for as many lines as a cube has. Backends that cannot be used for
/// the scene are skipped. For a job without a tracer, all backends are skipped. Each `owner` has a separate
/// software gpu.
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
    // The boxes of a tree contain few points of the lattice.
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
            .backend(
                backends,
                &profile,
                CubeSpec::from_sampler(&sampling.sampler),
                owner,
            )
            .map_err(TileError::from)
            .and_then(|b| match sampling.sampler {
                Sampler::Cubes { .. } => Ok(auto::time(&*b, lattice)?),
                // A region of viewpoints prevents a device from casting whole rounds.
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

/// A pack, or the digest of a lost pack that must be computed again.
type Fetched = Result<bytes::Bytes, [u8; 32]>;
