//! Tests of the assignment of tiles, with two workers, two tiles and a memory store.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use prost::Message as _;
use sightline_model::numbers::TileCells;
use sightline_model::{
    CellToCell, GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling, SceneFacts,
    Task, TracerChoice, Visibility,
};
use sightline_numbers::Aabb;
use sightline_records::ids::Digest;
use sightline_records::ids::{Epoch, JobId, Lease, WorkerId};
use sightline_records::{JobPhase, JobState, NewJob, SceneRecord};
use sightline_store::{MemoryStore, Queries as _, Store as _};

use super::*;

/// Returns a grid of cells of the unit cube, in tiles of at most `tile_cells` cells.
pub(super) fn grid(cells: [u32; 3], tile_cells: u32) -> GridCells {
    let view = Aabb::new(Vec3::ZERO, Vec3::ONE);
    let tile_cells = TileCells::new(tile_cells).unwrap();
    GridCells::new(view, cells)
        .unwrap()
        .with_tile_cells(tile_cells)
        .unwrap()
}

/// Returns a job of lines over a grid, on the cpu and without pairs of cells.
pub(super) fn lines(scene: Digest, cells: GridCells, seed: u64) -> JobSpec {
    lines_with(TracerChoice::Cpu, scene, cells, seed)
}

/// Returns a job of lines over a grid, with this choice of a tracer and without pairs of cells.
fn lines_with(tracer: TracerChoice, scene: Digest, cells: GridCells, seed: u64) -> JobSpec {
    let sampling = Sampling {
        tracer,
        ..Sampling::new(Sampler::lines(KnownCells::Grid(cells)))
    };
    let task = Visibility {
        pairs: CellToCell::Off,
        seed,
        ..Method::aggressive(sampling).into()
    };
    JobSpec {
        scene,
        task: Task::Visibility(task),
    }
}

/// A scheduler, a store that executes commands at once, and the commands sent to the workers.
pub(super) struct Bench {
    pub(super) scheduler: Scheduler,
    pub(super) store: MemoryStore,
    pub(super) ms: u64,
    pub(super) told: BTreeMap<WorkerId, Vec<WorkerCommand>>,
    answer: Option<Result<Joined, NameTaken>>,
    departure: Option<Departure>,
    pub(super) notes: Vec<Note>,
    /// True if commands that record deaths wait in `ran`.
    pub(super) holds_deaths: bool,
    /// The commands about checks and waiting deaths.
    pub(super) ran: Vec<StoreCommand>,
    pub(super) assembled: Vec<JobId>,
}

const SETTINGS: Settings = Settings {
    epoch: Epoch(1),
    ttl: 10_000,
    stuck: 600_000,
    seed: 1,
    spot_check: 0.0,
    spot_seed: 0,
};

impl Bench {
    pub(super) fn step(&mut self, event: Event) {
        for effect in self.scheduler.step(
            event,
            Now {
                ms: self.ms,
                unix_ms: self.ms,
            },
        ) {
            match effect {
                Effect::Tell(worker, command) => self.told.entry(worker).or_default().push(command),
                Effect::Joined(answer) => self.answer = Some(answer),
                Effect::Left(how) => self.departure = Some(how),
                Effect::Note(note) => self.notes.push(note),
                Effect::Run(StoreCommand::Bind(job, profile)) => {
                    let bound = self.store.bind_profile(job, &profile).unwrap();
                    self.step(Event::Bound(job, bound));
                }
                Effect::Run(StoreCommand::Start(job)) => {
                    let from = [sightline_records::JobPhase::Queued];
                    let running = sightline_records::JobState::Running;
                    let record = self.store.set_job_state(job, &from, running, 0).unwrap();
                    self.step(Event::JobChanged(Box::new(record)));
                }
                Effect::Run(StoreCommand::Fail {
                    job,
                    tile,
                    worker,
                    reason,
                }) => {
                    let on = self.store.fail_tile(job, tile, &worker, &reason).unwrap();
                    self.step(Event::FailureRecorded {
                        job,
                        tile,
                        on,
                        reason,
                        dead: None,
                    });
                }
                Effect::Run(command @ StoreCommand::CountDeath { .. }) if self.holds_deaths => {
                    self.ran.push(command);
                }
                Effect::Run(StoreCommand::CountDeath {
                    job,
                    tile,
                    worker,
                    reason,
                }) => {
                    let on = self.store.count_death(job, tile, &worker, &reason).unwrap();
                    self.step(Event::FailureRecorded {
                        job,
                        tile,
                        on,
                        reason,
                        dead: Some(worker),
                    });
                }
                Effect::Run(StoreCommand::CancelDeath {
                    job,
                    tile,
                    worker,
                    reason,
                }) => {
                    self.store
                        .forget_failure(job, tile, &worker, &reason)
                        .unwrap();
                }
                Effect::Run(StoreCommand::SetAside { job, tiles, .. }) => {
                    for tile in tiles {
                        self.step(Event::SetAside {
                            job,
                            tile,
                            digest: [1; 32],
                        });
                    }
                }
                Effect::Run(
                    command @ (StoreCommand::Confirm { .. } | StoreCommand::Quarantine { .. }),
                ) => {
                    self.ran.push(command);
                }
                Effect::Assemble(job) => self.assembled.push(job),
                Effect::Run(StoreCommand::FailJob(..)) | Effect::Changed(_) => {}
            }
        }
        self.scheduler.check().unwrap();
    }

    pub(super) fn try_join(
        &mut self,
        name: &str,
        instance: u64,
        held: Vec<Lease>,
    ) -> Result<Joined, NameTaken> {
        let intro = Introduction {
            held,
            ..introduction(name, instance)
        };
        self.step(Event::Joined(intro));
        self.answer.take().unwrap()
    }

    pub(super) fn join(&mut self, name: &str) -> WorkerId {
        self.try_join(name, 0, Vec::new()).unwrap().worker
    }

    pub(super) fn leave(&mut self, worker: WorkerId) -> Departure {
        self.step(Event::Left(worker));
        self.departure.take().unwrap()
    }

    /// Changes the state of a job in the store.
    pub(super) fn set(&mut self, job: JobId, from: &[JobPhase], to: JobState) {
        let record = self.store.set_job_state(job, from, to, self.ms).unwrap();
        self.step(Event::JobChanged(Box::new(record)));
    }

    pub(super) fn want(&mut self, worker: WorkerId, tiles: u32) {
        self.step(Event::Wanted(worker, tiles));
    }

    /// Lets this many seconds pass, with a tick per second.
    pub(super) fn wait(&mut self, seconds: u64) {
        for _ in 0..seconds {
            self.ms += 1000;
            self.step(Event::Tick);
        }
    }

    /// Returns the holder of each tile of the first job.
    pub(super) fn holders(&self) -> Vec<Option<WorkerId>> {
        let tiles = self.scheduler.jobs.values().next().unwrap().tiles.iter();
        tiles
            .map(|t| t.leases[0].map(|l| self.scheduler.leases.table[&l].worker))
            .collect()
    }

    pub(super) fn grants(&self, worker: WorkerId) -> Vec<Lease> {
        let told = self.told.get(&worker).into_iter().flatten();
        told.filter_map(|o| {
            if let WorkerCommand::Grant(g) = o {
                Some(g.lease)
            } else {
                None
            }
        })
        .collect()
    }

    pub(super) fn fail(&mut self, worker: WorkerId, lease: Lease, infrastructure: bool) {
        self.step(Event::Failed(
            worker,
            Failure {
                lease,
                reason: "no".to_owned(),
                infrastructure,
            },
        ));
    }
}

/// Creates a scheduler and a store with a job of two tiles.
pub(super) fn two_tiles() -> Bench {
    with_grace(false)
}

/// Creates a scheduler and a store with a job of two tiles. With `grace`, an earlier epoch may have leased
/// the tiles.
pub(super) fn with_grace(grace: bool) -> Bench {
    let mut bench = empty(if grace { 2 } else { 1 });
    bench.add(2, "", 0, grace);
    bench
}

/// Creates a scheduler without jobs.
pub(super) fn empty(epoch: u64) -> Bench {
    let store = MemoryStore::new();
    store
        .record_scene(SceneRecord {
            digest: [7; 32],
            bytes: 1,
            triangles: 1,
            objects: 1,
            owners: Default::default(),
        })
        .unwrap();
    Bench {
        scheduler: Scheduler::new(Settings {
            epoch: Epoch(epoch),
            ..SETTINGS
        }),
        store,
        ms: 0,
        told: BTreeMap::new(),
        answer: None,
        departure: None,
        notes: Vec::new(),
        holds_deaths: false,
        ran: Vec::new(),
        assembled: Vec::new(),
    }
}

impl Bench {
    /// Adds a job of the store to the scheduler, as after a restart.
    pub(super) fn reopen(&mut self, id: JobId) {
        let record = self.store.job(id).unwrap().unwrap();
        let spec = sightline_proto::v1::JobSpec::decode(record.spec.as_slice()).unwrap();
        let spec = JobSpec::from_message(&spec, &SceneFacts::default()).unwrap();
        let planned = Arc::new(PlannedJob::stored(spec));
        let job = OpenJob::new(record, planned, self.store.tiles(id).unwrap()).unwrap();
        self.step(Event::TakenUp(Box::new(job.after_restart())));
    }

    /// Submits a job of `tiles` tiles. With `ran`, the job ran before the coordinator started.
    pub(super) fn add(&mut self, tiles: u32, user: &str, priority: i32, ran: bool) -> JobId {
        let seed = self.store.jobs().unwrap().len() as u64;
        let spec = lines([7; 32], grid([tiles, 1, 1], 1), seed);
        self.add_spec(spec, tiles, user, priority, ran)
    }

    /// Submits a job like [`Self::add`], with these parameters.
    fn add_spec(
        &mut self,
        spec: JobSpec,
        tiles: u32,
        user: &str,
        priority: i32,
        ran: bool,
    ) -> JobId {
        let job = NewJob {
            key: spec.key(),
            request_id: String::new(),
            name: "some tiles".to_owned(),
            owner: String::new(),
            user: user.to_owned(),
            priority,
            scene: spec.scene,
            spec: spec.to_message().encode_to_vec(),
            tiles,
            submitted_at_ms: 0,
        };
        let id = self.store.submit_job(job).unwrap().id;
        if ran {
            self.store.bind_profile(id, "cpu/test").unwrap();
            let from = [sightline_records::JobPhase::Queued];
            self.store
                .set_job_state(id, &from, sightline_records::JobState::Running, 0)
                .unwrap();
        }
        let record = self.store.job(id).unwrap().unwrap();
        let planned = Arc::new(PlannedJob::stored(spec));
        let job = OpenJob::new(record, planned, self.store.tiles(id).unwrap()).unwrap();
        let job = if ran { job.after_restart() } else { job };
        self.step(Event::TakenUp(Box::new(job)));
        id
    }
}

fn introduction(name: &str, instance: u64) -> Introduction {
    let profiles = vec!["cpu/test".to_owned()];
    Introduction {
        name: name.to_owned(),
        signature: name.to_owned(),
        version: String::new(),
        instance,
        profiles,
        held: Vec::new(),
        helps: true,
    }
}

#[test]
fn worker_gets_no_second_tile_while_another_has_none() {
    let mut b = two_tiles();
    let (one, two) = (b.join("a"), b.join("b"));
    b.want(one, 2);
    assert_eq!(b.holders(), [Some(one), None]);
    b.want(two, 2);
    assert_eq!(b.holders(), [Some(one), Some(two)]);
}

#[test]
fn late_worker_takes_over_waiting_tile_of_busy_worker() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 2);
    assert_eq!(b.holders(), [Some(one), Some(one)]);
    let two = b.join("b");
    b.want(two, 2);
    assert_eq!(b.holders(), [Some(one), Some(two)]);
    let leases = b.grants(one);
    assert_eq!(b.told[&one].last(), Some(&WorkerCommand::Revoke(leases[1])));
    assert_eq!(b.grants(two)[0].tile, leases[1].tile);
    // A tile that has begun stays with its worker, and so does a worker's only tile.
    let three = b.join("c");
    b.want(three, 2);
    assert_eq!(b.holders(), [Some(one), Some(two)]);
}

#[test]
fn name_in_use_is_rejected_but_same_worker_may_reconnect() {
    let mut b = two_tiles();
    let first = b.try_join("a", 1, Vec::new()).unwrap().worker;
    let refused = b.try_join("a", 2, Vec::new()).unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("give this worker another --name"),
        "{refused}"
    );
    b.try_join("b", 2, Vec::new()).unwrap();
    // Workers that send no instance cannot be distinguished from reconnecting workers.
    b.try_join("a", 0, Vec::new()).unwrap();
    b.want(first, 1);
    let lease = b.grants(first)[0];
    // The coordinator has not noticed yet that the earlier stream is broken.
    let again = b.try_join("a", 1, vec![lease]).unwrap();
    assert_eq!(again.kept, [lease]);
    b.leave(first);
    assert_eq!(b.holders(), [Some(again.worker), None]);
    assert!(b.scheduler.roster.workers.contains_key(&again.worker));
    // The name is free after its worker has left.
    b.leave(again.worker);
    b.try_join("a", 3, Vec::new()).unwrap();
}

#[test]
fn departure_reports_drained_worker() {
    let mut b = two_tiles();
    let (one, two) = (b.join("a"), b.join("b"));
    b.step(Event::Drains(one));
    b.step(Event::Drains(one));
    assert_eq!(
        b.notes,
        [Note::Draining("a".to_owned())],
        "it is news only once"
    );
    assert_eq!(b.leave(one), Departure::Drained);
    assert_eq!(b.leave(two), Departure::Lost);
}

#[test]
fn draining_worker_keeps_begun_tile_after_broken_stream() {
    let mut b = two_tiles();
    let (one, two) = (b.join("a"), b.join("b"));
    b.want(one, 1);
    let begun = b.grants(one)[0];
    b.step(Event::Progressed(Progress {
        lease: begun,
        cells: 0,
        samples: 1,
    }));
    b.step(Event::Drains(one));
    b.leave(one);
    b.want(two, 2);
    assert!(
        b.grants(two).iter().all(|l| l.tile != begun.tile),
        "{:?}",
        b.grants(two)
    );
    assert_eq!(b.try_join("a", 0, vec![begun]).unwrap().kept, [begun]);
    // A tile that the worker had not begun goes to the next worker at once.
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    b.step(Event::Drains(one));
    b.leave(one);
    let two = b.join("b");
    b.want(two, 1);
    assert_eq!(b.grants(two).len(), 1);
}

#[test]
fn lease_ends_two_seconds_after_stream_unless_worker_returns() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    b.leave(one);
    b.wait(1);
    assert_eq!(b.holders()[0], Some(one));
    // The worker returned in time: the lease belongs to its new number, and continues.
    let two = b.try_join("a", 0, vec![lease]).unwrap().worker;
    b.wait(9);
    assert_eq!(b.holders()[0], Some(two));
    b.step(Event::Progressed(Progress {
        lease,
        cells: 0,
        samples: 0,
    }));
    b.leave(two);
    b.wait(2);
    assert_eq!(b.holders()[0], None);
    let why = |n: &Note| matches!(n, Note::TakenBack(_, _, why) if why.contains("did not return"));
    assert!(b.notes.iter().any(why), "{:?}", b.notes);
    // A worker that returns later keeps its tile if no other worker has it.
    assert_eq!(b.try_join("a", 0, vec![lease]).unwrap().kept, [lease]);
}

#[test]
fn tile_without_progress_is_revoked() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    for _ in 0..599 {
        b.step(Event::Progressed(Progress {
            lease,
            cells: 0,
            samples: 1,
        }));
        b.wait(1);
    }
    assert_eq!(b.holders()[0], Some(one));
    for _ in 0..3 {
        b.step(Event::Progressed(Progress {
            lease,
            cells: 0,
            samples: 1,
        }));
        b.wait(1);
    }
    assert!(b.notes.contains(&Note::TakenBack(
        lease,
        Some("a".to_owned()),
        "the tile makes no progress"
    )));
}

#[test]
fn standstill_of_coordinator_ends_no_lease() {
    let mut b = two_tiles();
    let one = b.join("a");
    b.want(one, 1);
    let lease = b.grants(one)[0];
    b.wait(1);
    b.ms += 60_000;
    b.step(Event::Tick);
    assert_eq!(b.holders()[0], Some(one));
    b.step(Event::Progressed(Progress {
        lease,
        cells: 0,
        samples: 0,
    }));
    b.wait(5);
    assert_eq!(b.holders()[0], Some(one));
}

#[test]
fn job_binds_to_profile_of_most_workers() {
    let mut b = two_tiles();
    for (name, profile) in [("a", "cpu/rare"), ("b", "cpu/common"), ("c", "cpu/common")] {
        let intro = Introduction {
            profiles: vec![profile.to_owned()],
            ..introduction(name, 0)
        };
        b.step(Event::Joined(intro));
    }
    b.want(WorkerId(1), 1);
    assert_eq!(b.scheduler.job(JobId(1)).unwrap().record.profile, None);
    b.wait(1);
    assert_eq!(
        b.scheduler.job(JobId(1)).unwrap().record.profile.as_deref(),
        Some("cpu/common")
    );
    b.want(WorkerId(3), 1);
    assert_eq!(b.holders()[0], Some(WorkerId(3)));
}

#[test]
fn timer_of_earlier_wait_binds_no_job() {
    let mut b = empty(1);
    let spec = lines_with(TracerChoice::Auto, [7; 32], grid([2, 1, 1], 1), 0);
    let job = b.add_spec(spec, 2, "", 0, false);
    let join = |b: &mut Bench, name: &str, profiles: &[&str]| {
        b.step(Event::Joined(Introduction {
            profiles: profiles.iter().map(|p| (*p).to_owned()).collect(),
            ..introduction(name, 0)
        }));
        b.answer.take().unwrap().unwrap().worker
    };
    let bound = |b: &Bench| b.scheduler.job(job).unwrap().record.profile.clone();
    // The job waits for 300 s for the timing of the first worker, which leaves.
    let first = join(&mut b, "a", &["cpu/rare", "gpu/fast"]);
    b.want(first, 1);
    assert!(matches!(
        b.told[&first].last(),
        Some(WorkerCommand::Time { .. })
    ));
    b.leave(first);
    // The job then waits for a second for more workers.
    b.ms = 299_500;
    let second = join(&mut b, "b", &["cpu/rare"]);
    join(&mut b, "c", &["cpu/common"]);
    join(&mut b, "d", &["cpu/common"]);
    b.want(second, 1);
    b.ms = 300_200;
    b.step(Event::Tick);
    assert_eq!(bound(&b), None);
    b.ms = 300_500;
    b.step(Event::Tick);
    assert_eq!(bound(&b).as_deref(), Some("cpu/common"));
}

#[test]
fn profile_that_no_able_worker_has_delays_no_binding() {
    let mut b = two_tiles();
    let intro = Introduction {
        profiles: vec!["gpu/other".to_owned()],
        ..introduction("a", 0)
    };
    b.step(Event::Joined(intro));
    let two = b.join("b");
    b.want(two, 1);
    assert_eq!(b.holders()[0], Some(two), "the job is bound at once");
}

#[test]
fn result_is_assembled_again_when_space_may_be_free() {
    let mut b = two_tiles();
    b.ms = 5000;
    let one = b.join("a");
    for n in 0..2 {
        b.want(one, 1);
        let lease = b.grants(one)[n];
        b.step(Event::Committed {
            lease,
            digest: [2; 32],
            stats: sightline_records::TileStats::default(),
        });
    }
    assert_eq!(b.assembled, [JobId(1)]);
    b.step(Event::AssemblyWaits(JobId(1)));
    b.wait(9);
    assert_eq!(b.assembled.len(), 1);
    b.wait(1);
    assert_eq!(b.assembled.len(), 2);
}

#[test]
fn straggler_gets_second_lease_and_first_output_counts() {
    let mut b = two_tiles();
    let (one, two) = (b.join("a"), b.join("b"));
    b.want(one, 1);
    b.want(two, 1);
    let (slow, fast) = (b.grants(one)[0], b.grants(two)[0]);
    b.step(Event::Progressed(Progress {
        lease: slow,
        cells: 0,
        samples: 1,
    }));
    let stats = sightline_records::TileStats {
        millis: 2000,
        ..Default::default()
    };
    b.step(Event::Committed {
        lease: fast,
        digest: [2; 32],
        stats: stats.clone(),
    });
    b.want(two, 1);
    for samples in 2..9 {
        b.step(Event::Progressed(Progress {
            lease: slow,
            cells: 0,
            samples,
        }));
        b.wait(1);
    }
    let doubled = b.grants(two)[1];
    assert_eq!(doubled.tile, slow.tile);
    b.step(Event::Committed {
        lease: doubled,
        digest: [3; 32],
        stats,
    });
    assert_eq!(b.told[&one].last(), Some(&WorkerCommand::Revoke(slow)));
    assert!(
        b.scheduler.admit(&slow).unwrap().counts(),
        "a late output is compared with the first"
    );
}
