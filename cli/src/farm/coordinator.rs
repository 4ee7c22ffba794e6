//! `sightline coordinator`: runs a coordinator.

use std::path::Path;
use std::sync::Arc;

use sightline::Error;
use sightline::LibraryQueries;
use sightline::process::{default_name, runtime};
use sightline_coordinator::access::Access;
use sightline_coordinator::clock::SystemClock;
use sightline_coordinator::{
    Config, ConnectionLimits, Connections, Coordinator, Listener, OpenError, Quotas, Tls, TlsFiles,
};
use sightline_store::{BlobPlace, MemoryBlobs, MemoryStore, PlaceError, SledStore};
use sightline_traces::Traces;

use crate::args::serve::CoordinatorArgs;
use crate::farm::replica::{self, Listening};
use crate::farm::store_location::StorePlace;
use crate::terminal::interrupt::stop_signal;
use crate::terminal::stderr::say;

/// Runs a coordinator until SIGTERM or Ctrl-C.
pub fn run(args: &CoordinatorArgs) -> Result<(), Error> {
    let tls = encryption(args)?;
    let certified = tls.as_ref().is_some_and(|tls| tls.checks_workers());
    let access =
        (args.tokens.is_some() || certified).then(|| Access::new(args.tokens.clone(), certified));
    let access = access
        .transpose()
        .map_err(|e| Error::input(e.to_string()))?
        .map(Arc::new);
    let mut config = Config {
        blobs: blob_place(args.blobs.as_deref(), args.allow_plaintext)?,
        ..Config::new(args.data_dir.clone())
    };
    config.leases.spot_check = args.spot_check;
    (config.retention.keep, config.retention.keep_bytes) = (args.keep, args.keep_bytes);
    config.quotas =
        Quotas::parse(&args.quota).map_err(|e| Error::usage(format!("--quota: {e}")))?;
    let traces = args
        .traces
        .options()
        .start("sightline-coordinator", &default_name()?)?;
    let _flush_guard = traces.flush_guard();
    let coordinator = match StorePlace::from_args(&args.store)? {
        StorePlace::Database(database) => {
            return runtime()?.block_on(async {
                reload_on_hangup(tls.clone())?;
                let listening = listen(args, tls.is_some()).await?;
                replica::serve(args, *database, config, tls, listening, move |c| {
                    equip(c, access, traces)
                })
                .await
            });
        }
        StorePlace::Default => Coordinator::open(config),
        StorePlace::Sled(directory) => open_on(config, &directory),
        StorePlace::Memory => {
            say(
                "the store is in memory: jobs, scenes and results are lost when this coordinator \
                 ends",
            );
            let (store, blobs) = (Box::new(MemoryStore::new()), Box::new(MemoryBlobs::new()));
            Coordinator::new(config.leases, store, blobs, Box::new(SystemClock))
        }
    };
    let coordinator = coordinator.map_err(|e| Error::input(e.to_string()))?;
    equip(&coordinator, access, traces);
    runtime()?.block_on(async {
        reload_on_hangup(tls.clone())?;
        let listening = listen(args, tls.is_some()).await?;
        listening.announce()?;
        let Listening {
            calls: listener,
            pages,
            metrics,
            ..
        } = listening;
        let c = Arc::clone(&coordinator);
        let served = sightline_coordinator::serve(c, listener, tls.clone(), stop_signal());
        let c = Arc::clone(&coordinator);
        let shown = async move {
            match pages {
                Some((pages, _)) => sightline_coordinator::serve_http(c, pages, tls).await,
                None => std::future::pending().await,
            }
        };
        let counted = async move {
            match metrics {
                Some((listener, _)) => {
                    sightline_coordinator::serve_probes(coordinator, listener).await
                }
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            ended = served => ended,
            ended = shown => ended.map(|never| match never {}),
            never = counted => match never {},
        }
        .map_err(Error::internal)
    })
}

/// Opens the records in a separate directory, and all other data in the data directory.
fn open_on(config: Config, directory: &Path) -> Result<Arc<Coordinator>, OpenError> {
    let store = SledStore::open(directory)?;
    let blobs = config.open_blobs(None)?;
    Coordinator::open_on(config, Box::new(store), blobs)
}

/// Gives a coordinator the library that answers queries about scenes, the check of callers' credentials, and
/// the collector of spans.
fn equip(coordinator: &Coordinator, access: Option<Arc<Access>>, traces: Traces) {
    coordinator.send_traces(traces);
    coordinator.answer_with(Box::new(LibraryQueries));
    if let Some(access) = access {
        coordinator.ask_callers(access);
    }
}

/// Listens on the addresses in the arguments.
async fn listen(args: &CoordinatorArgs, is_encrypted: bool) -> Result<Listening, Error> {
    let protected = args.allow_plaintext || is_encrypted;
    let scheme = if is_encrypted { "https" } else { "http" };
    let connections = Connections::new(ConnectionLimits::of_process().map_err(Error::internal)?);
    let calls = Listener::bind(args.listen, protected, &connections)
        .await
        .map_err(|e| Error::usage(e.to_string()))?;
    let address = calls.local_addr().map_err(Error::internal)?;
    let url = format!("{scheme}://{address}");
    let pages_beyond = args.http.is_some_and(|address| !address.ip().is_loopback());
    if args.tokens.is_some() && !is_encrypted && (!address.ip().is_loopback() || pages_beyond) {
        say("tokens are sent unencrypted; use --tls-cert and --tls-key to encrypt connections");
    }
    if (!address.ip().is_loopback() || pages_beyond) && args.tokens.is_none() {
        say(
            "every client that reaches this address can read, submit and cancel all jobs; use \
             --tokens to authenticate clients",
        );
    }
    let pages = match args.http {
        None => None,
        Some(address) => {
            let pages = Listener::bind(address, protected, &connections).await;
            let pages = pages.map_err(|e| Error::usage(format!("--http: {e}")))?;
            let address = pages.local_addr().map_err(Error::internal)?;
            Some((pages, format!("{scheme}://{address}/")))
        }
    };
    let metrics = match args.metrics_listen {
        None => None,
        Some(address) => {
            // The metrics contain no secrets, so every caller that reaches the address may read them.
            let metrics = Listener::bind(address, true, &connections).await;
            let metrics = metrics.map_err(|e| Error::usage(format!("--metrics-listen: {e}")))?;
            let address = metrics.local_addr().map_err(Error::internal)?;
            Some((metrics, format!("http://{address}/metrics")))
        }
    };
    Ok(Listening {
        calls,
        url,
        pages,
        metrics,
    })
}

/// Parses the location of blobs in the text of `--blobs`. Returns `None` without a text.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Usage`] if the text is not a valid location.
pub fn blob_place(text: Option<&str>, allow_plaintext: bool) -> Result<Option<BlobPlace>, Error> {
    let Some(text) = text else { return Ok(None) };
    let mut place = text
        .parse()
        .map_err(|e: PlaceError| Error::usage(format!("--blobs: {e}")))?;
    if let BlobPlace::Bucket(bucket) = &mut place {
        bucket.allow_plaintext = allow_plaintext;
    }
    Ok(Some(place))
}

/// Reads the TLS files in the arguments.
fn encryption(args: &CoordinatorArgs) -> Result<Option<Arc<Tls>>, Error> {
    let (Some(certificate), Some(key)) = (&args.tls_cert, &args.tls_key) else {
        return Ok(None);
    };
    let (certificate, key) = (certificate.clone(), key.clone());
    let tls = Tls::open(TlsFiles {
        certificate,
        key,
        client_ca: args.client_ca.clone(),
    });
    tls.map(|tls| Some(Arc::new(tls)))
        .map_err(|e| Error::input(e.to_string()))
}

/// Reads the certificates again at each SIGHUP. If they cannot be used, the previous ones stay and the log
/// reports the reason.
fn reload_on_hangup(tls: Option<Arc<Tls>>) -> Result<(), Error> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut hangups = signal(SignalKind::hangup()).map_err(Error::internal)?;
        tokio::spawn(async move {
            while hangups.recv().await.is_some() {
                let Some(tls) = tls.clone() else {
                    // Without a handler, the signal would end the process.
                    tracing::info!("SIGHUP has no effect: this coordinator has no certificates");
                    continue;
                };
                match tokio::task::spawn_blocking(move || tls.reload()).await {
                    Ok(Ok(())) => tracing::info!("read the certificates again"),
                    Ok(Err(e)) => {
                        tracing::error!("{e}; the certificates that were read before stay in use")
                    }
                    Err(e) => tracing::error!("the certificates were not read again: {e}"),
                }
            }
        });
    }
    #[cfg(not(unix))]
    drop(tls);
    Ok(())
}
