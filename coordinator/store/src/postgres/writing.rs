//! The writer thread: the only thread of a coordinator that changes the entries.
//!
//! Concurrent commands share a transaction. The transaction begins by writing its number into the row of this
//! leadership in the table `fence` (the claim). If another coordinator has taken over, that row is closed,
//! the claim fails, and the transaction has no effect. A take-over in between waits for the claim's lock. So
//! the entries change under one leadership at a time, and by one thread. The values that a transaction has
//! read stay valid until it commits, and a transaction that did not commit can be repeated with the same
//! decisions.
//!
//! If the connection is lost while a transaction commits, the row shows whether the commit succeeded: it
//! contains the number of the last committed transaction.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use futures::executor::block_on;
use tokio_postgres::{SimpleQueryMessage, Statement};

use super::leadership::SharedRole;
use super::link::{AGAIN, Link, Server, is_conflict, is_refused};
use super::reading::{PATIENCE, Reading, in_database};
use crate::api::Report;
use crate::commands::Pending;
use crate::error::StoreError;
use crate::rules;
use crate::table::{Bytes, ChangedTable, Changes, View};

/// The number of changed entries after which a transaction accepts no more commands. An entry has at most 4
/// KiB.
const GROUP_KEYS: usize = 2048;

/// The state of the writer thread.
pub(super) struct Writer {
    pub(super) server: Server,
    pub(super) role: SharedRole,
    pub(super) epoch: i64,
    /// The number of the last committed transaction of this leadership.
    pub(super) written: i64,
    pub(super) link: Option<Link>,
    /// True while the store is being closed.
    pub(super) closing: Arc<AtomicBool>,
    /// The callback that receives the durations of transactions.
    pub(super) reports: Arc<OnceLock<Report>>,
}

impl Writer {
    /// Executes commands until all senders are dropped.
    pub(super) fn run(mut self, incoming: &Receiver<Box<dyn Pending>>) {
        while let Ok(first) = incoming.recv() {
            let mut group = vec![first];
            let begun = Instant::now();
            let outcome = self.carry_out(&mut group, incoming);
            if let Some(tell) = self.reports.get().filter(|_| outcome.is_ok()) {
                tell(begun.elapsed());
            }
            for command in group {
                command.answer(&outcome);
            }
        }
    }

    /// Executes the command in `group`, and commands that arrive in the meantime, as one transaction.
    fn carry_out(
        &mut self,
        group: &mut Vec<Box<dyn Pending>>,
        incoming: &Receiver<Box<dyn Pending>>,
    ) -> Result<(), StoreError> {
        let link = self.begin()?;
        let mut staged = Changes::new();
        let mut next = 0;
        while let Some(command) = group.get_mut(next) {
            if let Err(e) = self.stage(&link, command.as_mut(), &mut staged) {
                command.refuse(e);
            }
            next += 1;
            if staged.len() < GROUP_KEYS {
                group.extend(incoming.try_recv());
            }
        }
        if staged.is_empty() {
            self.end(link);
            return Ok(());
        }
        self.commit(link, &staged)
    }

    /// Adds the changes of one command to `staged`.
    fn stage(
        &self,
        link: &Link,
        command: &mut dyn Pending,
        staged: &mut Changes,
    ) -> Result<(), StoreError> {
        let table = Reading(&self.server, link);
        let changed = match command.decide(View(&ChangedTable {
            under: &table,
            changes: staged,
        })) {
            Some(event) => rules::stage(&event, &table, staged),
            None => Ok(()),
        };
        changed.map_err(|e| in_database(&self.server, e))
    }

    /// Begins a transaction under this leadership, and retries for a while: the transaction contains no
    /// decisions yet.
    fn begin(&mut self) -> Result<Link, StoreError> {
        let begun = Instant::now();
        let claim = format!(
            "BEGIN ISOLATION LEVEL SERIALIZABLE; \
             UPDATE fence SET written = {} WHERE epoch = {} AND NOT closed",
            self.written + 1,
            self.epoch
        );
        loop {
            if !self.role.leads(self.epoch) {
                return Err(StoreError::Fenced { epoch: self.epoch });
            }
            let link = match self.link.take().filter(|link| !link.client.is_closed()) {
                Some(link) => link,
                None => self.server.link_while(|| {
                    begun.elapsed() < PATIENCE
                        && self.role.leads(self.epoch)
                        && !self.closing.load(Ordering::Relaxed)
                })?,
            };
            match block_on(link.client.simple_query(&claim)) {
                Ok(answers) if claimed(&answers) => return Ok(link),
                Ok(_) => {
                    self.end(link);
                    self.role.deposed(self.epoch);
                }
                // Another coordinator is taking over; the next check of the role detects it.
                Err(e) if is_conflict(&e) && begun.elapsed() < PATIENCE => self.end(link),
                Err(e) if is_refused(&e) => {
                    self.end(link);
                    return Err(self.server.meaning(&e));
                }
                Err(_) if begun.elapsed() < PATIENCE => {}
                Err(e) => return Err(self.server.meaning(&e)),
            }
        }
    }

    /// Writes the changes and commits. `link` is in a transaction.
    fn commit(&mut self, mut link: Link, changes: &Changes) -> Result<(), StoreError> {
        let (mut keys, mut values, mut removed) = (Vec::new(), Vec::new(), Vec::new());
        for (key, value) in changes {
            match value {
                Some(value) => {
                    keys.push(key);
                    values.push(value);
                }
                None => removed.push(key),
            }
        }
        loop {
            let written = block_on(write(&link, &keys, &values, &removed));
            let committed = match written {
                Ok(()) => block_on(link.client.batch_execute("COMMIT")),
                // The commit was not sent.
                Err(e) if is_conflict(&e) => Err(e),
                Err(e) => {
                    self.end(link);
                    return Err(self.server.meaning(&e));
                }
            };
            match committed {
                Ok(()) => {
                    self.written += 1;
                    self.link = Some(link);
                    return Ok(());
                }
                Err(e) if is_conflict(&e) => self.end(link),
                Err(e) if is_refused(&e) => {
                    self.end(link);
                    return Err(self.server.meaning(&e));
                }
                Err(e) => {
                    drop(link);
                    tracing::warn!(
                        "the connection was lost during a commit: {}",
                        self.server.meaning(&e)
                    );
                    if self.was_committed()? {
                        self.written += 1;
                        return Ok(());
                    }
                }
            }
            link = self.begin()?;
        }
    }

    /// Returns true if the transaction after the last known one was committed.
    ///
    /// Repeats the query until the database answers. The row lock waits for a transaction that has not ended.
    fn was_committed(&self) -> Result<bool, StoreError> {
        let ask = format!(
            "SELECT written FROM fence WHERE epoch = {} FOR UPDATE",
            self.epoch
        );
        loop {
            let link = self
                .server
                .link_while(|| !self.closing.load(Ordering::Relaxed))?;
            match block_on(link.client.query_opt(&ask, &[])) {
                Ok(Some(row)) => {
                    let written: i64 = row.try_get(0).map_err(|e| self.server.meaning(&e))?;
                    return Ok(written > self.written);
                }
                Ok(None) => {
                    let what = format!("the table fence has no row for epoch {}", self.epoch);
                    return Err(StoreError::Damaged {
                        server: self.server.address.to_string(),
                        what,
                    });
                }
                Err(_) if self.closing.load(Ordering::Relaxed) => return Err(StoreError::Closed),
                Err(e) => {
                    tracing::warn!(
                        "the outcome of a commit is queried again: {}",
                        self.server.meaning(&e)
                    );
                    std::thread::sleep(AGAIN[0]);
                }
            }
        }
    }

    /// Rolls back a transaction, and keeps its connection if the rollback succeeds.
    fn end(&mut self, link: Link) {
        if block_on(link.client.batch_execute("ROLLBACK")).is_ok() {
            self.link = Some(link);
        }
    }
}

/// Returns true if the claim changed a row.
fn claimed(answers: &[SimpleQueryMessage]) -> bool {
    matches!(answers.last(), Some(SimpleQueryMessage::CommandComplete(1)))
}

async fn write(
    link: &Link,
    keys: &[&Bytes],
    values: &[&Bytes],
    removed: &[&Bytes],
) -> Result<(), tokio_postgres::Error> {
    let put = async |statement: &Statement| match keys {
        [] => Ok(0),
        _ => link.client.execute(statement, &[&keys, &values]).await,
    };
    let remove = async |statement: &Statement| match removed {
        [] => Ok(0),
        _ => link.client.execute(statement, &[&removed]).await,
    };
    // Both statements are sent before the first is answered.
    futures::try_join!(put(&link.put), remove(&link.remove)).map(|_| ())
}
