//! Load tests of one coordinator: simulated workers lease and commit tiles as fast as they can, on the store
//! on disk.
//!
//! ```text
//! cargo test --workspace --lib -- --ignored --nocapture one_coordinator ten_thousand_finished
//! ```
//! The workers call the functions of the coordinator. The figures include the scheduler, its lock and the
//! synced store. They do not include the network, the checks of outputs, or the files of outputs.
//!
//! `SIGHTLINE_WORKERS` and `SIGHTLINE_TILES` change the number of workers (default: 1000) and the number of
//! tiles (default: 100 000).

#![allow(clippy::print_stdout, reason = "a measurement")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use sightline_model::PlannedJob;
use sightline_records::ids::{JobId, Lease, TileIndex};
use sightline_records::{NewJob, SceneRecord, TileResult, TileStats};
use sightline_scheduler::{Event, Introduction, Progress, WorkerCommand};
use sightline_store::{SledStore, Store};
use tokio::sync::mpsc;

use crate::access::Caller;
use crate::config::Config;
use crate::coordinator::Coordinator;
use crate::dispatch::outbox::Outbox;
use crate::jobs::control;
use crate::jobs::submit::{Submission, submit};
use crate::records::OutputCommit;
use crate::startup::tick;
use crate::tests::life::{grid, lines};
use crate::workers::sessions::{self, Message};

/// The number of tiles of one job.
const TILES_OF_A_JOB: u64 = 50_000;

struct Queue(mpsc::UnboundedSender<(Lease, Instant)>);

impl Outbox for Queue {
    fn offer(&self, command: WorkerCommand) -> bool {
        match command {
            WorkerCommand::Grant(grant) => self.0.send((grant.lease, Instant::now())).is_ok(),
            WorkerCommand::Help(_) | WorkerCommand::Revoke(_) | WorkerCommand::Time { .. } => true,
        }
    }
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |n| n.parse().unwrap())
}

/// Returns the peak resident memory of this process in kilobytes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.trim().trim_end_matches(" kB").parse().ok())
        .unwrap_or(0)
}

fn job(c: &Arc<Coordinator>, seed: u64, tiles: u64) -> JobId {
    let spec = lines([7; 32], grid([100, (tiles / 100) as u32, 1], 1), seed);
    submit(
        c,
        &Submission {
            request_id: seed.to_string(),
            name: "load".to_owned(),
            owner: String::new(),
            user: String::new(),
            priority: 0,
            job: Arc::new(PlannedJob::new(spec).unwrap()),
            cause: None,
        },
    )
    .unwrap()
    .id
}

/// Commits a tile like an arriving output, without the checks and the file of the output.
fn commit(c: &Arc<Coordinator>, lease: Lease) {
    let (committing, admitted) = OutputCommit::begin(c, lease).ok().unwrap();
    assert!(admitted.counts());
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&lease.job.0.to_le_bytes());
    digest[8..12].copy_from_slice(&lease.tile.0.to_le_bytes());
    let stats = TileStats {
        samples: 1,
        cells: 1,
        millis: 1,
        worker: "w".to_owned(),
        ..TileStats::default()
    };
    let result = TileResult {
        digest,
        bytes: 1,
        stats: stats.clone(),
    };
    committing.record(result).unwrap();
    c.tell(Event::Committed {
        lease,
        digest,
        stats,
    })
    .run(c);
}

#[test]
#[ignore = "a measurement of a minute"]
fn one_coordinator_with_a_thousand_workers() {
    let (workers, tiles) = (
        number("SIGHTLINE_WORKERS", 1000),
        number("SIGHTLINE_TILES", 100_000),
    );
    let directory = tempfile::tempdir().unwrap();
    let open = || Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
    let c = open();
    let scene = SceneRecord {
        digest: [7; 32],
        bytes: 1,
        triangles: 1,
        objects: 1,
        owners: Default::default(),
    };
    c.records.record_scene(scene).unwrap();
    let ids: Vec<JobId> = (0..tiles / TILES_OF_A_JOB)
        .map(|i| job(&c, i + 1, TILES_OF_A_JOB))
        .collect();
    let total = ids.len() as u64 * TILES_OF_A_JOB;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .max_blocking_threads(256)
        .enable_all()
        .build()
        .unwrap();
    let (begin, done) = (Instant::now(), Arc::new(AtomicU64::new(0)));
    let latencies = runtime.block_on(async {
        let mut running = Vec::new();
        for w in 0..workers {
            let (c, done) = (Arc::clone(&c), Arc::clone(&done));
            running.push(tokio::spawn(async move {
                work(&c, w, &done, total * 9 / 10).await
            }));
        }
        let ticking = Arc::clone(&c);
        let ticks = tokio::spawn(async move {
            loop {
                tokio::time::sleep(Duration::from_secs(1)).await;
                let follow_ups = tick(&ticking);
                let c = Arc::clone(&ticking);
                tokio::task::spawn_blocking(move || follow_ups.run(&c))
                    .await
                    .unwrap();
            }
        });
        let mut all = Vec::new();
        for r in running {
            all.extend(r.await.unwrap());
        }
        ticks.abort();
        all
    });
    let took = begin.elapsed().as_secs_f64();
    let mut latencies: Vec<Duration> = latencies;
    latencies.sort();
    let at =
        |share: f64| latencies[((latencies.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    println!(
        "{workers} workers, {} leases: {:.0} a second",
        latencies.len(),
        latencies.len() as f64 / took
    );
    println!(
        "from Want to Grant: median {:.2} ms, p99 {:.2} ms, most {:.2} ms",
        at(0.5),
        at(0.99),
        at(1.0)
    );
    println!("memory, at most: {} MB", resident() / 1024);
    drop(runtime);
    drop(c);
    let begin = Instant::now();
    let c = open();
    println!(
        "restart with {total} tiles: {:.2} s until jobs are taken up",
        begin.elapsed().as_secs_f64()
    );
    let left: u32 = ids
        .iter()
        .filter_map(|id| control::live(&c, *id))
        .map(|s| s.tiles_total - s.tiles_done)
        .sum();
    println!("tiles left after the restart: {left}");
}

/// Simulates a worker that leases one tile at a time, until `enough` tiles are done. Returns the times from
/// Want to Grant.
async fn work(c: &Arc<Coordinator>, w: u64, done: &AtomicU64, enough: u64) -> Vec<Duration> {
    let (send, mut granted) = mpsc::unbounded_channel();
    let profiles = vec!["cpu/test".to_owned()];
    let intro = Introduction {
        name: format!("w{w}"),
        signature: format!("w{w}"),
        version: String::new(),
        instance: w + 1,
        profiles,
        held: Vec::new(),
        helps: false,
    };
    let worker = sessions::join(c, intro, Box::new(Queue(send)))
        .unwrap()
        .0
        .worker;
    let mut latencies = Vec::new();
    while done.load(Ordering::Relaxed) < enough {
        let wanted = Instant::now();
        let follow_ups = sessions::heard(c, worker, Message::Want(1));
        if !follow_ups.is_empty() {
            let c = Arc::clone(c);
            tokio::task::spawn_blocking(move || follow_ups.run(&c))
                .await
                .unwrap();
        }
        let Ok(Some((lease, at))) =
            tokio::time::timeout(Duration::from_secs(5), granted.recv()).await
        else {
            break;
        };
        latencies.push(at.duration_since(wanted));
        sessions::heard(
            c,
            worker,
            Message::Progress(Progress {
                lease,
                cells: 0,
                samples: 1,
            }),
        )
        .discard();
        let put = Arc::clone(c);
        tokio::task::spawn_blocking(move || commit(&put, lease))
            .await
            .unwrap();
        done.fetch_add(1, Ordering::Relaxed);
    }
    drop(sessions::leave(c, worker, "w"));
    latencies
}

#[test]
#[ignore = "a measurement"]
fn ten_thousand_finished_jobs() {
    let directory = tempfile::tempdir().unwrap();
    {
        let store = SledStore::open(&directory.path().join("state")).unwrap();
        let scene = SceneRecord {
            digest: [7; 32],
            bytes: 1,
            triangles: 1,
            objects: 1,
            owners: Default::default(),
        };
        store.record_scene(scene).unwrap();
        for i in 0..10_000u64 {
            let mut key = [0; 32];
            key[..8].copy_from_slice(&i.to_le_bytes());
            let new = NewJob {
                key,
                request_id: String::new(),
                name: "old".to_owned(),
                owner: String::new(),
                user: String::new(),
                priority: 0,
                scene: [7; 32],
                spec: Vec::new(),
                tiles: 1,
                submitted_at_ms: i,
            };
            let id = store.submit_job(new).unwrap().id;
            let stats = TileStats {
                samples: 1,
                cells: 1,
                millis: 1,
                worker: "w".to_owned(),
                ..TileStats::default()
            };
            let result = TileResult {
                digest: key,
                bytes: 1,
                stats,
            };
            store.commit_tile(id, TileIndex(0), result).unwrap();
            store.finish_job(id, key, 1, i).unwrap();
        }
    }
    let c = Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
    let begin = Instant::now();
    let (page, _) = control::list(
        &c,
        &Caller::Nobody,
        JobId(u64::MAX),
        1000,
        &control::JobFilter::default(),
    )
    .unwrap();
    println!(
        "a page of {} jobs in {:.1} ms",
        page.len(),
        begin.elapsed().as_secs_f64() * 1e3
    );
}
