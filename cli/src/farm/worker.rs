//! `sightline worker`: runs a worker.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use sightline::Error;
use sightline::process::{default_name, runtime, threads, use_threads};
use sightline::tracers::{note_missing, selection};
use sightline_coordinator::{ConnectionLimits, Connections, Listener, Probed};
use sightline_model::TracerChoice;
use sightline_trace::gpu::{AdapterChoice, adapters};
use sightline_worker::{Backends, SceneCache, Stop, TransferTotals, WorkerCounters, WorkerError};
use tokio::sync::watch;

use crate::args::serve::WorkerArgs;
use crate::terminal::interrupt::stop_signal;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Runs a worker. At the first SIGTERM or Ctrl-C, the worker finishes its tiles. At the second one, the
/// worker stops immediately.
pub fn run(args: &WorkerArgs) -> Result<(), Error> {
    let adapter = args
        .adapter
        .clone()
        .map_or(AdapterChoice::AllowSoftware, AdapterChoice::Named);
    check_adapter(args)?;
    let backends = Arc::new(Backends::probe(selection(args.backend), adapter));
    note_missing(&backends, &Terminal::new())?;
    say(&format!("backends: {}", backends.profiles().join(", ")));
    let name = args.name.clone().map_or_else(default_name, Ok)?;
    let config = sightline_worker::Config {
        coordinator: args.remote.coordinator.clone(),
        credentials: args.remote.credentials()?,
        backends,
        scenes: Arc::new(SceneCache::default()),
        receivers: Arc::default(),
        helps: true,
        direct: !args.no_direct,
        give_up_after: args.give_up_after.map(Duration::from_secs),
        counters: Arc::default(),
        traces: args.traces.options().start("sightline-worker", &name)?,
        name,
    };
    let _flush_guard = config.traces.flush_guard();
    use_threads(threads(args.threads))?;
    let runtime = runtime()?;
    let counters = Arc::clone(&config.counters);
    let ended = runtime.block_on(async {
        if let Some(address) = args.metrics_listen {
            watch_at(address, counters).await?;
        }
        let (stop, stopped) = watch::channel(Stop::No);
        tokio::spawn(async move {
            for next in [Stop::Drain, Stop::Now] {
                stop_signal().await;
                // The send fails only if the worker has ended already.
                let _ = stop.send(next);
            }
            std::future::pending::<()>().await;
        });
        sightline_worker::run(config, stopped)
            .await
            .map_err(|e| match e {
                WorkerError::Address(..) => Error::usage(e.to_string()),
                WorkerError::Random(_) => Error::internal(e),
                WorkerError::Unreachable { .. } | WorkerError::Refused(_) => {
                    Error::coordinator(e.to_string())
                }
            })
    });
    runtime.shutdown_timeout(Duration::from_millis(200));
    ended
}

/// Serves the metrics and the health of a worker.
async fn watch_at(address: SocketAddr, counters: Arc<WorkerCounters>) -> Result<(), Error> {
    let connections = Connections::new(ConnectionLimits::of_process().map_err(Error::internal)?);
    let listener = Listener::bind(address, true, &connections).await;
    let listener = listener.map_err(|e| Error::usage(format!("--metrics-listen: {e}")))?;
    let address = listener.local_addr().map_err(Error::internal)?;
    print(&format!("metrics on http://{address}/metrics"))?;
    tokio::spawn(sightline_coordinator::serve_probes(
        Arc::new(Watched(counters)),
        listener,
    ));
    Ok(())
}

/// A worker that reports metrics and readiness.
struct Watched(Arc<WorkerCounters>);

impl Probed for Watched {
    fn metrics(&self) -> Result<String, String> {
        let mut text = format!(
            "# HELP sightline_worker_connected 1 while the coordinator knows this worker.\n\
             # TYPE sightline_worker_connected gauge\nsightline_worker_connected {}\n\
             # HELP sightline_worker_tiles Ended tiles, by outcome.\n\
             # TYPE sightline_worker_tiles counter\n",
            u8::from(self.0.is_connected())
        );
        for (outcome, count) in self.0.tiles() {
            text.push_str(&format!(
                "sightline_worker_tiles_total{{outcome=\"{outcome}\"}} {count}\n"
            ));
        }
        let transfers = self.0.transfers();
        text.push_str(
            "# HELP sightline_worker_blobs Transferred scenes, packs and outputs, by direction and route.\n\
             # TYPE sightline_worker_blobs counter\n",
        );
        for TransferTotals {
            direction,
            route,
            blobs,
            ..
        } in &transfers
        {
            let labels = format!("{{direction=\"{direction}\",way=\"{route}\"}}");
            text.push_str(&format!("sightline_worker_blobs_total{labels} {blobs}\n"));
        }
        text.push_str(
            "# HELP sightline_worker_blob_bytes Bytes of the transferred blobs.\n\
             # TYPE sightline_worker_blob_bytes counter\n\
             # UNIT sightline_worker_blob_bytes bytes\n",
        );
        for TransferTotals {
            direction,
            route,
            bytes,
            ..
        } in &transfers
        {
            let labels = format!("{{direction=\"{direction}\",way=\"{route}\"}}");
            text.push_str(&format!(
                "sightline_worker_blob_bytes_total{labels} {bytes}\n"
            ));
        }
        text.push_str("# EOF\n");
        Ok(text)
    }

    fn readiness(&self) -> Result<(), Vec<String>> {
        match self.0.is_connected() {
            true => Ok(()),
            false => Err(vec![
                "this worker is not registered at its coordinator".to_owned(),
            ]),
        }
    }
}

/// Checks that `--adapter` matches an adapter of this machine. The error lists the names of the adapters.
fn check_adapter(args: &WorkerArgs) -> Result<(), Error> {
    let Some(part) = args
        .adapter
        .as_ref()
        .filter(|_| [TracerChoice::Auto, TracerChoice::Gpu].contains(&args.backend))
    else {
        return Ok(());
    };
    let names: Vec<String> = adapters().into_iter().map(|a| a.name).collect();
    if names
        .iter()
        .any(|name| name.to_lowercase().contains(&part.to_lowercase()))
    {
        return Ok(());
    }
    Err(Error::usage(if names.is_empty() {
        format!(
            "--adapter {part}: this machine has no Vulkan adapter; install a driver, or use --backend cpu"
        )
    } else {
        format!(
            "--adapter {part} matches no adapter; give part of one of these names: {}",
            names.join(", ")
        )
    }))
}
