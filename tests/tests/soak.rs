//! A coordinator under load for a while: 200 simulated workers that come and go, and clients that submit,
//! watch, cancel, pause, fetch and delete. Everything that is acknowledged is there, and memory, open files
//! and threads of the coordinator stay as they are.
//!
//! ```text
//! SIGHTLINE_SOAK_SECONDS=3600 cargo test --workspace --test soak -- --nocapture
//! export SIGHTLINE_SOAK_SECONDS=900 SIGHTLINE_SOAK_TRIANGLES=400000
//! cargo test --workspace --test soak -- --nocapture
//! ```
//! Without a time it takes half a minute. With triangles, each cell sees a random half of so many, which
//! makes outputs of 50 kB and results of 13 MB.

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
/// 256 tiles of one cell.
const JOB: &str = "scene.glb --cells 16x16x1 --block-cells 1 --cell-to-cell off --backend cpu";

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap())
}

/// What clients have seen.
#[derive(Default)]
struct Seen {
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

/// Follows a job to its end.
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

/// The bytes of a stream of chunks, which are those of the digest.
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
async fn client(url: String, own: u64, spec: v1::JobSpec, seen: Arc<Seen>, until: Instant) {
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
                // Somebody who looks for a moment and goes.
                let mut watched = client.watch(show).await.unwrap().into_inner();
                drop(watched.next().await.unwrap().unwrap());
            }
            2 => {
                // It may have ended already.
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
                // A job that has ended has no part.
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

/// Watches what there is to watch, and never reads on.
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
            // It may be deleted by now.
            watched.extend(client.watch(v1::ShowRequest { job: job.id }).await);
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        drop((events, watched));
    }
}

/// Threads that may be left after a load: those that a chore or a heartbeat has just taken.
const THREADS: u64 = 4;

/// What a process uses.
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

fn median(of: &[Use], what: impl Fn(&Use) -> u64) -> u64 {
    let mut all: Vec<u64> = of.iter().map(what).collect();
    all.sort_unstable();
    all[all.len() / 2]
}

#[test]
fn memory_and_files_stay_as_they_are_under_load() {
    let (seconds, triangles) = (
        number("SIGHTLINE_SOAK_SECONDS", 30),
        number("SIGHTLINE_SOAK_TRIANGLES", 0),
    );
    let mut sandbox = Sandbox::new();
    // As deploy/ has it: otherwise freed memory is kept for many threads apart.
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
    let seen = Arc::new(Seen::default());
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
        // One comes and goes.
        coming += 1;
        let (url, name, brief) = (
            coordinator.url.clone(),
            format!("brief-{coming}"),
            Arc::new(Work::default()),
        );
        runtime.spawn(async move {
            // It goes in the middle of whatever it does.
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
    // Workers have found no fault: one that did would have ended with it.
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
    // The store's cache (64 MB), the last events (8 MB) and what the allocator keeps back grow to their
    // bounds, the faster the more outputs come; a leak of the hour-long run is far more.
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
    // Threads that block come with load, in bursts, and stay for ten seconds after it. Quarters that are long
    // beside that are alike, and what is left after the load was leaked.
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
    // All that was deleted is gone, and the farm is of use.
    let left = coordinator.json("jobs --all");
    assert_eq!(left.as_array().unwrap().len(), 1, "{left}");
    coordinator.ok(&format!("delete {first}"));
}
