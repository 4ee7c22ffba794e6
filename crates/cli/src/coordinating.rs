//! `sightline coordinator`.

use std::sync::Arc;

use sightline_coordinator::access::Access;
use sightline_coordinator::store::{BlobPlace, PlaceError};
use sightline_coordinator::{Config, Coordinator, Tls, TlsFiles};

use crate::answers::Commands;
use crate::error::CliError;
use crate::progress::say;
use crate::serve::{print, runtime, stop_signal};
use crate::serve_args::CoordinatorArgs;

/// Serves as coordinator until SIGTERM or Ctrl-C.
pub fn coordinator(args: &CoordinatorArgs) -> Result<(), CliError> {
    let tls = encryption(args)?;
    let certified = tls.as_ref().is_some_and(|tls| tls.checks_workers());
    let access = (args.tokens.is_some() || certified).then(|| Access::new(args.tokens.clone(), certified));
    let access = access.transpose().map_err(|e| CliError::Input(e.to_string()))?.map(Arc::new);
    let config = Config { blobs: blobs(args)?, ..Config::new(args.data_dir.clone()) };
    let coordinator = Coordinator::open(config).map_err(|e| CliError::Input(e.to_string()))?;
    coordinator.answer_with(Box::new(Commands));
    if let Some(access) = access {
        coordinator.ask_callers(access);
    }
    runtime()?.block_on(async {
        if let Some(tls) = &tls {
            reload_on_hangup(Arc::clone(tls))?;
        }
        let protected = args.allow_plaintext || tls.is_some();
        let scheme = if tls.is_some() { "https" } else { "http" };
        let listener = sightline_coordinator::listen(args.listen, protected)
            .await
            .map_err(|e| CliError::Usage(e.to_string()))?;
        let address = listener.local_addr().map_err(CliError::internal)?;
        // On stdout, so that a script that gave port 0 can read the address.
        print(&format!("listening on {scheme}://{address}"))?;
        let pages_beyond = args.http.is_some_and(|address| !address.ip().is_loopback());
        if args.tokens.is_some() && tls.is_none() && (!address.ip().is_loopback() || pages_beyond) {
            say("tokens go over the network unencrypted; --tls-cert and --tls-key encrypt them");
        }
        if (!address.ip().is_loopback() || pages_beyond) && args.tokens.is_none() {
            say("whoever reaches this address may read, submit and cancel everything; --tokens asks who \
                 they are");
        }
        let pages = match args.http {
            None => None,
            Some(address) => {
                let pages = sightline_coordinator::listen(address, protected).await;
                let pages = pages.map_err(|e| CliError::Usage(format!("--http: {e}")))?;
                let address = pages.local_addr().map_err(CliError::internal)?;
                print(&format!("dashboard on {scheme}://{address}/"))?;
                Some(pages)
            }
        };
        let c = Arc::clone(&coordinator);
        let served = sightline_coordinator::serve(c, listener, tls.clone(), stop_signal());
        let Some(pages) = pages else { return served.await.map_err(CliError::internal) };
        let shown = sightline_coordinator::serve_http(coordinator, pages, tls, std::future::pending());
        tokio::select! {
            ended = served => ended,
            ended = shown => ended,
        }
        .map_err(CliError::internal)
    })
}

/// Where the arguments say that the blobs are.
fn blobs(args: &CoordinatorArgs) -> Result<Option<BlobPlace>, CliError> {
    let Some(text) = &args.blobs else { return Ok(None) };
    let mut place = text.parse().map_err(|e: PlaceError| CliError::Usage(format!("--blobs: {e}")))?;
    if let BlobPlace::Bucket(bucket) = &mut place {
        bucket.allow_plaintext = args.allow_plaintext;
    }
    Ok(Some(place))
}

/// The encryption that the arguments ask for.
fn encryption(args: &CoordinatorArgs) -> Result<Option<Arc<Tls>>, CliError> {
    let (Some(certificate), Some(key)) = (&args.tls_cert, &args.tls_key) else { return Ok(None) };
    let (certificate, key) = (certificate.clone(), key.clone());
    let tls = Tls::open(TlsFiles { certificate, key, client_ca: args.client_ca.clone() });
    tls.map(|tls| Some(Arc::new(tls))).map_err(|e| CliError::Input(e.to_string()))
}

/// Reads the certificates again at each SIGHUP from now on. Ones that cannot be used change nothing, and
/// the log says so.
fn reload_on_hangup(tls: Arc<Tls>) -> Result<(), CliError> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut hangups = signal(SignalKind::hangup()).map_err(CliError::internal)?;
        tokio::spawn(async move {
            while hangups.recv().await.is_some() {
                let tls = Arc::clone(&tls);
                match tokio::task::spawn_blocking(move || tls.reload()).await {
                    Ok(Ok(())) => tracing::info!("read the certificates again"),
                    Ok(Err(e)) => tracing::error!("{e}; the certificates that were read before stay in use"),
                    Err(e) => tracing::error!("the certificates were not read again: {e}"),
                }
            }
        });
    }
    #[cfg(not(unix))]
    drop(tls);
    Ok(())
}
