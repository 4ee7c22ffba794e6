//! Snapshots of the lists of jobs and workers, shared by all watchers.
//!
//! A snapshot is created at most once per second, and only while a client watches and something has changed.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use sightline_proto::v1;
use sightline_records::ids::JobId;
use tokio::sync::watch;

use super::super::blocking::blocking;
use super::super::{status, wire};
use crate::coordinator::Coordinator;
use crate::jobs::control;

/// Minimum time between two snapshots of the list of jobs, and of the list of workers.
const EVERY: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(2)];
/// Maximum number of listed jobs, which are the newest jobs.
const MOST_JOBS: usize = 200;

/// A snapshot of the jobs as JSON: all of them, and the changes since the previous snapshot.
#[derive(Clone, Debug, Default)]
pub(super) struct JobsSnapshot {
    pub(super) number: u64,
    pub(super) whole: Arc<str>,
    pub(super) change: Arc<str>,
}

/// The snapshots that watchers receive.
pub(super) struct Snapshots {
    pub(super) jobs: watch::Sender<JobsSnapshot>,
    pub(super) workers: watch::Sender<Arc<str>>,
}

impl Snapshots {
    /// Creates the snapshots, and starts the tasks that renew them.
    pub(super) fn start(c: &Arc<Coordinator>) -> Arc<Self> {
        let this = Self {
            jobs: watch::Sender::new(JobsSnapshot::default()),
            workers: watch::Sender::new("".into()),
        };
        let this = Arc::new(this);
        tokio::spawn(keep_jobs(Arc::clone(c), Arc::clone(&this)));
        tokio::spawn(keep_workers(Arc::clone(c), Arc::clone(&this)));
        this
    }
}

/// The jobs of a list, each as JSON, by number.
type Listed = BTreeMap<u64, Arc<str>>;

/// Ended jobs, each with its end time in milliseconds since 1970 and as JSON. They change only after a retry.
type Ended = BTreeMap<u64, (Option<u64>, Arc<str>)>;

async fn keep_jobs(c: Arc<Coordinator>, this: Arc<Snapshots>) {
    let mut changes = c.dispatcher.watch_all();
    let (mut before, mut ended) = (Listed::new(), Ended::new());
    loop {
        watched(&this.jobs).await;
        changes.mark_unchanged();
        let known = std::mem::take(&mut ended);
        match blocking(&c, move |c| list(c, known)).await {
            Ok((jobs, older, now_ended)) => {
                ended = now_ended;
                let changed = jobs
                    .iter()
                    .filter(|(id, text)| before.get(id) != Some(text));
                let changed: Vec<&str> = changed.map(|(_, text)| &**text).collect();
                let change = event(&c, false, older, &changed, &gone(&before, &jobs));
                let all: Vec<&str> = jobs.values().map(|text| &**text).collect();
                let whole = event(&c, true, older, &all, &[]);
                before = jobs;
                this.jobs.send_modify(|moment| {
                    *moment = JobsSnapshot {
                        number: moment.number + 1,
                        whole: whole.into(),
                        change: change.into(),
                    };
                });
            }
            Err(s) => tracing::warn!(
                "the job list of the dashboard cannot be created: {}",
                s.message()
            ),
        }
        tokio::time::sleep(EVERY[0]).await;
        if changes.changed().await.is_err() {
            return;
        }
    }
}

async fn keep_workers(c: Arc<Coordinator>, this: Arc<Snapshots>) {
    loop {
        watched(&this.workers).await;
        let now = c.scheduler_now();
        let roster = c.dispatcher.read(|scheduler| scheduler.roster(now));
        let workers = roster.into_iter().map(wire::member).collect();
        // The page shows the faults of connected workers.
        let answer = v1::ListWorkersResponse {
            workers,
            now_ms: now.unix_ms,
            quarantined: Vec::new(),
        };
        if let Ok(text) = serde_json::to_string(&answer) {
            this.workers.send_replace(text.into());
        }
        tokio::time::sleep(EVERY[1]).await;
    }
}

/// Waits until a client watches.
async fn watched<T>(sender: &watch::Sender<T>) {
    while sender.receiver_count() == 0 {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Returns the newest jobs, true if older jobs exist, and the ended jobs.
fn list(c: &Coordinator, mut known: Ended) -> Result<(Listed, bool, Ended), tonic::Status> {
    let newest = c.records.jobs_before(JobId(u64::MAX), MOST_JOBS);
    let (records, older) = newest.map_err(|e| status::of_store(&e))?;
    let (mut jobs, mut ended) = (Listed::new(), Ended::new());
    for record in records {
        let (id, mut end) = (record.id.0, record.finished_at_ms);
        let mut is_over = record.state.phase().ended();
        let text = match known.remove(&id).filter(|(at, _)| is_over && *at == end) {
            Some((_, text)) => text,
            None => match control::summary(c, record.id) {
                Ok(summary) => {
                    // The scheduler may not have received the end of the job yet.
                    is_over = summary.ended();
                    end = summary.record.finished_at_ms;
                    // With the clock and the number of workers, the text of every job would change.
                    let job = v1::Job {
                        spec: None,
                        now_ms: 0,
                        workers: 0,
                        ..wire::job(&summary)
                    };
                    serde_json::to_string(&job)
                        .map_err(|e| status::internal(&e.to_string()))?
                        .into()
                }
                // Another call deleted the job in between.
                Err(sightline_store::StoreError::UnknownJob { .. }) => continue,
                Err(e) => return Err(status::of_store(&e)),
            },
        };
        if is_over {
            ended.insert(id, (end, Arc::clone(&text)));
        }
        jobs.insert(id, text);
    }
    Ok((jobs, older, ended))
}

/// Returns the jobs that are no longer listed.
fn gone(before: &Listed, now: &Listed) -> Vec<u64> {
    before
        .keys()
        .filter(|id| !now.contains_key(id))
        .copied()
        .collect()
}

/// Formats the event that watchers receive.
fn event(c: &Coordinator, whole: bool, older: bool, jobs: &[&str], gone: &[u64]) -> String {
    let (now, workers) = (
        c.now().unix_ms,
        c.dispatcher.read(|scheduler| scheduler.workers()),
    );
    format!(
        r#"{{"whole":{whole},"older":{older},"now":{now},"workers":{workers},"gone":{gone:?},"jobs":[{}]}}"#,
        jobs.join(",")
    )
}
