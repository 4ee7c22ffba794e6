//! Tests that a crew computes the same bytes as one member. Members join, leave, send wrong bytes or stop,
//! and a block resumes at any phase.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, RwLock};
use std::time::Duration;

use sightline_bake::{BakeError, BakeScene, Control, Crew, Inputs, SoleMember, Watcher};
use sightline_model::numbers::{MaxError, MinShare, RayCount, TargetError, TriangleBudget};
use sightline_model::{
    Adaptive, CellToCell, Completion, Crediting, Effort, Granularity, GridCells, JobSpec,
    KnownCells, LineAim, Method, PlannedJob, Sampler, Sampling, Stop, Task, Visibility,
};
use sightline_sample::PhaseIndex;
use sightline_sample::crew::{FromHelper, FromLeader, Helper, Leader, ToHelper, ToLeader};
use sightline_scene::Scene;
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_trace::{CubeSpec, Tracer, cpu::CpuBackend};
use sightline_viewcells::TileIndex;

/// A watcher that a test can cancel.
#[derive(Default)]
struct Watch {
    stopped: AtomicBool,
    rays: AtomicU64,
    /// The number of reports of rays or queries.
    reports: AtomicU64,
}

impl Watcher for Watch {
    fn rendered(&self, rays: u64) {
        self.rays.fetch_add(rays, Relaxed);
        self.reports.fetch_add(1, Relaxed);
    }
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        self.stopped.load(Relaxed)
    }
}

/// A job with the scene and the tracer for its first tile.
struct Job {
    planned: PlannedJob,
    scene: BakeScene,
    backend: Box<dyn Tracer>,
}

/// Creates a job over a town of a few furnished houses.
fn job(make: impl FnOnce(KnownCells) -> Visibility) -> Job {
    let params = SceneParams {
        triangles: Some(20_000),
        seed: 3,
        ..SceneParams::default()
    };
    job_of(Arc::new(generate(SceneKind::Town, &params).unwrap()), make)
}

/// Returns the task of lines with this target error.
fn lines(cells: KnownCells, error: f64, stop: Stop) -> Visibility {
    let error = TargetError::new(error).unwrap();
    let aim = LineAim::Known { cells, error, stop };
    Method::aggressive(Sampling::new(Sampler::Lines { aim, time: None })).into()
}

fn plain(cells: KnownCells) -> Visibility {
    lines(cells, 2e-3, Stop::Expected)
}

fn with_pairs(cells: KnownCells) -> Visibility {
    Visibility {
        pairs: CellToCell::On,
        ..plain(cells)
    }
}

fn job_of(scene: Arc<Scene>, make: impl FnOnce(KnownCells) -> Visibility) -> Job {
    let cells = KnownCells::Grid(GridCells::new(scene.bounds(), [4, 4, 2]).unwrap());
    let task = make(cells);
    let cubes = CubeSpec::from_sampler(&task.sampling().unwrap().sampler);
    let spec = JobSpec {
        scene: scene.digest().0,
        task: Task::Visibility(task),
    };
    let backend = Box::new(CpuBackend::new(Arc::clone(&scene), cubes).unwrap());
    Job {
        planned: PlannedJob::new(spec).unwrap(),
        scene: BakeScene::new(scene).unwrap(),
        backend,
    }
}

impl Job {
    fn run(&self, watcher: &dyn Watcher, crew: &dyn Crew) -> Result<Vec<u8>, BakeError> {
        let control = Control {
            watcher,
            deadline: None,
            crew,
        };
        let inputs = Inputs::new(&self.scene).with_tracer(&*self.backend);
        sightline_bake::run(&self.planned, TileIndex(0), inputs, control).map(|done| done.bytes)
    }

    fn alone(&self) -> (Vec<u8>, u64) {
        let watch = Watch::default();
        (
            self.run(&watch, &SoleMember).unwrap(),
            watch.rays.load(Relaxed),
        )
    }
}

/// The behaviour of a helper that has results.
#[derive(Clone, Copy, PartialEq)]
enum HelperFault {
    /// The helper sends its results.
    Well,
    /// The helper sends bytes that are not results.
    Badly,
    /// The helper requests items and never answers.
    Never,
    /// The helper answers once, then leaves.
    Once,
}

/// A hub that forwards the messages of a crew.
#[derive(Default)]
struct Hub {
    leader: RwLock<Option<Arc<Leader>>>,
    helpers: RwLock<Vec<Arc<Helper>>>,
    outcomes: Mutex<Vec<Vec<u8>>>,
    /// The phase of each result that helpers sent.
    finds: Mutex<Vec<PhaseIndex>>,
    is_over: AtomicBool,
}

impl Hub {
    /// Forwards a message of the leader.
    fn pass_on(&self, message: FromLeader) {
        let helpers = self.helpers.read().unwrap();
        match message {
            FromLeader::Take {
                member,
                phase,
                items,
            } => {
                helpers[member as usize].hear(ToHelper::Take { phase, items });
            }
            FromLeader::Outcome { phase, bytes, .. } => {
                let mut outcomes = self.outcomes.lock().unwrap();
                assert_eq!(phase.at(), outcomes.len(), "outcomes come in order");
                outcomes.push(bytes.to_vec());
                helpers.iter().for_each(|h| {
                    h.hear(ToHelper::Outcome {
                        phase,
                        bytes: bytes.to_vec(),
                    })
                });
            }
            FromLeader::Dismiss(member) => helpers[member as usize].hear(ToHelper::End),
            FromLeader::End => helpers.iter().for_each(|h| h.hear(ToHelper::End)),
        }
    }

    fn to_leader(&self, message: ToLeader) {
        let leader = self.leader.read().unwrap().clone();
        leader
            .into_iter()
            .for_each(|leader| leader.hear(message.clone()));
    }

    /// Forwards a message of helper number `member`.
    fn pass_back(&self, member: u64, helps: HelperFault, message: FromHelper) {
        match message {
            FromHelper::Ask { phase } => self.to_leader(ToLeader::Ask { member, phase }),
            FromHelper::Found {
                phase,
                items,
                finds,
            } => {
                self.finds.lock().unwrap().push(phase);
                match helps {
                    HelperFault::Well => self.to_leader(ToLeader::Found {
                        member,
                        phase,
                        items,
                        finds,
                    }),
                    HelperFault::Badly => {
                        let finds = vec![7; finds.len()];
                        self.to_leader(ToLeader::Found {
                            member,
                            phase,
                            items,
                            finds,
                        });
                    }
                    HelperFault::Never => {}
                    HelperFault::Once => {
                        self.to_leader(ToLeader::Found {
                            member,
                            phase,
                            items,
                            finds,
                        });
                        self.to_leader(ToLeader::Left(member));
                    }
                }
            }
        }
    }

    /// Adds a helper: sends it the outcomes so far, then notifies the leader.
    fn joins(&self, helper: &Arc<Helper>) {
        let member = {
            let mut helpers = self.helpers.write().unwrap();
            let outcomes = self.outcomes.lock().unwrap();
            for (phase, bytes) in (0..).map(PhaseIndex).zip(outcomes.iter()) {
                helper.hear(ToHelper::Outcome {
                    phase,
                    bytes: bytes.clone(),
                });
            }
            if self.is_over.load(Relaxed) {
                helper.hear(ToHelper::End);
            }
            helpers.push(Arc::clone(helper));
            helpers.len() as u64 - 1
        };
        self.to_leader(ToLeader::Joined(member));
    }
}

/// Runs the tile with helpers that join at once or after some milliseconds, starting from the outcomes of an
/// earlier leader. Returns the bytes, all outcomes, and the number of results that helpers sent.
fn crewed(
    job: &Job,
    helpers: &[(HelperFault, u64)],
    earlier: &[Vec<u8>],
) -> (Vec<u8>, Vec<Vec<u8>>, u64) {
    let (bytes, outcomes, phases) = crewed_phases(job, helpers, earlier);
    (bytes, outcomes, phases.len() as u64)
}

/// Runs the tile like [`crewed`], but returns the phase of each result that helpers sent.
fn crewed_phases(
    job: &Job,
    helpers: &[(HelperFault, u64)],
    earlier: &[Vec<u8>],
) -> (Vec<u8>, Vec<Vec<u8>>, Vec<PhaseIndex>) {
    let hub = Arc::new(Hub::default());
    hub.outcomes.lock().unwrap().extend(earlier.iter().cloned());
    let watch = Arc::new(Watch::default());
    let out = Arc::clone(&hub);
    let leader = Arc::new(Leader::new(
        earlier.to_vec(),
        watch.clone(),
        move |message| out.pass_on(message),
    ));
    *hub.leader.write().unwrap() = Some(Arc::clone(&leader));
    let members: Vec<(Arc<Helper>, Arc<Watch>, u64)> = (0..)
        .zip(helpers)
        .map(|(member, (helps, delay))| {
            let (watch, hub, helps) = (Arc::new(Watch::default()), Arc::clone(&hub), *helps);
            let out = move |message| hub.pass_back(member, helps, message);
            (Arc::new(Helper::new(watch.clone(), out)), watch, *delay)
        })
        .collect();
    members
        .iter()
        .filter(|(.., delay)| *delay == 0)
        .for_each(|(helper, ..)| hub.joins(helper));
    let bytes = std::thread::scope(|scope| {
        for (helper, watch, delay) in &members {
            let hub = &hub;
            scope.spawn(move || {
                if *delay > 0 {
                    std::thread::sleep(Duration::from_millis(*delay));
                    hub.joins(helper);
                }
                let ended = job.run(&**watch, &**helper);
                assert!(
                    matches!(ended, Err(BakeError::Cancelled)),
                    "a helper has no output: {ended:?}"
                );
            });
        }
        let bytes = job.run(&*watch, &*leader).unwrap();
        hub.is_over.store(true, Relaxed);
        // Helpers that join after the leader has ended also receive the end.
        hub.helpers
            .read()
            .unwrap()
            .iter()
            .for_each(|h| h.hear(ToHelper::End));
        bytes
    });
    *hub.leader.write().unwrap() = None;
    let outcomes = std::mem::take(&mut *hub.outcomes.lock().unwrap());
    let finds = std::mem::take(&mut *hub.finds.lock().unwrap());
    (bytes, outcomes, finds)
}

#[test]
fn helpers_of_all_kinds_do_not_change_bytes() {
    let job = job(plain);
    let (expected, _) = job.alone();
    for helpers in [
        &[(HelperFault::Well, 0)][..],
        &[
            (HelperFault::Well, 0),
            (HelperFault::Well, 0),
            (HelperFault::Well, 30),
        ],
        &[
            (HelperFault::Badly, 0),
            (HelperFault::Never, 0),
            (HelperFault::Once, 0),
            (HelperFault::Well, 5),
        ],
    ] {
        let (bytes, _, finds) = crewed(&job, helpers, &[]);
        assert!(bytes == expected, "{} helpers", helpers.len());
        assert!(finds > 0, "a helper did something");
    }
}

#[test]
fn crew_can_share_every_kind_of_lines() {
    type Make = fn(KnownCells) -> Visibility;
    let makers: [(&str, Make); 7] = [
        ("bound", |cells| {
            lines(cells, 2e-3, Stop::Bound(MaxError::new(5e-3).unwrap()))
        }),
        ("bound with completion", |cells| {
            let mut task = lines(cells, 2e-3, Stop::Bound(MaxError::new(5e-3).unwrap()));
            if let Method::Aggressive { completion, .. } = &mut task.method {
                *completion = Completion::Auto;
            }
            task
        }),
        ("pairs", with_pairs),
        ("clusters", |cells| {
            let sampling = plain(cells).sampling().unwrap().clone();
            Method::Aggressive {
                sampling,
                items: Granularity::Clusters,
                completion: Completion::Auto,
            }
            .into()
        }),
        ("shares", |cells| {
            lines(cells, 2e-3, Stop::Share(MinShare::new(1e-3).unwrap()))
        }),
        ("tree", |cells| {
            let budget = TriangleBudget::new(3000).unwrap();
            let cells = Adaptive::new(plain(cells).view_box(), budget, 9).unwrap();
            let error = TargetError::new(2e-3).unwrap();
            let aim = LineAim::Adaptive { cells, error };
            Method::aggressive(Sampling::new(Sampler::Lines { aim, time: None })).into()
        }),
        ("guided", |cells| {
            let rays = RayCount::new(4000).unwrap();
            let sampler = Sampler::Guided {
                cells,
                rays,
                credit: Crediting::default(),
                time: None,
            };
            Method::aggressive(Sampling::new(sampler)).into()
        }),
    ];
    for (name, make) in makers {
        let job = job(make);
        let (bytes, ..) = crewed(
            &job,
            &[(HelperFault::Well, 0), (HelperFault::Well, 10)],
            &[],
        );
        assert!(bytes == job.alone().0, "{name}");
    }
}

#[test]
fn block_resumes_from_any_outcome_without_casting_rays_again() {
    let job = job(with_pairs);
    let (expected, rays) = job.alone();
    let (_, outcomes, _) = crewed(&job, &[(HelperFault::Well, 0)], &[]);
    assert!(outcomes.len() > 6, "{}", outcomes.len());
    for kept in [1, outcomes.len() / 2, outcomes.len() - 1, outcomes.len()] {
        let watch = Arc::new(Watch::default());
        let later = Arc::new(Mutex::new(Vec::new()));
        let kept_too = Arc::clone(&later);
        let leader = Leader::new(outcomes[..kept].to_vec(), watch.clone(), move |message| {
            if let FromLeader::Outcome { phase, bytes, .. } = message {
                kept_too.lock().unwrap().push((phase.at(), bytes.to_vec()));
            }
        });
        assert!(
            job.run(&*watch, &leader).unwrap() == expected,
            "from outcome {kept}"
        );
        // The rays of known phases count as cast.
        assert_eq!(watch.rays.load(Relaxed), rays);
        for (phase, bytes) in later.lock().unwrap().drain(..) {
            assert!(
                phase >= kept && bytes == outcomes[phase],
                "the outcome of phase {phase} is another"
            );
        }
    }
    let mut damaged = outcomes.clone();
    // The leader accepts damaged outcomes that still decode. The storage of outcomes must check their hashes.
    let half = damaged[2].len() / 2;
    damaged[2].truncate(half);
    damaged[4].clear();
    let watch = Arc::new(Watch::default());
    let leader = Leader::new(damaged, watch.clone(), |_| {});
    assert!(
        job.run(&*watch, &leader).unwrap() == expected,
        "damaged outcomes are not used"
    );
}

#[test]
fn helpers_decide_exact_cells_and_leader_does_not_repeat_them() {
    let scene = generate(
        SceneKind::Rooms,
        &SceneParams {
            triangles: Some(600),
            ..SceneParams::default()
        },
    )
    .unwrap();
    let exact = |cells| {
        let sampling = Sampling::new(Sampler::lines(cells));
        let (effort, certificates) = (Effort::Full, true);
        Visibility::from(Method::Exact {
            sampling,
            effort,
            certificates,
        })
    };
    let job = job_of(Arc::new(scene), exact);
    let (expected, _) = job.alone();
    // With a helper, the leader hands over every outcome.
    let (_, outcomes, _) = crewed_phases(&job, &[(HelperFault::Never, 0)], &[]);
    let last = outcomes.len() as u32 - 1;
    // The members share the threads of this process, so the leader sometimes ends first.
    let helpers = [
        (HelperFault::Badly, 0),
        (HelperFault::Well, 0),
        (HelperFault::Once, 0),
    ];
    let helped = (0..20).any(|_| {
        let (bytes, _, phases) = crewed_phases(&job, &helpers, &outcomes[..last as usize]);
        assert!(bytes == expected);
        phases.contains(&PhaseIndex(last))
    });
    assert!(helped, "helpers decided no cell in any of 20 runs");
    // A leader that also has the last outcome makes no queries about cells.
    let reports = |outcomes: &[Vec<u8>]| {
        let watch = Arc::new(Watch::default());
        let leader = Leader::new(outcomes.to_vec(), watch.clone(), |_| {});
        assert!(job.run(&*watch, &leader).unwrap() == expected);
        watch.reports.load(Relaxed)
    };
    let (with, without) = (reports(&outcomes), reports(&outcomes[..last as usize]));
    assert!(
        with + 32 < without,
        "{with} reports with the cells decided, {without} without"
    );
}

#[test]
fn leader_accepts_outcomes_of_earlier_leader_late() {
    let job = job(plain);
    let (expected, rays) = job.alone();
    let (_, outcomes, _) = crewed(&job, &[(HelperFault::Never, 0)], &[]);
    assert!(outcomes.len() > 6, "{}", outcomes.len());
    let (watch, said) = (Arc::new(Watch::default()), Arc::new(Mutex::new(Vec::new())));
    let hears = Arc::clone(&said);
    let leader = Leader::new(Vec::new(), watch.clone(), move |message| {
        hears.lock().unwrap().push(message)
    });
    assert_eq!(leader.phase(), PhaseIndex(0));
    leader.learn(PhaseIndex(0), outcomes.clone());
    assert!(leader.reopened(outcomes.len() as u32, || {}));
    assert!(job.run(&*watch, &leader).unwrap() == expected);
    assert_eq!(watch.rays.load(Relaxed), rays);
    assert!(leader.has_ended());
    drop(leader);
    let said = std::mem::take(&mut *said.lock().unwrap());
    assert_eq!(
        said,
        [FromLeader::End],
        "nothing is computed or handed over again, and the end is said once"
    );
}

/// A watcher that sends earlier outcomes to its leader at the report with number `at`.
struct OutcomeReporter {
    leader: Mutex<Option<Arc<Leader>>>,
    outcomes: Vec<Vec<u8>>,
    at: u64,
    reports: AtomicU64,
}

impl Watcher for OutcomeReporter {
    fn rendered(&self, _: u64) {
        if self.reports.fetch_add(1, Relaxed) == self.at
            && let Some(leader) = &*self.leader.lock().unwrap()
        {
            let from = leader.phase();
            leader.learn(from, self.outcomes[from.at()..].to_vec());
        }
    }
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn leader_accepts_outcomes_at_any_time() {
    let job = job(plain);
    let (expected, _) = job.alone();
    let (_, outcomes, _) = crewed(&job, &[(HelperFault::Never, 0)], &[]);
    let mut learned = 0;
    for at in [0, 1, 3, 6, 10, 15, 25, 40, 60, 100] {
        let (leader, reports) = (Mutex::default(), AtomicU64::new(0));
        let tells = Arc::new(OutcomeReporter {
            leader,
            outcomes: outcomes.clone(),
            at,
            reports,
        });
        let leader = Arc::new(Leader::new(Vec::new(), tells.clone(), |_| {}));
        *tells.leader.lock().unwrap() = Some(Arc::clone(&leader));
        assert!(
            job.run(&*tells, &*leader).unwrap() == expected,
            "told at report {at}"
        );
        learned += u64::from(tells.reports.load(Relaxed) > at);
        *tells.leader.lock().unwrap() = None;
    }
    assert!(learned > 3, "the leader was told {learned} times");
}

#[test]
fn leader_dropped_without_end_dismisses_helpers() {
    let said = Arc::new(Mutex::new(Vec::new()));
    let hears = Arc::clone(&said);
    let watch = Arc::new(Watch::default());
    drop(Leader::new(Vec::new(), watch, move |message| {
        hears.lock().unwrap().push(message)
    }));
    assert_eq!(said.lock().unwrap()[..], [FromLeader::End]);
}

#[test]
fn reconnected_leader_hands_over_outcomes_that_were_not_stored() {
    let job = job(plain);
    let heard: Arc<Mutex<Vec<PhaseIndex>>> = Arc::default();
    let (hears, watch) = (Arc::clone(&heard), Arc::new(Watch::default()));
    let leader = Leader::new(Vec::new(), watch.clone(), move |message| {
        if let FromLeader::Outcome { phase, .. } = message {
            hears.lock().unwrap().push(phase);
        }
    });
    // With a helper that sends no results, the leader hands over every outcome at once.
    leader.hear(ToLeader::Joined(0));
    let (expected, _) = job.alone();
    assert!(job.run(&*watch, &leader).unwrap() == expected);
    let all = std::mem::take(&mut *heard.lock().unwrap());
    let last = *all.last().unwrap();
    assert_eq!(all, (0..=last.0).map(PhaseIndex).collect::<Vec<_>>());
    leader.hear(ToLeader::Kept(3));
    assert!(
        leader.reopened(last.0, || {}),
        "only the last one is missing"
    );
    assert_eq!(std::mem::take(&mut *heard.lock().unwrap()), [last]);
    assert!(leader.reopened(3, || {}));
    assert_eq!(heard.lock().unwrap()[..], all[3..]);
    assert!(
        !leader.reopened(2, || {}),
        "the third one is not here any more"
    );
}
