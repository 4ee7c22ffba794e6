//! A coordinator under load for a while: 200 simulated workers come and go, and clients submit, watch,
//! cancel, pause, fetch and delete.
//!
//! All acknowledged changes must be stored. The memory, the open files and the threads of the coordinator
//! must not grow.
//!
//! ```text
//! SIGHTLINE_SOAK_SECONDS=3600 cargo test --workspace --test soak -- --nocapture
//! export SIGHTLINE_SOAK_SECONDS=900 SIGHTLINE_SOAK_TRIANGLES=400000
//! cargo test --workspace --test soak -- --nocapture
//! ```
//! Without a duration, the test takes half a minute. With triangles, each cell sees a random half of the
//! given number, which causes outputs of 50 kB and results of 13 MB.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_tests::{Sandbox, spec};
use tokio_stream::StreamExt as _;
use tonic::transport::Channel;

mod simulated;

use simulated::Work;

const WORKERS: usize = 200;
const CLIENTS: u64 = 8;
const WATCHERS: usize = 40;
/// The job: 256 tiles of one cell each.
const JOB: &str = "scene.glb --cells 16x16x1 --block-cells 1 --cell-to-cell off --backend cpu";

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap())
}

/// The counts of the clients' observations.
#[derive(Default)]
struct ClientTotals {
    submitted: AtomicU64,
    done: AtomicU64,
    cancelled: AtomicU64,
    fetched: AtomicU64,
}

fn state_of(job: &v1::Job) -> v1::JobState {
    v1::JobState::try_from(job.state).unwrap()
}

fn has_ended(job: &v1::Job) -> bool {
    [
        v1::JobState::Done,
        v1::JobState::Cancelled,
        v1::JobState::Failed,
    ]
    .contains(&state_of(job))
}

/// Follows a job to its end. Returns its last state.
async fn end(client: &mut JobsClient<Channel>, id: u64) -> v1::Job {
    let mut last = None;
    let mut watched = client
        .watch(v1::ShowRequest { job: id })
        .await
        .unwrap()
        .into_inner();
    while let Some(job) = watched.next().await {
        last = Some(job.unwrap());
    }
    last.filter(has_ended)
        .unwrap_or_else(|| panic!("the stream of job {id} ended before the job"))
}

/// Downloads a result, checks its digest, and returns its size in bytes.
async fn fetched(client: &mut JobsClient<Channel>, job: &v1::Job) -> u64 {
    let mut chunks = client
        .fetch(v1::ShowRequest { job: job.id })
        .await
        .unwrap()
        .into_inner();
    let mut hasher = blake3::Hasher::new();
    let mut bytes = 0;
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk.unwrap();
        hasher.update(&chunk.data);
        bytes += chunk.data.len() as u64;
    }
    assert_eq!(
        hasher.finalize().as_bytes().as_slice(),
        job.result,
        "job {}",
        job.id
    );
    assert_eq!(bytes, job.result_bytes, "job {}", job.id);
    bytes
}

/// Submits jobs one after the other, each with another seed and another fate, and deletes them.
async fn client(url: String, own: u64, spec: v1::JobSpec, seen: Arc<ClientTotals>, until: Instant) {
    let mut client = JobsClient::connect(url).await.unwrap();
    for round in 0.. {
        if Instant::now() > until {
            return;
        }
        let mut spec = spec.clone();
        spec::task(&mut spec).seed = Some(1 + own + round * CLIENTS);
        let name = format!("client {own}, round {round}");
        let submit = v1::SubmitRequest {
            spec: Some(spec),
            name,
            ..Default::default()
        };
        let id = client
            .submit(submit)
            .await
            .unwrap()
            .into_inner()
            .job
            .unwrap()
            .id;
        seen.submitted.fetch_add(1, Ordering::Relaxed);
        let show = v1::ShowRequest { job: id };
        match (own + round) % 5 {
            0 => drop(client.cancel(show).await.unwrap()),
            1 => {
                // A client that watches for a moment and disconnects.
                let mut watched = client.watch(show).await.unwrap().into_inner();
                drop(watched.next().await.unwrap().unwrap());
            }
            2 => {
                // The job may have ended already.
                let paused = client
                    .pause(v1::PauseRequest {
                        job: id,
                        ..Default::default()
                    })
                    .await;
                if paused.is_ok() {
                    client.resume(show).await.unwrap();
                }
            }
            3 => {
                // A job that has ended has no partial result.
                let part = client.fetch_partial(show).await;
                if let Ok(part) = part {
                    let mut part = part.into_inner();
                    while let Some(chunk) = part.next().await {
                        chunk.unwrap();
                    }
                }
            }
            _ => {}
        }
        let job = end(&mut client, id).await;
        match state_of(&job) {
            v1::JobState::Done => {
                assert_eq!(
                    (job.tiles_done, job.tiles_set_aside),
                    (job.tiles_total, 0),
                    "job {id}"
                );
                let bytes = fetched(&mut client, &job).await;
                seen.done.fetch_add(1, Ordering::Relaxed);
                seen.fetched.fetch_add(bytes, Ordering::Relaxed);
            }
            v1::JobState::Cancelled => drop(seen.cancelled.fetch_add(1, Ordering::Relaxed)),
            other => panic!("job {id} is {other:?}: {}", job.reason),
        }
        client.delete(show).await.unwrap();
    }
}

/// Watches all jobs and events, and never reads the streams.
async fn idle_watcher(url: String, until: Instant) {
    let mut client = JobsClient::connect(url.clone()).await.unwrap();
    let mut farm = v1::farm_client::FarmClient::connect(url).await.unwrap();
    while Instant::now() < until {
        let jobs = client
            .list(v1::ListRequest::default())
            .await
            .unwrap()
            .into_inner()
            .jobs;
        let events = farm
            .events(v1::EventsRequest {
                follow: true,
                ..Default::default()
            })
            .await
            .unwrap();
        let mut watched = Vec::new();
        for job in jobs.iter().take(3) {
            // The job may have been deleted by now.
            watched.extend(client.watch(v1::ShowRequest { job: job.id }).await);
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        drop((events, watched));
    }
}

/// The number of threads that may remain after a load, for a chore or a heartbeat that has just started.
const THREADS: u64 = 4;

/// The resources of a process.
#[derive(Clone, Copy, Debug)]
struct Use {
    kilobytes: u64,
    files: u64,
    threads: u64,
}

fn used(process: u32) -> Use {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let value_of = |key: &str| -> u64 {
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix(key))
            .unwrap();
        line.split_whitespace().next().unwrap().parse().unwrap()
    };
    let files = std::fs::read_dir(format!("/proc/{process}/fd"))
        .unwrap()
        .count() as u64;
    Use {
        kilobytes: value_of("VmRSS:"),
        files,
        threads: value_of("Threads:"),
    }
}

fn median(uses: &[Use], what: impl Fn(&Use) -> u64) -> u64 {
    let mut all: Vec<u64> = uses.iter().map(what).collect();
    all.sort_unstable();
    all[all.len() / 2]
}

#[test]
fn memory_and_files_stay_constant_under_load() {
    let (seconds, triangles) = (
        number("SIGHTLINE_SOAK_SECONDS", 30),
        number("SIGHTLINE_SOAK_TRIANGLES", 0),
    );
    let mut sandbox = Sandbox::new();
    // Use the setting of deploy/. Otherwise the allocator keeps freed memory for many threads separately.
    sandbox.set("MALLOC_ARENA_MAX", "2");
    sandbox.ok(&format!(
        "generate town --triangles {} -o scene.glb",
        triangles.max(2000)
    ));
    let coordinator = sandbox.serve("data", "--listen 127.0.0.1:0");
    let first = coordinator.submit(JOB);
    let work = Arc::new(Work {
        triangles: triangles as u32,
        ..Work::default()
    });
    let seen = Arc::new(ClientTotals::default());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    let working = simulated::start(&runtime, &[&coordinator.url], WORKERS, &work);
    coordinator.until(first, "the first job", |job| {
        assert!(
            working.iter().all(|worker| !worker.is_finished()),
            "a worker has ended"
        );
        job["state"] == "done"
    });
    let spec = runtime.block_on(async {
        let mut client = JobsClient::connect(coordinator.url.clone()).await.unwrap();
        client
            .show(v1::ShowRequest { job: first })
            .await
            .unwrap()
            .into_inner()
            .spec
            .unwrap()
    });

    let rested = used(coordinator.process.id());
    let begun = Instant::now();
    let until = begun + Duration::from_secs(seconds);
    let mut tasks: Vec<_> = (0..CLIENTS)
        .map(|own| {
            let (url, spec, seen) = (coordinator.url.clone(), spec.clone(), Arc::clone(&seen));
            runtime.spawn(client(url, own, spec, seen, until))
        })
        .collect();
    tasks
        .extend((0..WATCHERS).map(|_| runtime.spawn(idle_watcher(coordinator.url.clone(), until))));
    let (mut uses, mut coming) = (Vec::new(), 0);
    while Instant::now() < until {
        std::thread::sleep(Duration::from_millis(500));
        uses.push(used(coordinator.process.id()));
        // A worker comes and goes.
        coming += 1;
        let (url, name, brief) = (
            coordinator.url.clone(),
            format!("brief-{coming}"),
            Arc::new(Work::default()),
        );
        runtime.spawn(async move {
            // The worker disconnects in the middle of its work.
            drop(
                tokio::time::timeout(
                    Duration::from_millis(300),
                    simulated::work(&url, &name, &brief),
                )
                .await,
            );
        });
    }
    runtime.block_on(async {
        for task in tasks {
            tokio::time::timeout(sightline_tests::LIMIT, task)
                .await
                .expect("a client hangs")
                .unwrap();
        }
        work.over.store(true, Ordering::Relaxed);
    });
    // No worker has detected a fault, because a fault would have ended the worker.
    assert!(
        working.iter().all(|worker| !worker.is_finished()),
        "a worker has ended"
    );
    drop(runtime);

    let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    let early = &uses[uses.len() / 4..uses.len() / 2];
    let late = &uses[uses.len() * 3 / 4..];
    let medians = |some: &[Use]| {
        (
            median(some, |u| u.kilobytes),
            median(some, |u| u.files),
            median(some, |u| u.threads),
        )
    };
    println!(
        "{seconds} s: {} jobs, {} done and {} cancelled, {} outputs of {} MB, {} MB of results fetched; \
         kB, files and threads in the second quarter {:?}, in the last {:?}",
        count(&seen.submitted),
        count(&seen.done),
        count(&seen.cancelled),
        count(&work.done),
        count(&work.bytes) / 1_000_000,
        count(&seen.fetched) / 1_000_000,
        medians(early),
        medians(late),
    );
    assert!(
        count(&seen.done) > 5 && count(&seen.cancelled) > 0,
        "nothing happened"
    );
    let (before, after) = (medians(early), medians(late));
    // The store's cache (64 MB), the last events (8 MB) and the allocator's reserve grow to their limits,
    // faster with more outputs. A leak of the hour-long run is far larger.
    assert!(
        after.0 < before.0 + 40_960,
        "memory grew from {} to {} kB",
        before.0,
        after.0
    );
    assert!(
        after.1 < before.1 + 40,
        "open files grew from {} to {}",
        before.1,
        after.1
    );
    // Blocking threads start under load, in bursts, and stay for ten seconds afterwards. Quarters of the run
    // that are much longer than that are similar, and threads that remain after the load were leaked.
    let warm = medians(&uses[uses.len() / 2..uses.len() * 3 / 4]);
    let is_long = seconds >= 120;
    assert!(
        !is_long || after.2 < warm.2 + 8,
        "threads grew from {} to {}",
        warm.2,
        after.2
    );
    let idle = Instant::now() + Duration::from_secs(30);
    loop {
        let threads = used(coordinator.process.id()).threads;
        if threads <= rested.threads + THREADS {
            break;
        }
        assert!(
            Instant::now() < idle,
            "{threads} threads are left, and there were {} before",
            rested.threads
        );
        std::thread::sleep(Duration::from_millis(500));
    }
    // All deleted jobs are gone, and the farm works.
    let left = coordinator.json("jobs --all");
    assert_eq!(left.as_array().unwrap().len(), 1, "{left}");
    coordinator.ok(&format!("delete {first}"));
}
