//! `sightline store migrate`: the records of one store go into another, empty one, on disk or in a database.

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

/// How long a database may have a leader that is gone, and a little more.
const PATIENCE: Duration = Duration::from_secs(6);

/// Records that a store takes over at once.
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
            "what is in TO now is not what is in FROM; do not use it".to_owned(),
        ));
    }
    let count = entries.len();
    to.close();
    from.close();
    if json {
        return print(&json!({"records": count}).to_string());
    }
    say("blobs stay where they are; give the coordinator the same --blobs, or copy them");
    print(&format!("{count} records"))
}

/// A store that nobody else uses.
pub struct Opened {
    /// The store.
    pub store: Box<dyn Store>,
    /// The place among the coordinators of a database.
    replica: Option<(Replica, tokio::runtime::Runtime)>,
}

impl Opened {
    /// Opens the store at an address, which is the argument `what`.
    ///
    /// # Errors
    /// When the address is none, the store cannot be opened, or somebody uses it.
    pub fn at(text: &str, what: &str, ca: Option<&Path>) -> Result<Self, Error> {
        match StorePlace::parse(text, ca)? {
            StorePlace::Sled(directory) => Self::on_disk(&directory),
            StorePlace::Database(address) => Self::in_database(&address, what),
            StorePlace::Default | StorePlace::Memory => Err(Error::usage(format!(
                "{what} is sled:DIR, such as sled:sightline-data/state, or postgres://USER@HOST/DATABASE"
            ))),
        }
    }

    /// Opens the store in a directory.
    ///
    /// # Errors
    /// When it cannot be opened, or somebody uses it.
    pub fn on_disk(directory: &Path) -> Result<Self, Error> {
        let store = SledStore::open(directory).map_err(|e| Error::input(e.to_string()))?;
        Ok(Self {
            store: Box::new(store),
            replica: None,
        })
    }

    /// Leads for as long as it takes, so that no coordinator changes anything.
    fn in_database(address: &DatabaseAddress, what: &str) -> Result<Self, Error> {
        let input = |e: &dyn std::fmt::Display| Error::input(e.to_string());
        // Nobody is to call it.
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
                    "a coordinator uses the database of {what}; stop all that do, and try again"
                )));
            }
        };
        Ok(Self {
            store: Box::new(store),
            replica: Some((replica, runtime)),
        })
    }

    /// Lets others lead at once.
    pub fn close(self) {
        drop(self.store);
        if let Some((replica, runtime)) = self.replica {
            runtime.block_on(replica.resign());
        }
    }
}

/// Gives a store the entries of another one.
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
