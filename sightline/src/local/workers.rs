//! The workers of this process.

use std::sync::Arc;
use std::time::Duration;

use sightline_proto::connection::Credentials;
use sightline_traces::Traces;
use sightline_worker::{Backends, SceneCache, Stop, WorkerError};
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::Local;
use crate::error::Error;
use crate::process::threads;

/// Maximum time that the process waits for stopped workers.
const TO_STOP: Duration = Duration::from_secs(2);

/// The workers of this process.
pub(super) struct Workers {
    stop: watch::Sender<Stop>,
    running: JoinSet<Result<(), WorkerError>>,
}

impl Workers {
    /// Starts the workers of a job.
    pub(super) fn start(
        local: &Local,
        traces: &Traces,
        url: &str,
        backends: &Arc<Backends>,
        scenes: &Arc<SceneCache>,
    ) -> Self {
        let (stop, stopped) = watch::channel(Stop::No);
        let mut running = JoinSet::new();
        for i in 0..local.workers.map_or_else(|| threads(None), usize::from) {
            let config = sightline_worker::Config {
                coordinator: url.to_owned(),
                credentials: Credentials::default(),
                name: format!("in-process-{i}"),
                backends: Arc::clone(backends),
                scenes: Arc::clone(scenes),
                receivers: Arc::default(),
                // The workers share the threads of this process, so they do not help each other.
                helps: false,
                direct: false,
                give_up_after: Some(Duration::from_secs(30)),
                counters: Arc::default(),
                traces: traces.clone(),
            };
            running.spawn(sightline_worker::run(config, stopped.clone()));
        }
        Self { stop, running }
    }

    /// Waits until a worker ends with an error, and returns the error. Never returns if no worker fails.
    pub(super) async fn failure(&mut self) -> Error {
        while let Some(ended) = self.running.join_next().await {
            match ended {
                Ok(Ok(())) => {}
                Ok(Err(e)) => return Error::internal(e),
                Err(e) => return Error::internal(e),
            }
        }
        std::future::pending().await
    }

    /// Stops the workers and their tiles.
    pub(super) async fn end(mut self) {
        // The send fails only if all workers have ended already.
        let _ = self.stop.send(Stop::Now);
        let all = async { while self.running.join_next().await.is_some() {} };
        // A worker that does not answer in time is dropped.
        let _ = tokio::time::timeout(TO_STOP, all).await;
    }
}
