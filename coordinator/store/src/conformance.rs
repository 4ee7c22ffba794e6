//! The test suite of all stores. Random commands are compared with a model in plain maps, after each answer
//! and at the end. The store on disk is also closed and reopened between commands, and loses its sled files.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;

use proptest::prelude::*;
use sightline_records::ids::Digest;
use sightline_records::ids::{JobId, TileIndex};
use sightline_records::*;

use super::*;

#[derive(Clone, Debug)]
pub(super) enum Op {
    Scene(u8, u32),
    Submit {
        key: u8,
        request: u8,
        scene: u8,
        tiles: u32,
    },
    Prioritize(JobId, i32),
    Plan(JobId, u32),
    Bind(JobId, u8),
    Commit(JobId, TileIndex, u8),
    Fail(JobId, TileIndex, u8, u8),
    Forget(JobId, TileIndex, u8, u8),
    SetAside(JobId, TileIndex, u8),
    SetState(JobId, u8, u8),
    Finish(JobId, u8),
    Reopen(JobId),
    Epoch,
    Stamp(u8),
    Delete(JobId),
}

/// An event between the sessions of a store on a disk.
#[derive(Clone, Copy, Debug)]
enum Mishap {
    Restart,
    SledGone,
    /// One changed byte in each of sled's files, at this fraction of the file's length.
    SledDamaged(f64),
    /// The files of sled from the first restart.
    SledStale,
}

pub(super) fn digest(n: u8) -> Digest {
    [n; 32]
}

fn state(n: u8) -> JobState {
    match n {
        0 => JobState::Queued,
        1 => JobState::Running,
        2 => JobState::Paused,
        3 => JobState::Cancelled,
        4 => JobState::Failed {
            reason: "no".to_owned(),
        },
        _ => JobState::Done {
            result: digest(9),
            bytes: 9,
        },
    }
}

const PHASES: [JobPhase; 6] = [
    JobPhase::Queued,
    JobPhase::Running,
    JobPhase::Paused,
    JobPhase::Cancelled,
    JobPhase::Failed,
    JobPhase::Done,
];

/// Returns the phases of a bit set.
fn phases(bits: u8) -> Vec<JobPhase> {
    (0..6)
        .filter(|i| bits >> i & 1 == 1)
        .map(|i| PHASES[i])
        .collect()
}

fn request(n: u8) -> String {
    if n == 0 {
        String::new()
    } else {
        format!("request {n}")
    }
}

pub(super) fn result(n: u8) -> TileResult {
    let stats = TileStats {
        samples: n.into(),
        cells: 2,
        millis: 3,
        worker: "w".to_owned(),
        ..TileStats::default()
    };
    TileResult {
        digest: digest(n),
        bytes: n.into(),
        stats,
    }
}

fn new_job(key: u8, request_number: u8, scene: u8, tiles: u32) -> NewJob {
    NewJob {
        key: digest(key),
        request_id: request(request_number),
        name: "a \"job\"".to_owned(),
        owner: String::new(),
        user: String::new(),
        priority: 0,
        scene: digest(scene),
        spec: vec![key; 40],
        tiles,
        submitted_at_ms: 1000,
    }
}

fn stamp(n: u8) -> RetentionStamp {
    let n = u64::from(n);
    let span = |n: u64| TrustedSpan {
        begun_ms: n,
        doubt_ms: u64::MAX - n,
        next: n.is_multiple_of(2).then_some(NextSpan {
            begun_ms: n,
            doubt_ms: 3,
        }),
    };
    RetentionStamp {
        wall_ms: 1000 * n,
        ran_ms: n + 1,
        jobs: span(n),
        blobs: span(n + 1),
    }
}

fn told<T: Debug>(answer: Result<T, StoreError>) -> String {
    match answer {
        Ok(answer) => format!("{answer:?}"),
        Err(error) => refused(&format!("{error:?}")),
    }
}

fn refused(error: &str) -> String {
    let end = error
        .find(|c: char| !c.is_alphanumeric())
        .unwrap_or(error.len());
    format!("refused: {}", &error[..end])
}

pub(super) fn perform(store: &dyn Store, op: &Op) -> String {
    match *op {
        Op::Scene(n, triangles) => told(store.record_scene(SceneRecord {
            digest: digest(n),
            bytes: 5,
            triangles,
            objects: 1,
            owners: Default::default(),
        })),
        Op::Submit {
            key,
            request,
            scene,
            tiles,
        } => told(store.submit_job(new_job(key, request, scene, tiles))),
        Op::Prioritize(job, priority) => told(store.prioritize_job(job, priority)),
        Op::Plan(job, tiles) => told(store.plan_job(job, tiles)),
        Op::Bind(job, n) => told(store.bind_profile(job, &format!("profile {n}"))),
        Op::Commit(job, tile, n) => told(store.commit_tile(job, tile, result(n))),
        Op::Fail(job, tile, w, r) => {
            told(store.fail_tile(job, tile, &format!("w{w}"), &format!("r{r}")))
        }
        Op::Forget(job, tile, w, r) => {
            told(store.forget_failure(job, tile, &format!("w{w}"), &format!("r{r}")))
        }
        Op::SetAside(job, tile, n) => {
            told(store.set_aside_tile(job, tile, digest(n), 7, &["x".to_owned()]))
        }
        Op::SetState(job, from, to) => {
            told(store.set_job_state(job, &phases(from), state(to), 2000))
        }
        Op::Finish(job, n) => told(store.finish_job(job, digest(n), 8, 3000)),
        Op::Reopen(job) => told(store.reopen_tiles(job)),
        Op::Epoch => told(store.begin_epoch()),
        Op::Stamp(n) => told(store.stamp_retention(stamp(n))),
        Op::Delete(job) => told(store.delete_job(job)),
    }
}

/// Returns the answers to all queries of a store.
pub(super) fn everything(store: &dyn Store) -> String {
    let jobs = store.jobs().unwrap();
    let tiles: Vec<_> = jobs
        .iter()
        .map(|job| store.tiles(job.id).unwrap())
        .collect();
    for (job, tiles) in jobs.iter().zip(&tiles) {
        assert_eq!(store.job(job.id).unwrap().as_ref(), Some(job));
        for tile in tiles {
            assert_eq!(&store.tile(job.id, tile.tile).unwrap(), tile);
        }
    }
    for (before, most) in [(u64::MAX, 2), (3, 10), (2, 0)] {
        let below: Vec<_> = jobs
            .iter()
            .filter(|job| job.id.0 < before)
            .cloned()
            .collect();
        let older = below.len().saturating_sub(most);
        let page = store.jobs_before(JobId(before), most).unwrap();
        assert_eq!(page, (below[older..].to_vec(), older > 0));
    }
    let id = |job: Option<JobRecord>| job.map(|job| job.id);
    let keys: Vec<_> = (0..4)
        .map(|n| id(store.job_by_key(&digest(n)).unwrap()))
        .collect();
    let requests: Vec<_> = (0..4)
        .map(|n| id(store.job_by_request(&request(n)).unwrap()))
        .collect();
    format!(
        "{:?} {jobs:?} {tiles:?} {keys:?} {requests:?} {} {:?}",
        store.scenes().unwrap(),
        store.epoch().unwrap(),
        store.retention_stamp().unwrap()
    )
}

/// The expected state of a store, in plain maps.
#[derive(Default)]
pub(super) struct Model {
    scenes: BTreeMap<Digest, SceneRecord>,
    jobs: BTreeMap<JobId, JobRecord>,
    tiles: BTreeMap<(JobId, TileIndex), TileRecord>,
    requests: BTreeMap<String, JobId>,
    last_job: JobId,
    epoch: u64,
    stamp: Option<RetentionStamp>,
}

impl Model {
    fn newest(&self, key: &Digest) -> Option<&JobRecord> {
        self.jobs.values().rev().find(|job| job.key == *key)
    }

    /// Returns the expected answer as text, or the name of the expected error.
    fn perform(&mut self, op: &Op) -> Result<String, &'static str> {
        fn say<T: Debug>(answer: T) -> Result<String, &'static str> {
            Ok(format!("{answer:?}"))
        }
        let (job_id, tile) = match *op {
            Op::Scene(n, triangles) => {
                let new = SceneRecord {
                    digest: digest(n),
                    bytes: 5,
                    triangles,
                    objects: 1,
                    owners: Default::default(),
                };
                let known = self.scenes.entry(new.digest).or_insert_with(|| new.clone());
                return if *known == new {
                    say(())
                } else {
                    Err("SceneDiffers")
                };
            }
            Op::Submit {
                key,
                request,
                scene,
                tiles,
            } => {
                let new = new_job(key, request, scene, tiles);
                if let Some(id) = self.requests.get(&new.request_id) {
                    let same = self.jobs[id].key == new.key;
                    return if same {
                        say(Submitted {
                            id: *id,
                            existing: true,
                        })
                    } else {
                        Err("RequestIdReused")
                    };
                }
                let live = |job: &&JobRecord| {
                    !matches!(job.state, JobState::Failed { .. } | JobState::Cancelled)
                };
                let existing = self.newest(&new.key).filter(live).map(|job| job.id);
                if existing.is_none() && !self.scenes.contains_key(&new.scene) {
                    return Err("UnknownScene");
                }
                let id = existing.unwrap_or(JobId(self.last_job.0 + 1));
                if request != 0 {
                    self.requests.insert(new.request_id.clone(), id);
                }
                if existing.is_none() {
                    self.last_job = id;
                    let job = JobRecord {
                        id,
                        key: new.key,
                        request_id: new.request_id,
                        name: new.name,
                        owner: new.owner,
                        user: new.user,
                        priority: new.priority,
                        scene: new.scene,
                        spec: new.spec,
                        tiles: new.tiles,
                        state: JobState::Queued,
                        profile: None,
                        submitted_at_ms: new.submitted_at_ms,
                        finished_at_ms: None,
                        reopened_epoch: None,
                    };
                    self.jobs.insert(id, job);
                }
                return say(Submitted {
                    id,
                    existing: existing.is_some(),
                });
            }
            Op::Epoch => {
                self.epoch += 1;
                return say(self.epoch);
            }
            Op::Stamp(n) => {
                self.stamp = Some(stamp(n));
                return say(());
            }
            Op::Commit(job, tile, _)
            | Op::Fail(job, tile, ..)
            | Op::Forget(job, tile, ..)
            | Op::SetAside(job, tile, _) => (job, Some(tile)),
            Op::Prioritize(job, _)
            | Op::Plan(job, _)
            | Op::Bind(job, _)
            | Op::SetState(job, ..)
            | Op::Finish(job, _) => (job, None),
            Op::Reopen(job) | Op::Delete(job) => (job, None),
        };
        let job = self.jobs.get_mut(&job_id).ok_or("UnknownJob")?;
        let ended = matches!(
            job.state,
            JobState::Cancelled | JobState::Failed { .. } | JobState::Done { .. }
        );
        if let Some(tile) = tile {
            if tile.0 >= job.tiles {
                return Err("UnknownTile");
            }
            let found = self
                .tiles
                .entry((job_id, tile))
                .or_insert_with(|| TileRecord::open(tile));
            match (op, found.state.clone()) {
                (&Op::Commit(_, _, n), TileState::Done { digest: kept, .. }) => {
                    if kept == digest(n) {
                        return say(CommitOutcome::AlreadySame);
                    }
                    found.conflicts += 1;
                    return say(CommitOutcome::Conflict {
                        kept,
                        offered: digest(n),
                    });
                }
                (&Op::Commit(_, _, n), _) if !ended => {
                    let TileResult {
                        digest,
                        bytes,
                        stats,
                    } = result(n);
                    found.state = TileState::Done {
                        digest,
                        bytes,
                        stats,
                    };
                    return say(CommitOutcome::Committed);
                }
                (&Op::Fail(_, _, w, r), TileState::Open) if !ended => {
                    let (worker, reason) = (format!("w{w}"), format!("r{r}"));
                    let full = found.failures.len() >= MAX_FAILURES;
                    match found.failures.iter_mut().find(|f| f.worker == worker) {
                        Some(failure) => failure.reason = reason,
                        None if full => {}
                        None => found.failures.push(TileFailure { worker, reason }),
                    }
                    return say(found.failures.len());
                }
                (Op::Fail(..), _) => return say(found.failures.len()),
                (&Op::Forget(_, _, w, r), TileState::Open) if !ended => {
                    let meant = TileFailure {
                        worker: format!("w{w}"),
                        reason: format!("r{r}"),
                    };
                    found.failures.retain(|failure| *failure != meant);
                    return say(());
                }
                (Op::Forget(..), _) => return say(()),
                (&Op::SetAside(_, _, n), TileState::SetAside { digest: d, .. })
                    if d == digest(n) =>
                {
                    return say(());
                }
                (&Op::SetAside(_, _, n), TileState::Open) if !ended => {
                    found.state = TileState::SetAside {
                        digest: digest(n),
                        bytes: 7,
                        reasons: vec!["x".to_owned()],
                    };
                    return say(());
                }
                (Op::SetAside(..), TileState::Done { .. } | TileState::SetAside { .. }) => {
                    return Err("TileNotOpen");
                }
                _ => return Err("IllegalTransition"),
            }
        }
        let mut mine: Vec<&mut TileRecord> = self
            .tiles
            .iter_mut()
            .filter(|((id, _), _)| *id == job_id)
            .map(|(_, tile)| tile)
            .collect();
        match *op {
            Op::Prioritize(..) if ended => return Err("IllegalTransition"),
            Op::Prioritize(_, priority) => job.priority = priority,
            Op::Plan(_, tiles) => match job.tiles {
                known if known == tiles => {}
                0 if ended => return Err("IllegalTransition"),
                0 => job.tiles = tiles,
                _ => return Err("PlanDiffers"),
            },
            Op::Bind(_, n) => {
                return say(job.profile.get_or_insert_with(|| format!("profile {n}")));
            }
            Op::SetState(_, from, to) => {
                let to = state(to);
                if job.state != to {
                    // Rows are the old phases, columns the new phases, both in the order of PHASES.
                    let table = ["xxxxx ", "xxxxx ", "xxxxx ", "x     ", "      ", "      "];
                    let place = |phase| PHASES.iter().position(|&p| p == phase).unwrap();
                    let (a, b) = (place(job.state.phase()), place(to.phase()));
                    if from >> a & 1 == 0 || table[a].as_bytes()[b] != b'x' {
                        return Err("IllegalTransition");
                    }
                    job.state = to;
                    job.finished_at_ms = (b >= 3).then_some(2000);
                }
            }
            Op::Finish(_, n) => match job.state {
                JobState::Done { result, .. } if result == digest(n) => {}
                JobState::Done { .. } => return Err("ResultDiffers"),
                JobState::Queued | JobState::Running => {
                    if mine
                        .iter()
                        .filter(|tile| tile.state != TileState::Open)
                        .count()
                        < job.tiles as usize
                    {
                        return Err("TilesOpen");
                    }
                    job.state = JobState::Done {
                        result: digest(n),
                        bytes: 8,
                    };
                    job.finished_at_ms = Some(3000);
                }
                _ => return Err("IllegalTransition"),
            },
            Op::Reopen(_) => {
                mine.retain(|tile| !matches!(tile.state, TileState::Done { .. }));
                let set_aside = mine
                    .iter()
                    .filter(|tile| tile.state != TileState::Open)
                    .count();
                if ended && (set_aside > 0 || !matches!(job.state, JobState::Done { .. })) {
                    job.state = JobState::Queued;
                    job.finished_at_ms = None;
                }
                for tile in mine {
                    *tile = TileRecord::open(tile.tile);
                }
                return say(set_aside);
            }
            Op::Delete(_) => {
                if !ended {
                    return Err("IllegalTransition");
                }
                self.tiles.retain(|(id, _), _| *id != job_id);
                self.requests.retain(|_, id| *id != job_id);
                return say(self.jobs.remove(&job_id).unwrap());
            }
            _ => unreachable!("handled above"),
        }
        say(job)
    }

    pub(super) fn everything(&self) -> String {
        let jobs: Vec<_> = self.jobs.values().collect();
        let one = |id, tile| {
            self.tiles
                .get(&(id, tile))
                .cloned()
                .unwrap_or_else(|| TileRecord::open(tile))
        };
        let tiles: Vec<Vec<_>> = jobs
            .iter()
            .map(|job| {
                (0..job.tiles)
                    .map(|tile| one(job.id, TileIndex(tile)))
                    .collect()
            })
            .collect();
        let keys: Vec<_> = (0..4)
            .map(|n| self.newest(&digest(n)).map(|job| job.id))
            .collect();
        let requests: Vec<_> = (0..4)
            .map(|n| self.requests.get(&request(n)).copied())
            .collect();
        let scenes: Vec<_> = self.scenes.values().collect();
        format!(
            "{scenes:?} {jobs:?} {tiles:?} {keys:?} {requests:?} {} {:?}",
            self.epoch, self.stamp
        )
    }
}

pub(super) fn op() -> impl Strategy<Value = Op> {
    let job = || prop_oneof![8 => 1_u64..4, 1 => 0_u64..9].prop_map(JobId);
    let tile = || (0..4_u32).prop_map(TileIndex);
    prop_oneof![
        2 => (0..2_u8, prop_oneof![9 => Just(10_u32), 1 => Just(11)]).prop_map(|(n, t)| Op::Scene(n, t)),
        6 => (0..3_u8, 0..4_u8, 0..2_u8, 0..4_u32)
            .prop_map(|(key, request, scene, tiles)| Op::Submit { key, request, scene, tiles }),
        1 => (job(), -1..2_i32).prop_map(|(job, priority)| Op::Prioritize(job, priority)),
        1 => (job(), 0..4_u32).prop_map(|(job, tiles)| Op::Plan(job, tiles)),
        1 => (job(), 0..3_u8).prop_map(|(job, n)| Op::Bind(job, n)),
        10 => (job(), tile(), 0..3_u8).prop_map(|(job, tile, n)| Op::Commit(job, tile, n)),
        5 => (job(), tile(), 0..12_u8, 0..2_u8).prop_map(|(job, tile, w, r)| Op::Fail(job, tile, w, r)),
        3 => (job(), tile(), 0..12_u8, 0..2_u8).prop_map(|(job, tile, w, r)| Op::Forget(job, tile, w, r)),
        3 => (job(), tile(), 0..3_u8).prop_map(|(job, tile, n)| Op::SetAside(job, tile, n)),
        4 => (job(), prop_oneof![3 => Just(63_u8), 1 => 0..64_u8], 0..6_u8)
            .prop_map(|(job, from, to)| Op::SetState(job, from, to)),
        4 => (job(), 0..2_u8).prop_map(|(job, n)| Op::Finish(job, n)),
        2 => job().prop_map(Op::Reopen),
        1 => Just(Op::Epoch),
        1 => (0..3u8).prop_map(Op::Stamp),
        2 => job().prop_map(Op::Delete),
    ]
}

fn mishap() -> impl Strategy<Value = Mishap> {
    prop_oneof![
        Just(Mishap::Restart),
        Just(Mishap::SledGone),
        (0.0..1.0_f64).prop_map(Mishap::SledDamaged),
        Just(Mishap::SledStale),
    ]
}

pub(super) fn step(store: &dyn Store, model: &mut Model, op: &Op) {
    let expected = model.perform(op).unwrap_or_else(refused);
    assert_eq!(perform(store, op), expected, "{op:?}");
}

fn copy_tree(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        if entry.file_type().unwrap().is_dir() {
            copy_tree(&entry.path(), &to.join(entry.file_name()));
        } else {
            std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
}

fn damage_files(directory: &Path, at: f64) {
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            damage_files(&path, at);
        } else {
            let mut bytes = std::fs::read(&path).unwrap();
            let place = (bytes.len() as f64 * at) as usize;
            if let Some(byte) = bytes.get_mut(place) {
                *byte ^= 0x55;
            }
            std::fs::write(&path, bytes).unwrap();
        }
    }
}

/// Applies a mishap to a closed store.
fn suffer(mishap: Mishap, directory: &Path) {
    let (sled, stale) = (directory.join("sled"), directory.join("stale"));
    match mishap {
        Mishap::Restart => {}
        Mishap::SledGone => std::fs::remove_dir_all(&sled).unwrap(),
        Mishap::SledDamaged(at) => damage_files(&sled, at),
        Mishap::SledStale if stale.exists() => {
            std::fs::remove_dir_all(&sled).unwrap();
            copy_tree(&stale, &sled);
        }
        Mishap::SledStale => copy_tree(&sled, &stale),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(256) })]

    #[test]
    fn store_in_memory_matches_model(ops in prop::collection::vec(op(), 1..120)) {
        let (store, mut model) = (MemoryStore::new(), Model::default());
        for op in &ops {
            step(&store, &mut model, op);
        }
        prop_assert_eq!(everything(&store), model.everything());
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        max_shrink_iters: 60,
        ..ProptestConfig::with_cases(16)
    })]

    #[test]
    fn store_on_disk_matches_model_after_any_mishap_to_its_view(
        rounds in prop::collection::vec((prop::collection::vec(op(), 1..25), mishap()), 1..6)
    ) {
        let directory = tempfile::tempdir().unwrap();
        let mut model = Model::default();
        for (ops, mishap) in &rounds {
            let store = SledStore::open(directory.path()).unwrap();
            prop_assert_eq!(everything(&store), model.everything());
            for op in ops {
                step(&store, &mut model, op);
            }
            prop_assert_eq!(everything(&store), model.everything());
            drop(store);
            suffer(*mishap, directory.path());
        }
        let store = SledStore::open(directory.path()).unwrap();
        prop_assert_eq!(everything(&store), model.everything());
    }
}

#[test]
fn concurrent_commands_are_executed_once() {
    let directory = tempfile::tempdir().unwrap();
    let store = SledStore::open(directory.path()).unwrap();
    perform(&store, &Op::Scene(0, 10));
    perform(
        &store,
        &Op::Submit {
            key: 1,
            request: 1,
            scene: 0,
            tiles: 40,
        },
    );
    let committed: usize = std::thread::scope(|scope| {
        let one = |n: u8| {
            let store = &store;
            scope.spawn(move || {
                let mine = (0..40).map(|tile| {
                    store
                        .commit_tile(JobId(1), TileIndex(tile), result(n))
                        .unwrap()
                });
                mine.filter(|outcome| *outcome == CommitOutcome::Committed)
                    .count()
            })
        };
        let threads: Vec<_> = (0..4).map(one).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .sum()
    });
    assert_eq!(committed, 40);
    let tiles = store.tiles(JobId(1)).unwrap();
    assert!(
        tiles
            .iter()
            .all(|tile| tile.conflicts == 3 && matches!(tile.state, TileState::Done { .. }))
    );
    drop(store);
    assert_eq!(
        SledStore::open(directory.path())
            .unwrap()
            .tiles(JobId(1))
            .unwrap(),
        tiles
    );
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(16) })]

    /// Simulates a full disk, which sled meets when it is changed, or earlier when it is read. The next start
    /// brings sled up to date.
    #[test]
    fn view_in_memory_matches_model_and_loses_no_changes(
        before in prop::collection::vec(op(), 1..25),
        is_stuck: bool,
        after in prop::collection::vec(op(), 1..60),
    ) {
        let directory = tempfile::tempdir().unwrap();
        let mut model = Model::default();
        let store = SledStore::open(directory.path()).unwrap();
        before.iter().for_each(|op| step(&store, &mut model, op));
        match is_stuck {
            true => store.get_stuck(),
            false => store.refuse_changes(),
        }
        prop_assert_eq!(everything(&store), model.everything());
        after.iter().for_each(|op| step(&store, &mut model, op));
        prop_assert_eq!(everything(&store), model.everything());
        drop(store);
        let store = SledStore::open(directory.path()).unwrap();
        prop_assert_eq!(everything(&store), model.everything());
    }
}

#[test]
fn open_rejects_directory_in_use() {
    let directory = tempfile::tempdir().unwrap();
    let store = SledStore::open(directory.path()).unwrap();
    match SledStore::open(directory.path()) {
        Err(StoreError::InUse { pid, .. }) => assert_eq!(pid, std::process::id().to_string()),
        other => panic!("{other:?}"),
    }
    drop(store);
    SledStore::open(directory.path()).unwrap();
}

#[test]
fn foreign_view_is_rebuilt_and_missing_journal_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("journal");
    let store = SledStore::open(directory.path()).unwrap();
    perform(&store, &Op::Epoch);
    drop(store);
    let first = std::fs::read(&journal).unwrap();
    std::fs::remove_file(&journal).unwrap();
    let missing = SledStore::open(directory.path());
    assert!(
        matches!(
            missing,
            Err(StoreError::Journal(JournalError::Missing { .. }))
        ),
        "{missing:?}"
    );
    // A longer journal with its watermark: only its id shows that it is another journal.
    let other = tempfile::tempdir().unwrap();
    let store = SledStore::open(other.path()).unwrap();
    (0..5).for_each(|_| drop(perform(&store, &Op::Epoch)));
    drop(store);
    for name in ["journal", "journal.mark"] {
        std::fs::copy(other.path().join(name), directory.path().join(name)).unwrap();
    }
    assert_eq!(
        SledStore::open(directory.path()).unwrap().epoch().unwrap(),
        5
    );
    assert!(directory.path().join("sled.broken-1").exists());
    // A journal that was copied without its watermark.
    std::fs::write(&journal, &first).unwrap();
    let refused = SledStore::open(directory.path());
    assert!(
        matches!(
            refused,
            Err(StoreError::Journal(JournalError::Damaged { .. }))
        ),
        "{refused:?}"
    );
}

#[test]
fn view_with_lost_or_changed_entry_is_rebuilt() {
    for spoil in [None, Some(b"nonsense".as_slice())] {
        let directory = tempfile::tempdir().unwrap();
        let store = SledStore::open(directory.path()).unwrap();
        perform(&store, &Op::Scene(0, 10));
        perform(&store, &Op::Epoch);
        let before = everything(&store);
        drop(store);
        let view = sled::open(directory.path().join("sled")).unwrap();
        match spoil {
            None => view.remove(b"e").unwrap(),
            Some(value) => view.insert(b"e", value).unwrap(),
        }
        .expect("the epoch was there");
        view.flush().unwrap();
        drop(view);
        assert_eq!(
            everything(&SledStore::open(directory.path()).unwrap()),
            before
        );
        assert!(directory.path().join("sled.broken-1").exists());
    }
}

#[test]
fn scene_is_owned_by_every_uploader() {
    let directory = tempfile::tempdir().unwrap();
    let longest = |n: usize| format!("{n:0>32}");
    let scene_sent_by = |n: usize, triangles| SceneRecord {
        digest: digest(0),
        bytes: 5,
        triangles,
        objects: 1,
        owners: std::iter::once(longest(n)).collect(),
    };
    {
        let store = SledStore::open(directory.path()).unwrap();
        (0..MAX_OWNERS).for_each(|n| store.record_scene(scene_sent_by(n, 10)).unwrap());
        assert!(matches!(
            store.record_scene(scene_sent_by(MAX_OWNERS, 10)),
            Err(StoreError::TooLong { .. })
        ));
        assert!(matches!(
            store.record_scene(scene_sent_by(0, 11)),
            Err(StoreError::SceneDiffers { .. })
        ));
        store.record_scene(scene_sent_by(0, 10)).unwrap();
    }
    let known = SledStore::open(directory.path())
        .unwrap()
        .scene(&digest(0))
        .unwrap()
        .unwrap();
    assert_eq!(
        known.owners.into_iter().collect::<Vec<_>>(),
        (0..MAX_OWNERS).map(longest).collect::<Vec<_>>()
    );
}

#[test]
fn longest_records_fit_and_longer_ones_are_rejected() {
    longest_fit("", MAX_NAME_BYTES);
    longest_fit(&"x".repeat(MAX_OWNER_BYTES), MAX_OWNER_BYTES);
}

fn longest_fit(owner: &str, user_bytes: usize) {
    let store = MemoryStore::new();
    perform(&store, &Op::Scene(0, 10));
    let largest = NewJob {
        key: digest(255),
        request_id: "r".repeat(MAX_IDENTIFIER_BYTES),
        name: "\"".repeat(MAX_NAME_BYTES),
        owner: owner.to_owned(),
        user: "\"".repeat(user_bytes),
        priority: i32::MIN,
        scene: digest(0),
        spec: vec![255; MAX_SPEC_BYTES],
        tiles: MAX_TILES,
        submitted_at_ms: u64::MAX,
    };
    for (tiles, name) in [
        (MAX_TILES + 1, "x".to_owned()),
        (1, "x".repeat(MAX_NAME_BYTES + 1)),
    ] {
        let refused = store.submit_job(NewJob {
            tiles,
            name,
            ..largest.clone()
        });
        assert!(matches!(refused, Err(StoreError::TooLong { .. })));
    }
    let spoiled = store.submit_job(NewJob {
        request_id: "a\nb".to_owned(),
        ..largest.clone()
    });
    assert!(matches!(spoiled, Err(StoreError::BadCharacter { .. })));
    store.submit_job(largest).unwrap();
    store
        .bind_profile(JobId(1), &"p".repeat(MAX_IDENTIFIER_BYTES))
        .unwrap();
    let endless = "\"\u{1}é".repeat(1000);
    for worker in 0..10 {
        let worker = worker.to_string().repeat(MAX_WORKER_BYTES);
        let count = store
            .fail_tile(JobId(1), TileIndex(0), &worker, &endless)
            .unwrap();
        assert!(count as usize <= MAX_FAILURES);
    }
    store
        .set_aside_tile(
            JobId(1),
            TileIndex(0),
            digest(255),
            u64::MAX,
            &vec![endless.clone(); 10],
        )
        .unwrap();
    let failed = JobState::Failed { reason: endless };
    let job = store
        .set_job_state(JobId(1), &[JobPhase::Queued], failed, u64::MAX)
        .unwrap();
    assert!(matches!(job.state, JobState::Failed { reason } if reason.len() <= MAX_REASON_BYTES));
}
