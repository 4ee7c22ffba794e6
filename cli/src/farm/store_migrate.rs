//! `sightline store migrate`: copies the records of a store to another, empty store, on disk or in a
//! database.

use std::path::Path;
use std::time::Duration;

use serde_json::json;
use sightline::Error;
use sightline::process::{default_name, runtime};
use sightline_store::{DatabaseAddress, Entry, Replica, Role, SledStore, Store};

use crate::args::store::MigrateArgs;
use crate::farm::store_location::StorePlace;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The maximum time until a database accepts a new leader after the previous leader disappeared, with a
/// margin.
const PATIENCE: Duration = Duration::from_secs(6);

/// The number of records that the target store imports at once.
const AT_ONCE: usize = 256;

/// Runs `sightline store migrate`.
pub fn migrate(args: &MigrateArgs, json: bool) -> Result<(), Error> {
    let from = Opened::at(&args.from, "FROM", args.store_ca.as_deref())?;
    let to = Opened::at(&args.to, "TO", args.store_ca.as_deref())?;
    let input = |e: &dyn std::fmt::Display| Error::input(e.to_string());
    let entries = from.store.entries().map_err(|e| input(&e))?;
    take_over(&*to.store, entries.clone())?;
    if to.store.entries().map_err(|e| input(&e))? != entries {
        return Err(Error::internal(
            "the records in TO differ from the records in FROM; do not use TO".to_owned(),
        ));
    }
    let count = entries.len();
    to.close();
    from.close();
    if json {
        return print(&json!({"records": count}).to_string());
    }
    say(
        "the command copies no blobs; give the coordinator of TO the same --blobs, or copy the blobs",
    );
    print(&format!("copied {count} records"))
}

/// A store that no other process uses.
pub struct Opened {
    /// The store.
    pub store: Box<dyn Store>,
    /// The replica that leads on a database, with its runtime.
    replica: Option<(Replica, tokio::runtime::Runtime)>,
}

impl Opened {
    /// Opens the store at an address. `what` is the name of the argument that contains the address, for
    /// errors.
    ///
    /// # Errors
    /// [`Error`] if the address is invalid, the store cannot be opened, or another process uses the store.
    pub fn at(text: &str, what: &str, ca: Option<&Path>) -> Result<Self, Error> {
        match StorePlace::parse(text, ca)? {
            StorePlace::Sled(directory) => Self::on_disk(&directory),
            StorePlace::Database(address) => Self::in_database(&address, what),
            StorePlace::Default | StorePlace::Memory => Err(Error::usage(format!(
                "{what} must be sled:DIR, such as sled:sightline-data/state, or \
                 postgres://USER@HOST/DATABASE"
            ))),
        }
    }

    /// Opens the store in a directory.
    ///
    /// # Errors
    /// [`Error`] if the store cannot be opened, or another process uses it.
    pub fn on_disk(directory: &Path) -> Result<Self, Error> {
        let store = SledStore::open(directory).map_err(|e| Error::input(e.to_string()))?;
        Ok(Self {
            store: Box::new(store),
            replica: None,
        })
    }

    /// Opens the store in a database. Leads until the store is closed, so that no coordinator changes it.
    fn in_database(address: &DatabaseAddress, what: &str) -> Result<Self, Error> {
        let input = |e: &dyn std::fmt::Display| Error::input(e.to_string());
        // The address is a placeholder, because no client should call this process.
        let replica = Replica::join(address, &default_name()?, "http://127.0.0.1:1")
            .map_err(|e| input(&e))?;
        let runtime = runtime()?;
        let mut role = replica.role();
        let leads = runtime.block_on(async {
            let decided = role.wait_for(|role| matches!(role, Role::Leads(_) | Role::Ended(_)));
            tokio::time::timeout(PATIENCE, decided)
                .await
                .map(|role| role.map(|role| role.clone()))
        });
        let store = match leads {
            Ok(Ok(Role::Leads(epoch))) => replica.store(epoch).map_err(|e| input(&e))?,
            Ok(Ok(Role::Ended(why))) => return Err(input(&why)),
            _ => {
                return Err(Error::input(format!(
                    "a coordinator uses the database of {what}; stop all coordinators of this database, \
                     and try again"
                )));
            }
        };
        Ok(Self {
            store: Box::new(store),
            replica: Some((replica, runtime)),
        })
    }

    /// Closes the store, so that another coordinator can lead immediately.
    pub fn close(self) {
        drop(self.store);
        if let Some((replica, runtime)) = self.replica {
            runtime.block_on(replica.resign());
        }
    }
}

/// Imports the entries of another store into `store`, which must be empty, in batches.
pub fn take_over(store: &dyn Store, entries: Vec<Entry>) -> Result<(), Error> {
    let mut entries = entries.into_iter();
    let mut first = true;
    loop {
        let some: Vec<Entry> = entries.by_ref().take(AT_ONCE).collect();
        if some.is_empty() {
            return Ok(());
        }
        store
            .import(some, first)
            .map_err(|e| Error::input(e.to_string()))?;
        first = false;
    }
}
