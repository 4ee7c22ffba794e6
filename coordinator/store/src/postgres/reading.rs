//! Reading the entries in the database: a table in a transaction, and the connections for queries.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use futures::executor::block_on;
use tokio_postgres::Row;

use super::link::{Link, Server};
use crate::error::StoreError;
use crate::table::{Bytes, Table, View};

/// The time for which a query or a command waits for a database that does not answer.
pub(super) const PATIENCE: Duration = Duration::from_secs(3);
/// Maximum number of connections for queries. Further queries wait.
const MOST: usize = 6;

/// The entries as a transaction sees them.
pub(super) struct Reading<'a>(pub(super) &'a Server, pub(super) &'a Link);

impl Table for Reading<'_> {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        let Self(server, link) = self;
        let row =
            block_on(link.client.query_opt(&link.get, &[&key])).map_err(|e| server.meaning(&e))?;
        row.map(|row| row.try_get(0))
            .transpose()
            .map_err(|e| server.meaning(&e))
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        let Self(server, link) = self;
        let rows = match behind(prefix) {
            None => block_on(link.client.query(&link.from, &[&prefix])),
            Some(end) => block_on(link.client.query(&link.between, &[&prefix, &end])),
        };
        let entry = |row: Row| Ok((row.try_get(0)?, row.try_get(1)?));
        let entries: Result<Vec<_>, _> = rows
            .map_err(|e| server.meaning(&e))?
            .into_iter()
            .map(entry)
            .collect();
        entries.map_err(|e| server.meaning(&e))
    }
}

/// Returns the first key after all keys that begin with `prefix`. Returns `None` if every later key has the
/// prefix.
fn behind(prefix: &[u8]) -> Option<Bytes> {
    let last = prefix.iter().rposition(|byte| *byte < 0xff)?;
    let mut end = prefix[..=last].to_vec();
    end[last] += 1;
    Some(end)
}

/// Converts an error about unreadable entries into [`StoreError::Damaged`]. Other errors stay unchanged.
pub(super) fn in_database(server: &Server, e: StoreError) -> StoreError {
    match e {
        StoreError::View { what } => StoreError::Damaged {
            server: server.address.to_string(),
            what,
        },
        other => other,
    }
}

/// The connections for queries.
pub(super) struct Readers {
    server: Server,
    links: Mutex<Links>,
    freed: Condvar,
}

#[derive(Default)]
struct Links {
    idle: Vec<Link>,
    lent: usize,
}

impl Readers {
    pub(super) fn new(server: Server) -> Self {
        Self {
            server,
            links: Mutex::default(),
            freed: Condvar::new(),
        }
    }

    /// Answers a query from one state of the table.
    pub(super) fn query<A>(
        &self,
        ask: impl FnOnce(View<'_>) -> Result<A, StoreError>,
    ) -> Result<A, StoreError> {
        let mut turn = self.turn();
        let link = self.begin(turn.link.take())?;
        let answer = ask(View(&Reading(&self.server, &link)));
        // A connection that was lost, or whose transaction failed, is not used again.
        if block_on(link.client.batch_execute("COMMIT")).is_ok() {
            turn.link = Some(link);
        }
        answer.map_err(|e| in_database(&self.server, e))
    }

    /// Returns a connection in a read-only transaction.
    fn begin(&self, mut kept: Option<Link>) -> Result<Link, StoreError> {
        let begun = Instant::now();
        loop {
            let link = match kept.take().filter(|link| !link.client.is_closed()) {
                Some(link) => link,
                None => self.server.link_within(PATIENCE)?,
            };
            let begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
            match block_on(link.client.batch_execute(begin)).map_err(|e| self.server.meaning(&e)) {
                Ok(()) => return Ok(link),
                Err(StoreError::Unreachable { .. }) if begun.elapsed() < PATIENCE => {}
                Err(e) => return Err(e),
            }
        }
    }

    fn turn(&self) -> ConnectionPermit<'_> {
        let mut links = self.links();
        while links.lent >= MOST {
            links = self
                .freed
                .wait(links)
                .unwrap_or_else(PoisonError::into_inner);
        }
        links.lent += 1;
        ConnectionPermit {
            readers: self,
            link: links.idle.pop(),
        }
    }

    fn links(&self) -> MutexGuard<'_, Links> {
        self.links.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The right to use one of the connections. Its drop returns the connection.
struct ConnectionPermit<'a> {
    readers: &'a Readers,
    link: Option<Link>,
}

impl Drop for ConnectionPermit<'_> {
    fn drop(&mut self) {
        let mut links = self.readers.links();
        links.lent -= 1;
        links.idle.extend(self.link.take());
        self.readers.freed.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::behind;

    #[test]
    fn prefix_end_follows_all_keys() {
        assert_eq!(behind(b"t\x00\xff"), Some(b"t\x01".to_vec()));
        assert_eq!(behind(b"s"), Some(b"t".to_vec()));
        assert_eq!(behind(b"\xff\xff"), None);
        assert_eq!(behind(b""), None);
    }
}
