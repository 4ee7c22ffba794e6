//! `sightline worker`, and the functions that other commands share with them.

use std::io::{BufWriter, Write as _};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use sightline_coordinator::{ConnectionLimits, Connections, Listener, Probed};
use sightline_model::TracerChoice;
use sightline_sampling::gpu::{AdapterChoice, adapters};
use sightline_worker::{Backends, Moved, Pulse, SceneCache, Stop, WorkerError};
use tokio::sync::watch;

use crate::backends::{choice, say_missing};
use crate::error::CliError;
use crate::printable;
use crate::progress::say;
use crate::serve_args::WorkerArgs;

/// Runs a worker. The first SIGTERM or Ctrl-C lets it finish its tiles, the second one stops it at once.
pub fn worker(args: &WorkerArgs) -> Result<(), CliError> {
    let adapter = args
        .adapter
        .clone()
        .map_or(AdapterChoice::AllowSoftware, AdapterChoice::Named);
    check_adapter(args)?;
    let backends = Arc::new(Backends::probe(choice(args.backend), adapter));
    say_missing(&backends)?;
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
        pulse: Arc::default(),
        traces: args.traces.start("sightline-worker", &name)?,
        name,
    };
    let _sends_the_rest = config.traces.closing();
    use_threads(threads(args.threads))?;
    let runtime = runtime()?;
    let pulse = Arc::clone(&config.pulse);
    let ended = runtime.block_on(async {
        if let Some(address) = args.metrics_listen {
            watch_at(address, pulse).await?;
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
                WorkerError::Address(..) => CliError::Usage(e.to_string()),
                WorkerError::Random(_) => CliError::internal(e),
                WorkerError::Unreachable { .. } | WorkerError::Refused(_) => {
                    CliError::Coordinator(e.to_string())
                }
            })
    });
    runtime.shutdown_timeout(Duration::from_millis(200));
    ended
}

/// Serves what a worker tells of itself, as a coordinator does.
async fn watch_at(address: SocketAddr, pulse: Arc<Pulse>) -> Result<(), CliError> {
    let connections = Connections::new(ConnectionLimits::of_process().map_err(CliError::internal)?);
    let listener = Listener::bind(address, true, &connections).await;
    let listener = listener.map_err(|e| CliError::Usage(format!("--metrics-listen: {e}")))?;
    let address = listener.local_addr().map_err(CliError::internal)?;
    print(&format!("metrics on http://{address}/metrics"))?;
    tokio::spawn(sightline_coordinator::serve_probes(
        Arc::new(Watched(pulse)),
        listener,
    ));
    Ok(())
}

/// A worker as who watches machines sees it.
struct Watched(Arc<Pulse>);

impl Probed for Watched {
    fn metrics(&self) -> Result<String, String> {
        let mut text = format!(
            "# HELP sightline_worker_connected 1 while the coordinator knows this worker.\n\
             # TYPE sightline_worker_connected gauge\nsightline_worker_connected {}\n\
             # HELP sightline_worker_tiles Tiles, by how they ended.\n\
             # TYPE sightline_worker_tiles counter\n",
            u8::from(self.0.is_connected())
        );
        for (outcome, count) in self.0.tiles() {
            text.push_str(&format!(
                "sightline_worker_tiles_total{{outcome=\"{outcome}\"}} {count}\n"
            ));
        }
        let moved = self.0.transfers();
        text.push_str(
            "# HELP sightline_worker_blobs Scenes, packs and outputs, by how they went.\n\
             # TYPE sightline_worker_blobs counter\n",
        );
        for Moved {
            direction,
            way,
            blobs,
            ..
        } in &moved
        {
            let labels = format!("{{direction=\"{direction}\",way=\"{way}\"}}");
            text.push_str(&format!("sightline_worker_blobs_total{labels} {blobs}\n"));
        }
        text.push_str(
            "# HELP sightline_worker_blob_bytes Their bytes.\n# TYPE sightline_worker_blob_bytes counter\n\
             # UNIT sightline_worker_blob_bytes bytes\n",
        );
        for Moved {
            direction,
            way,
            bytes,
            ..
        } in &moved
        {
            let labels = format!("{{direction=\"{direction}\",way=\"{way}\"}}");
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
                "no coordinator knows this worker at the moment".to_owned(),
            ]),
        }
    }
}

/// Refuses an `--adapter` that matches no adapter of this machine; the error lists the names.
fn check_adapter(args: &WorkerArgs) -> Result<(), CliError> {
    let Some(part) = args
        .adapter
        .as_ref()
        .filter(|_| args.backend != TracerChoice::Cpu)
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
    Err(CliError::Usage(if names.is_empty() {
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

/// Resolves at the next SIGTERM or Ctrl-C.
pub async fn stop_signal() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut term) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = term.recv() => {}
                _ = tokio::signal::ctrl_c() => {}
            }
            return;
        }
    }
    // Ctrl-C can be caught even where SIGTERM cannot.
    let _ = tokio::signal::ctrl_c().await;
}

/// The number of threads to use: the given one, otherwise one per core; 1 to 1024.
pub fn threads(asked: Option<usize>) -> usize {
    asked
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
        .clamp(1, 1024)
}

/// Sets the size of the process's thread pool, which reads scenes, samples, answers queries and codes
/// results. Call it before the first use of the pool; only the first call of a process counts. Tiles run on
/// separate threads, so that no tile waits inside another one.
pub fn use_threads(threads: usize) -> Result<(), CliError> {
    static IS_SET: Mutex<bool> = Mutex::new(false);
    let mut is_set = IS_SET.lock().unwrap_or_else(PoisonError::into_inner);
    if !*is_set {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .map_err(CliError::internal)?;
        *is_set = true;
    }
    Ok(())
}

/// The async runtime. Its two threads only move bytes.
pub fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(CliError::internal)
}

/// Prints a result to stdout, with control characters escaped.
pub fn print(text: &str) -> Result<(), CliError> {
    let text = printable::text(text);
    print_with(|out| writeln!(out, "{text}"))
}

/// Prints a result to stdout as one line of JSON, which is never in memory as a whole.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), CliError> {
    print_with(|out| {
        printable::json(&mut *out, value)?;
        writeln!(out)
    })
}

/// Gives a function stdout to write to.
pub fn print_with(
    write: impl FnOnce(&mut BufWriter<std::io::StdoutLock<'_>>) -> std::io::Result<()>,
) -> Result<(), CliError> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    match write(&mut out).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        // The reader has closed the pipe, as in `sightline dump … | head`.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(e) => Err(CliError::stdout(&e)),
    }
}

/// The host's name, the process and a random number: containers may share the first two.
pub fn default_name() -> Result<String, CliError> {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host
        .trim()
        .chars()
        .filter(|c| c.is_ascii_alphanumeric() || *c == '-')
        .take(40)
        .collect();
    let host = if host.is_empty() {
        "worker".to_owned()
    } else {
        host
    };
    let random = getrandom::u32().map_err(CliError::internal)? as u16;
    Ok(format!("{host}-{}-{random:04x}", std::process::id()))
}
