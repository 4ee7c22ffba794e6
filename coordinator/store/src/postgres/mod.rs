//! The store in a PostgreSQL database, which several coordinators share: one of them leads, the others stand
//! by.
//!
//! The table has the same keys and values as the table of the other stores. Queries and commands of the
//! leader are transactions (`reading.rs`, `writing.rs`). The database decides which coordinator leads
//! (`election.rs`).

mod address;
#[cfg(test)]
mod cut_tests;
mod election;
mod leadership;
mod link;
mod reading;
mod tables;
#[cfg(test)]
mod tests;
mod writing;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use futures::executor::block_on;
use tokio::runtime::Runtime;
use tokio::sync::{Notify, watch};

pub use self::address::DatabaseAddress;
use self::election::Candidate;
use self::leadership::SharedRole;
pub use self::leadership::{Leader, Role};
use self::link::Server;
use self::reading::{Readers, in_database};
use self::writing::Writer;
use super::api::Report;
use super::commands::{Pending, pending};
use super::engine::Engine;
use super::error::StoreError;
use super::rules::Decision;
use super::table::View;

/// A coordinator among the coordinators on a database.
pub struct Replica {
    server: Server,
    role: SharedRole,
    resigns: Arc<Notify>,
    candidacy: Mutex<Option<tokio::task::JoinHandle<()>>>,
    runtime: Arc<Connections>,
}

/// The runtime of the connections.
struct Connections(Option<Runtime>);

impl Drop for Connections {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            // The drop may happen on a thread of another runtime, which must not block.
            runtime.shutdown_background();
        }
    }
}

impl Replica {
    /// Connects to the database, brings its tables up to date, and stands by to lead. Blocks.
    ///
    /// `holder` is the name of the coordinator, and `address` is the address at which it is called.
    ///
    /// # Errors
    /// An error if the database does not answer, rejects the login, or contains the tables of a newer
    /// program.
    pub fn join(
        database: &DatabaseAddress,
        holder: &str,
        address: &str,
    ) -> Result<Self, StoreError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("store-postgres")
            .enable_all()
            .build()
            .map_err(|e| StoreError::Unreachable {
                server: database.to_string(),
                what: e.to_string(),
            })?;
        let server = Server {
            address: database.clone(),
            runtime: runtime.handle().clone(),
        };
        let (tables, handle) = (server.clone(), runtime.handle().clone());
        let runtime = Arc::new(Connections(Some(runtime)));
        block_on(handle.spawn(async move { tables::migrate(&tables).await }))
            .unwrap_or(Err(StoreError::Closed))?;
        let (role, resigns) = (SharedRole::new(), Arc::new(Notify::new()));
        let candidate = Candidate {
            server: server.clone(),
            role: role.clone(),
            holder: holder.to_owned(),
            address: address.to_owned(),
            resigns: Arc::clone(&resigns),
        };
        let candidacy = Mutex::new(Some(handle.spawn(candidate.run())));
        Ok(Self {
            server,
            role,
            resigns,
            candidacy,
            runtime,
        })
    }

    /// Returns a receiver of the coordinator's role.
    pub fn role(&self) -> watch::Receiver<Role> {
        self.role.follow()
    }

    /// Returns the store, which is usable while this coordinator leads under `epoch`. Blocks.
    ///
    /// # Errors
    /// An error if the database does not answer, or if another coordinator leads.
    pub fn store(&self, epoch: i64) -> Result<PostgresStore, StoreError> {
        let (commands, incoming) = channel();
        let closing = Arc::new(AtomicBool::new(false));
        let reports = Arc::<OnceLock<Report>>::default();
        let writer = Writer {
            server: self.server.clone(),
            role: self.role.clone(),
            epoch,
            written: 0,
            link: None,
            closing: Arc::clone(&closing),
            reports: Arc::clone(&reports),
        };
        let writer = std::thread::Builder::new()
            .name("store-writer".to_owned())
            .spawn(move || writer.run(&incoming))
            .map_err(|e| StoreError::Unreachable {
                server: self.server.address.to_string(),
                what: format!("the system cannot start a thread for the connection: {e}"),
            })?;
        Ok(PostgresStore {
            server: self.server.clone(),
            readers: Readers::new(self.server.clone()),
            commands: Mutex::new(Some(commands)),
            closing,
            reports,
            writer: Some(writer),
            _runtime: Arc::clone(&self.runtime),
        })
    }

    /// Stops standing by or leading, so that another coordinator leads at once.
    ///
    /// Changes that are being committed are committed or rejected. Waits for at most one second.
    pub async fn resign(&self) {
        self.resigns.notify_one();
        let candidacy = self
            .candidacy
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(candidacy) = candidacy {
            // A candidacy that does not answer in time ends when its leadership expires.
            drop(tokio::time::timeout(Duration::from_secs(1), candidacy).await);
        }
    }
}

/// The store of a coordinator that leads.
pub struct PostgresStore {
    server: Server,
    readers: Readers,
    /// The queue of the writer thread; `None` only during the drop.
    commands: Mutex<Option<Sender<Box<dyn Pending>>>>,
    closing: Arc<AtomicBool>,
    /// The callback that receives the durations of transactions.
    reports: Arc<OnceLock<Report>>,
    writer: Option<JoinHandle<()>>,
    /// The runtime of the connections, which ends after its last user is dropped.
    _runtime: Arc<Connections>,
}

impl Drop for PostgresStore {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Relaxed);
        self.commands
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if self
            .writer
            .take()
            .is_some_and(|writer| writer.join().is_err())
        {
            tracing::error!(
                "the store's writer thread had panicked; no acknowledged change is lost"
            );
        }
    }
}

impl Engine for PostgresStore {
    fn report_syncs(&self, to: Report) {
        drop(self.reports.set(to));
    }

    fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError> {
        self.readers.query(ask)
    }

    fn command<A: Send + 'static>(
        &self,
        decide: impl FnOnce(View<'_>) -> Result<Decision<A>, StoreError> + Send + 'static,
    ) -> Result<A, StoreError> {
        let (command, answer) = pending(decide);
        let commands = self
            .commands
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        commands
            .ok_or(StoreError::Closed)?
            .send(command)
            .map_err(|_| StoreError::Closed)?;
        let answer = answer.recv().map_err(|_| StoreError::Closed)?;
        answer.map_err(|e| in_database(&self.server, e))
    }
}
