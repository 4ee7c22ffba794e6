//! The coordinator of this process: its data directory, and its service on loopback.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_coordinator::{
    Config, ConnectionLimits, Connections, Coordinator, Listener, OpenError,
};
use sightline_proto::connection::Connection;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_store::StoreError;
use tokio::task::AbortHandle;

use crate::client::Endpoint;
use crate::error::Error;
use crate::observer::{Observer, note};

/// Maximum number of simultaneous bakes of one user that receive a separate data directory.
const MOST_AT_ONCE: u32 = 16;
/// Maximum time that [`close`] waits for the coordinator's background work.
const TO_CLOSE: Duration = Duration::from_secs(2);

/// Opens the coordinator of the given data directory, or of the default one. Returns the coordinator and its
/// directory.
pub(super) fn open_at(
    data_dir: Option<&Path>,
    observer: &dyn Observer,
) -> Result<(Arc<Coordinator>, PathBuf), Error> {
    match data_dir {
        Some(dir) => Ok((open(dir)?, dir.to_owned())),
        None => open_free(&default_data_dir()?, observer),
    }
}

/// Opens a data directory.
fn open(data_dir: &Path) -> Result<Arc<Coordinator>, Error> {
    Coordinator::open(Config::new(data_dir.to_owned())).map_err(|e| match e {
        OpenError::Store(StoreError::InUse { pid, .. }) => Error::input(format!(
            "{} is in use by process {pid}, probably another bake; wait for that process, or give this \
             bake another --data-dir",
            data_dir.display()
        ))
        .about("data-dir"),
        OpenError::Store(e) => Error::input(format!("{e}; --data-dir selects another directory")),
        OpenError::Blobs(e) => Error::input(e.to_string()),
    })
}

/// Opens the default data directory `usual`, or a numbered directory next to it if other processes use it.
/// Bakes in different directories do not share results.
fn open_free(usual: &Path, observer: &dyn Observer) -> Result<(Arc<Coordinator>, PathBuf), Error> {
    for number in 1..=MOST_AT_ONCE {
        let dir = match number {
            1 => usual.to_owned(),
            number => usual.with_extension(number.to_string()),
        };
        match Coordinator::open(Config::new(dir.clone())) {
            Err(OpenError::Store(StoreError::InUse { pid, .. })) => note(
                observer,
                format!(
                    "note: {} is in use by process {pid}; this bake uses another data directory",
                    dir.display()
                ),
            ),
            Ok(coordinator) => return Ok((coordinator, dir)),
            Err(_) => return open(&dir).map(|coordinator| (coordinator, dir)),
        }
    }
    open(usual).map(|coordinator| (coordinator, usual.to_owned()))
}

/// Closes the coordinator's store, so that this process can open it again. If other threads still use the
/// coordinator after the time limit, the store stays open.
pub(super) fn close(mut coordinator: Arc<Coordinator>) {
    let begin = Instant::now();
    while begin.elapsed() < TO_CLOSE {
        match Arc::try_unwrap(coordinator) {
            Ok(last) => return drop(last),
            Err(again) => coordinator = again,
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Serves a coordinator on a free port of loopback. Returns the address of the service, the handle that ends
/// the service, and a client.
pub(super) async fn serve(
    coordinator: &Arc<Coordinator>,
) -> Result<(String, AbortHandle, JobsClient<Connection>), Error> {
    let connections = Connections::new(ConnectionLimits::of_process().map_err(Error::internal)?);
    let listener = Listener::bind(([127, 0, 0, 1], 0).into(), false, &connections);
    let listener = listener.await.map_err(Error::internal)?;
    let url = format!("http://{}", listener.local_addr().map_err(Error::internal)?);
    let coordinator = Arc::clone(coordinator);
    let server = tokio::spawn(sightline_coordinator::serve(
        coordinator,
        listener,
        None,
        std::future::pending(),
    ));
    let client = JobsClient::new(Endpoint::new(url.clone()).connect().await?);
    Ok((url, server.abort_handle(), client))
}

/// Returns the text for an interrupted job, whose tiles are in a data directory.
pub(super) fn interrupted(data_dir: &Path) -> String {
    format!(
        "interrupted; finished tiles and finished phases of the others are stored in {}: the same command \
         continues from there",
        data_dir.display()
    )
}

fn default_data_dir() -> Result<PathBuf, Error> {
    let from = |name: &str| {
        std::env::var_os(name)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    };
    from("XDG_CACHE_HOME")
        .or_else(|| from("HOME").map(|h| h.join(".cache")))
        .map(|d| d.join("sightline"))
        .ok_or_else(|| {
            Error::usage("neither XDG_CACHE_HOME nor HOME is set; give a directory with --data-dir")
                .about("data-dir")
        })
}
