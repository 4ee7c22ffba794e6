//! `sightline coordinator --store postgres://…`: runs one of several coordinators on a database. The
//! coordinator leads, or forwards calls to the leader.

use std::path::Path;
use std::sync::Arc;

use sightline::Error;
use sightline::process::default_name;
use sightline_coordinator::{Config, Coordinator, Front, Listener, Tls};
use sightline_proto::connection::Credentials;
use sightline_store::{DatabaseAddress, OwnDirectory, Replica};

use crate::args::serve::CoordinatorArgs;
use crate::terminal::interrupt::stop_signal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The listeners of a coordinator.
pub struct Listening {
    /// The listener for gRPC.
    pub calls: Listener,
    /// The address of the gRPC listener, as clients write it.
    pub url: String,
    /// The listener for pages, and its address.
    pub pages: Option<(Listener, String)>,
    /// The listener for metrics, and its address.
    pub metrics: Option<(Listener, String)>,
}

impl Listening {
    /// Prints the addresses of all listeners, so that a script that chose port 0 can read the ports.
    ///
    /// # Errors
    /// [`Error`] if standard output cannot be written.
    pub fn announce(&self) -> Result<(), Error> {
        print(&format!("listening on {}", self.url))?;
        if let Some((_, url)) = &self.pages {
            print(&format!("dashboard on {url}"))?;
        }
        self.metrics
            .as_ref()
            .map_or(Ok(()), |(_, url)| print(&format!("metrics on {url}")))
    }
}

/// Runs a coordinator as standby and then as leader, until SIGTERM or until another coordinator takes over
/// the leadership. `equip` prepares a coordinator that becomes the leader.
pub async fn serve(
    args: &CoordinatorArgs,
    database: DatabaseAddress,
    config: Config,
    tls: Option<Arc<Tls>>,
    listening: Listening,
    equip: impl FnOnce(&Coordinator) + Send + 'static,
) -> Result<(), Error> {
    let input = |e: &dyn std::fmt::Display| Error::input(e.to_string());
    let address = match &args.store.advertise {
        Some(url) => url.clone(),
        None if args.listen.ip().is_unspecified() => {
            return Err(Error::usage(format!(
                "other coordinators cannot call {}; give an address that they can reach with \
                 --advertise",
                listening.url
            )));
        }
        None => listening.url.clone(),
    };
    let credentials = peers(args, &address)?;
    let _own = OwnDirectory::take(&args.data_dir).map_err(|e| input(&e))?;
    let name = own_name(&args.data_dir)?;
    let holder = default_name()?;
    say(&format!("the store is {database}"));
    let joined =
        tokio::task::spawn_blocking(move || Replica::join(&database, &holder, &address)).await;
    let replica = joined.map_err(Error::internal)?.map_err(|e| input(&e))?;
    listening.announce()?;
    let front = Front::new(
        credentials,
        tls.as_ref().is_some_and(|tls| tls.checks_workers()),
    );
    let leads = front.follow(&replica, move |store| {
        let blobs = config.open_blobs(Some(&name))?;
        let coordinator = Coordinator::open_on(config, Box::new(store), blobs)?;
        equip(&coordinator);
        Ok(coordinator)
    });
    let Listening {
        calls,
        pages,
        metrics,
        ..
    } = listening;
    let shown = async {
        match pages {
            Some((pages, _)) => front.serve_http(pages, tls.clone()).await,
            None => std::future::pending().await,
        }
    };
    let counted = async {
        match metrics {
            Some((listener, _)) => {
                sightline_coordinator::serve_probes(Arc::new(front.clone()), listener).await
            }
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        ended = leads => ended.map_err(Error::internal)?,
        never = front.serve(calls, tls.clone()) => match never {},
        ended = shown => match ended.map_err(Error::internal)? {},
        never = counted => match never {},
        () = stop_signal() => replica.resign().await,
    }
    front.close();
    Ok(())
}

/// Returns the credentials for calls to other coordinators.
fn peers(args: &CoordinatorArgs, own: &str) -> Result<Credentials, Error> {
    let ca = match &args.store.peer_ca {
        None => None,
        Some(path) => Some(std::fs::read(path).map_err(|e| Error::reading(path, &e))?),
    };
    let credentials = Credentials {
        ca,
        ..Credentials::default()
    };
    // Other coordinators would call this address in the same way, so the check covers the given options.
    credentials.endpoint(own).map_err(|e| {
        Error::usage(format!(
            "other coordinators cannot call {own}: {e}; see --advertise and --peer-ca"
        ))
    })?;
    Ok(credentials)
}

/// Returns the name under which this coordinator writes to a shared directory. The name is the same at each
/// start.
fn own_name(data_dir: &Path) -> Result<String, Error> {
    let path = data_dir.join("replica");
    let unreadable = |e: std::io::Error| {
        Error::input(format!(
            "the file {} with the replica name cannot be read or \
         written: {e}",
            path.display()
        ))
    };
    match std::fs::read_to_string(&path) {
        Ok(text) if text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit()) => Ok(text),
        Ok(_) => Err(Error::input(format!(
            "{} contains no replica name; delete the file to generate one",
            path.display()
        ))),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            let name = format!("{:016x}", getrandom::u64().map_err(Error::internal)?);
            sightline_files::write(&path, &name).map_err(unreadable)?;
            Ok(name)
        }
        Err(e) => Err(unreadable(e)),
    }
}
