//! The list of jobs and the list of workers as all watchers see them: made once, at most once a second, and
//! only while somebody watches and something has changed.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use sightline_proto::v1;
use sightline_records::ids::JobId;
use tokio::sync::watch;

use super::super::blocking::blocking;
use super::super::{status, wire};
use crate::jobs::control;
use crate::state::Coordinator;

/// Shortest time between two states of the list of jobs, and of the workers.
const EVERY: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(2)];
/// Jobs that are listed: the newest.
const MOST_JOBS: usize = 200;

/// The jobs at one moment, as JSON: all of them, and those that changed since the moment before.
#[derive(Clone, Debug, Default)]
pub(super) struct JobsSnapshot {
    pub(super) number: u64,
    pub(super) whole: Arc<str>,
    pub(super) change: Arc<str>,
}

/// The states that watchers are told of.
pub(super) struct Snapshots {
    pub(super) jobs: watch::Sender<JobsSnapshot>,
    pub(super) workers: watch::Sender<Arc<str>>,
}

impl Snapshots {
    /// Begins to make them.
    pub(super) fn of(c: &Arc<Coordinator>) -> Arc<Self> {
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

/// The jobs of a list, each as JSON.
type Listed = BTreeMap<u64, Arc<str>>;

/// Jobs that have ended: when, and as JSON. They change only when they are tried again.
type Ended = BTreeMap<u64, (Option<u64>, Arc<str>)>;

async fn keep_jobs(c: Arc<Coordinator>, this: Arc<Snapshots>) {
    let mut changes = c.watched().any();
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
                "the dashboard's list of jobs cannot be made: {}",
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
        let now = c.now_plain();
        let roster = c.lock().scheduler.roster(now);
        let workers = roster.into_iter().map(wire::member).collect();
        // The page shows the trouble of those that are connected.
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

/// Waits until somebody watches.
async fn watched<T>(sender: &watch::Sender<T>) {
    while sender.receiver_count() == 0 {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// The newest jobs; whether there are older ones; and those that have ended.
fn list(c: &Coordinator, mut known: Ended) -> Result<(Listed, bool, Ended), tonic::Status> {
    let newest = c.store.jobs_before(JobId(u64::MAX), MOST_JOBS);
    let (records, older) = newest.map_err(|e| status::of_store(&e))?;
    let (mut jobs, mut ended) = (Listed::new(), Ended::new());
    for record in records {
        let (id, mut end) = (record.id.0, record.finished_at_ms);
        let mut is_over = record.state.phase().ended();
        let text = match known.remove(&id).filter(|(at, _)| is_over && *at == end) {
            Some((_, text)) => text,
            None => match control::summary(c, record.id) {
                Ok(summary) => {
                    // The scheduler may not have heard of the end yet.
                    is_over = summary.ended();
                    end = summary.record.finished_at_ms;
                    // The clock would make every job new.
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
                // It was deleted in between.
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

/// The jobs that are not listed any more.
fn gone(before: &Listed, now: &Listed) -> Vec<u64> {
    before
        .keys()
        .filter(|id| !now.contains_key(id))
        .copied()
        .collect()
}

/// What a watcher is sent.
fn event(c: &Coordinator, whole: bool, older: bool, jobs: &[&str], gone: &[u64]) -> String {
    let (now, workers) = (c.now().unix_ms, c.lock().scheduler.workers());
    format!(
        r#"{{"whole":{whole},"older":{older},"now":{now},"workers":{workers},"gone":{gone:?},"jobs":[{}]}}"#,
        jobs.join(",")
    )
}
