//! Tests of a coordinator with store and blobs in memory: a job from its submission to its result, retries,
//! and lease expiry.

use std::sync::Arc;
use std::time::Duration;

use glam::Vec3;
use sightline_assemble::{OutputError, expected_nodes};
use sightline_model::codec;
use sightline_model::numbers::TileCells;
use sightline_model::{
    CellSet, CellSets, CellToCell, Effort, GridCells, Hits, JobSpec, KnownCells, Method,
    PlannedJob, Sampler, Sampling, Task, TileOutput, TracerChoice, Visibility,
};
use sightline_pvs::Pvs;
use sightline_records::ids::{Digest, JobId, WorkerId};
use sightline_records::{JobPhase, JobState, NewJob};
use sightline_scene::{Aabb, Object, Scene, Triangle};
use sightline_scheduler::{Grant, Introduction, WorkerCommand};
use sightline_store::{MemoryBlobs, MemoryStore};
use tokio::sync::mpsc;

use crate::clock::ManualClock;
use crate::config::Leases;
use crate::coordinator::Coordinator;
use crate::dispatch::outbox::Outbox;
use crate::jobs::control::{self, JobError};
use crate::jobs::submit::{Submission, SubmitError, submit};
use crate::outputs::commit::{self, OutputBytes, ResultError, SizeLimit, UploadHeader};
use crate::records::JobChanges;
use crate::startup;
use crate::workers::sessions::{self, Message};

impl Outbox for mpsc::Sender<WorkerCommand> {
    fn offer(&self, command: WorkerCommand) -> bool {
        self.try_send(command).is_ok()
    }
}

/// Creates a coordinator without a disk. Returns the coordinator, its clock, and the digest of a scene of one
/// triangle.
pub(crate) fn coordinator() -> (Arc<Coordinator>, Arc<ManualClock>, Digest) {
    let clock = Arc::new(ManualClock::default());
    let (store, blobs) = (Box::new(MemoryStore::new()), Box::new(MemoryBlobs::new()));
    let c = Coordinator::new(
        Leases::default(),
        store,
        blobs,
        Box::new(Arc::clone(&clock)),
    )
    .unwrap();
    let scene = c.take_scene(&triangle()).unwrap();
    (c, clock, scene)
}

/// Creates a scene of one triangle.
pub(crate) fn triangle() -> Scene {
    let triangle = Triangle {
        v: [Vec3::ZERO, Vec3::X, Vec3::Y],
    };
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: 1,
    }];
    Scene::new("test", vec![triangle], objects).unwrap()
}

/// A triangle whose alpha mask is open everywhere.
const MASKED: &str = r#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.2]}}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36,
            "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]
    }"#;

#[test]
fn exact_methods_reject_scene_with_masks() {
    let (c, ..) = coordinator();
    let options = sightline_scene::load::LoadOptions {
        alpha_textures: true,
        ..Default::default()
    };
    let loaded =
        sightline_scene::load::load_bytes_with("mask.gltf", MASKED.as_bytes(), None, &options);
    let scene = c.take_scene(&loaded.unwrap().scene).unwrap();
    let job = |method: Method| {
        let name = method.name();
        let spec = JobSpec::new(scene, method);
        let submission = Submission {
            request_id: name.to_string(),
            name: "masked".to_owned(),
            ..nameless(spec)
        };
        submit(&c, &submission)
    };
    let cells = KnownCells::Grid(grid([1, 1, 1], 512));
    let sampling = Sampling::new(Sampler::lines(cells));
    assert!(job(Method::aggressive(sampling.clone())).is_ok());
    for effort in [Effort::Full, Effort::Bounded] {
        let why = job(Method::exact(sampling.clone(), effort)).unwrap_err();
        assert!(
            matches!(&why, SubmitError::Spec(e) if e.to_string().contains("give aggressive")),
            "{why}"
        );
    }
}

/// Submits a job of two tiles with one cell each.
pub(crate) fn two_tiles(c: &Arc<Coordinator>, scene: Digest) -> JobId {
    let spec = lines(scene, grid([2, 1, 1], 1), 1);
    let submission = Submission {
        request_id: "one".to_owned(),
        name: "two tiles".to_owned(),
        ..nameless(spec)
    };
    submit(c, &submission).unwrap().id
}

/// Adds a worker that requests tiles.
pub(crate) fn join(c: &Arc<Coordinator>, name: &str) -> (WorkerId, mpsc::Receiver<WorkerCommand>) {
    let (out, commands) = mpsc::channel(8);
    let profiles = vec!["cpu/test".to_owned()];
    let (name, signature) = (name.to_owned(), name.to_owned());
    let version = String::new();
    let intro = Introduction {
        name,
        signature,
        version,
        instance: 0,
        profiles,
        held: Vec::new(),
        helps: false,
    };
    let (joined, follow_ups) = sessions::join(c, intro, Box::new(out)).unwrap();
    follow_ups.run(c);
    let worker = joined.worker;
    sessions::heard(c, worker, Message::Want(2)).run(c);
    (worker, commands)
}

pub(crate) fn granted(commands: &mut mpsc::Receiver<WorkerCommand>) -> Grant {
    match commands.try_recv() {
        Ok(WorkerCommand::Grant(grant)) => *grant,
        other => panic!("no grant: {other:?}"),
    }
}

/// Encodes the output of a granted tile in which every cell sees `visible`.
pub(crate) fn output(grant: &Grant, visible: &[u32]) -> Vec<u8> {
    output_of(
        grant,
        &CellSet {
            visible: visible.to_vec(),
            ..CellSet::default()
        },
    )
}

/// Encodes the output of a granted tile in which every cell is `cell`.
pub(crate) fn output_of(grant: &Grant, cell: &CellSet) -> Vec<u8> {
    let tile = &grant.planned.plan().tiles[grant.lease.tile.at()];
    let nodes = expected_nodes(grant.planned.visibility().unwrap(), tile).unwrap();
    let cells = (0..tile.cells).map(|_| cell.clone());
    codec::encode(&TileOutput::Cells(CellSets {
        cells: cells.collect(),
        nodes,
        pairs: None,
        portals: Vec::new(),
    }))
    .unwrap()
}

pub(crate) fn put(c: &Arc<Coordinator>, grant: &Grant, bytes: &[u8]) -> Result<(), ResultError> {
    let digest = *blake3::hash(bytes).as_bytes();
    let (bytes_announced, lease) = (bytes.len() as u64, grant.lease);
    commit::put(
        c,
        &UploadHeader {
            lease,
            digest,
            bytes: bytes_announced,
            samples: 3,
            millis: 4,
        },
        &OutputBytes::Sent(bytes),
        SizeLimit::Any,
    )
}

#[test]
fn job_in_memory_runs_from_submission_to_result() {
    let (c, clock, scene) = coordinator();
    let id = two_tiles(&c, scene);
    assert_eq!(
        control::summary(&c, id).unwrap().record.state,
        JobState::Queued
    );
    let (_, mut commands) = join(&c, "a");
    let grants = [granted(&mut commands), granted(&mut commands)];
    assert_eq!(control::summary(&c, id).unwrap().tiles_running, 2);
    let empty = output(&grants[0], &[]);
    assert!(matches!(
        put(&c, &grants[0], &empty[1..]),
        Err(ResultError::Output(OutputError::Encoding(_)))
    ));
    // The job has viewpoints in all cells, and does not request contributions.
    let unreached = output_of(
        &grants[0],
        &CellSet {
            unreached: true,
            ..CellSet::default()
        },
    );
    assert!(matches!(
        put(&c, &grants[0], &unreached),
        Err(ResultError::Output(OutputError::Viewpoints))
    ));
    let hits = Some(Hits {
        viewpoints: 1,
        lines: 1,
        counts: Vec::new(),
    });
    let hits = output_of(
        &grants[0],
        &CellSet {
            hits,
            ..CellSet::default()
        },
    );
    assert!(matches!(
        put(&c, &grants[0], &hits),
        Err(ResultError::Output(OutputError::Contributions))
    ));
    put(&c, &grants[0], &empty).unwrap();
    put(&c, &grants[0], &empty).unwrap();
    assert!(matches!(
        put(&c, &grants[0], &output(&grants[0], &[0])),
        Err(ResultError::Conflict)
    ));
    assert!(matches!(
        control::result(&c.records, id),
        Err(JobError::NoResult {
            phase: JobPhase::Running,
            ..
        })
    ));
    clock.advance(Duration::from_secs(5));
    put(&c, &grants[1], &output(&grants[1], &[0])).unwrap();
    // A separate thread assembles the result.
    let mut tries = 0;
    let done = loop {
        let summary = control::summary(&c, id).unwrap();
        if summary.ended() {
            break summary;
        }
        tries += 1;
        assert!(tries < 1000, "{summary:?}");
        std::thread::sleep(Duration::from_millis(10));
    };
    assert_eq!((done.tiles_done, done.samples, done.tile_millis), (2, 6, 8));
    assert_eq!(
        done.record.finished_at_ms,
        Some(done.record.submitted_at_ms + 5000)
    );
    let result = c
        .blobs
        .read(&control::result(&c.records, id).unwrap())
        .unwrap();
    let pvs = Pvs::from_bytes(result).unwrap();
    let at = |x| {
        let mut ids = Vec::new();
        pvs.visible(pvs.find_cell([x, 0.5, 0.5]).unwrap(), &mut ids)
            .unwrap();
        ids
    };
    assert_eq!((at(0.25), at(0.75)), (vec![], vec![0]));
    // The result contains the outputs of the tiles, so they were removed.
    assert!(!c.blobs.has(blake3::hash(&empty).as_bytes()).unwrap());
    // The same job, submitted again, returns the result. If the result is lost, the job is baked again.
    let spec = grants[0].planned.spec().clone();
    let again = Submission {
        request_id: "two".to_owned(),
        ..nameless(spec)
    };
    let answer = submit(&c, &again).unwrap();
    assert!(answer.existing && answer.id == id);
    c.blobs
        .remove(&control::result(&c.records, id).unwrap())
        .unwrap();
    let answer = submit(
        &c,
        &Submission {
            request_id: "three".to_owned(),
            ..again
        },
    )
    .unwrap();
    assert!(!answer.existing && answer.id != id);
}

#[test]
fn lease_without_renewal_moves_to_other_worker() {
    let (c, clock, scene) = coordinator();
    two_tiles(&c, scene);
    let (a, mut commands_a) = join(&c, "a");
    let leases = [
        granted(&mut commands_a).lease,
        granted(&mut commands_a).lease,
    ];
    sessions::heard(&c, a, Message::Draining).run(&c);
    clock.advance(Duration::from_secs(11));
    startup::tick(&c).run(&c);
    assert_eq!(
        leases.map(|l| commands_a.try_recv() == Ok(WorkerCommand::Revoke(l))),
        [true, true]
    );
    let (_, mut commands_b) = join(&c, "b");
    assert_eq!(granted(&mut commands_b).lease.tile, leases[0].tile);
}

#[test]
fn job_of_other_version_is_not_retried() {
    let (c, _, scene) = coordinator();
    let job = NewJob {
        key: [1; 32],
        request_id: String::new(),
        name: "old".to_owned(),
        owner: String::new(),
        user: String::new(),
        priority: 0,
        scene,
        spec: b"of another version".to_vec(),
        tiles: 2,
        submitted_at_ms: 0,
    };
    let mut changes = JobChanges::begin(&c);
    let id = changes.submit(job).unwrap().id;
    let failed = JobState::Failed {
        reason: "as it was".to_owned(),
    };
    changes
        .set_state(id, &[JobPhase::Queued], failed.clone())
        .unwrap();
    changes.finish().run(&c);
    let refused = control::retry(&c, id).unwrap_err();
    assert!(matches!(refused, JobError::Outdated(_)), "{refused}");
    assert!(
        refused.to_string().contains("submit the job again"),
        "{refused}"
    );
    assert_eq!(c.records.job(id).unwrap().unwrap().state, failed);
}

/// Returns a grid of cells of the unit cube, in tiles of at most `tile_cells` cells.
pub(crate) fn grid(cells: [u32; 3], tile_cells: u32) -> GridCells {
    let view = Aabb::new(Vec3::ZERO, Vec3::ONE);
    let tile_cells = TileCells::new(tile_cells).unwrap();
    GridCells::new(view, cells)
        .unwrap()
        .with_tile_cells(tile_cells)
        .unwrap()
}

/// Returns a job of lines over a grid, with the tracer `Cpu` and without cell-to-cell visibility.
pub(crate) fn lines(scene: Digest, cells: GridCells, seed: u64) -> JobSpec {
    let sampling = Sampling {
        tracer: TracerChoice::Cpu,
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

/// Returns a job of lines over a single cell, with default parameters.
pub(crate) fn one_cell(scene: Digest, seed: u64) -> JobSpec {
    let sampling = Sampling::new(Sampler::lines(KnownCells::Grid(grid([1, 1, 1], 512))));
    let task = Visibility {
        seed,
        ..Method::aggressive(sampling).into()
    };
    JobSpec {
        scene,
        task: Task::Visibility(task),
    }
}

pub(crate) fn nameless(spec: JobSpec) -> Submission {
    let job = Arc::new(PlannedJob::new(spec).unwrap());
    let (request_id, name, owner, user) = Default::default();
    Submission {
        request_id,
        name,
        owner,
        user,
        priority: 0,
        job,
        cause: None,
    }
}
