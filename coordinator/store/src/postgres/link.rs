//! Connections to a database: settings, prepared statements, the meaning of errors, and reconnection.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use futures::executor::block_on;
use tokio::runtime::Handle;
use tokio::sync::Notify;
use tokio_postgres::error::SqlState;
use tokio_postgres::tls::MakeTlsConnect;
use tokio_postgres::{AsyncMessage, Client, Connection, NoTls, Socket, Statement};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::address::DatabaseAddress;
use crate::error::StoreError;

/// The settings of every session. The server ends a session that is idle in a transaction, so that its locks
/// do not block other sessions.
const SETTINGS: &str = "SET search_path = sightline; SET client_min_messages = warning; \
    SET idle_in_transaction_session_timeout = '2s'; SET statement_timeout = '60s'; SET lock_timeout = '3s'; \
    SET synchronous_commit = on; SET tcp_keepalives_idle = 2; SET tcp_keepalives_interval = 1; \
    SET tcp_keepalives_count = 2; SET tcp_user_timeout = '4s'; SET client_connection_check_interval = '1s'";
/// The minimum and the maximum wait between attempts to connect. The wait doubles after each attempt.
pub(super) const AGAIN: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];

/// A database, and the runtime of its connections.
#[derive(Clone)]
pub(super) struct Server {
    pub(super) address: DatabaseAddress,
    pub(super) runtime: Handle,
}

/// A connection with the prepared statements on the table of entries.
pub(super) struct Link {
    pub(super) client: Client,
    pub(super) get: Statement,
    pub(super) from: Statement,
    pub(super) between: Statement,
    pub(super) put: Statement,
    pub(super) remove: Statement,
}

impl Server {
    /// Connects to the database. `notified` is signalled on every notification and when the connection ends.
    pub(super) async fn connect(
        &self,
        notified: Option<Arc<Notify>>,
    ) -> Result<Client, StoreError> {
        let config = self.address.config();
        let client = match self.address.tls() {
            None => self.drive::<NoTls>(config.connect(NoTls).await, notified)?,
            Some(tls) => self.drive::<MakeRustlsConnect>(config.connect(tls).await, notified)?,
        };
        client
            .batch_execute(SETTINGS)
            .await
            .map_err(|e| self.meaning(&e))?;
        Ok(client)
    }

    /// Connects and prepares the statements. Call this on a thread that may block.
    pub(super) fn link(&self) -> Result<Link, StoreError> {
        let server = self.clone();
        let made = self.runtime.spawn(async move {
            let client = server.connect(None).await?;
            let prepared = async {
                Ok(Link {
                    get: client.prepare("SELECT value FROM entries WHERE key = $1").await?,
                    from: client
                        .prepare("SELECT key, value FROM entries WHERE key >= $1 ORDER BY key")
                        .await?,
                    between: client
                        .prepare("SELECT key, value FROM entries WHERE key >= $1 AND key < $2 ORDER BY key")
                        .await?,
                    put: client
                        .prepare(
                            "INSERT INTO entries SELECT * FROM unnest($1::bytea[], $2::bytea[]) \
                             ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                        )
                        .await?,
                    remove: client.prepare("DELETE FROM entries WHERE key = ANY($1::bytea[])").await?,
                    client,
                })
            };
            prepared.await.map_err(|e| server.meaning(&e))
        });
        block_on(made).unwrap_or(Err(StoreError::Closed))
    }

    /// Connects repeatedly while the database does not answer and `goes_on` returns true.
    pub(super) fn link_while(&self, goes_on: impl Fn() -> bool) -> Result<Link, StoreError> {
        let [mut wait, longest] = AGAIN;
        loop {
            match self.link() {
                Err(StoreError::Unreachable { .. }) if goes_on() => {
                    std::thread::sleep(wait);
                    wait = longest.min(wait * 2);
                }
                other => return other,
            }
        }
    }

    /// Connects repeatedly for at most the duration `patience`.
    pub(super) fn link_within(&self, patience: Duration) -> Result<Link, StoreError> {
        let begun = Instant::now();
        self.link_while(|| begun.elapsed() < patience)
    }

    /// Runs a connection on the runtime until it is lost or its client is dropped.
    fn drive<T>(
        &self,
        made: Result<(Client, Connection<Socket, T::Stream>), tokio_postgres::Error>,
        notified: Option<Arc<Notify>>,
    ) -> Result<Client, StoreError>
    where
        T: MakeTlsConnect<Socket>,
        T::Stream: Send + 'static,
    {
        let (client, mut connection) = made.map_err(|e| self.meaning(&e))?;
        self.runtime.spawn(async move {
            let mut messages = futures::stream::poll_fn(|context| connection.poll_message(context));
            while let Some(message) = messages.next().await {
                match message {
                    Ok(AsyncMessage::Notification(_)) => {
                        if let Some(notified) = &notified {
                            notified.notify_one();
                        }
                    }
                    Ok(AsyncMessage::Notice(notice)) => {
                        tracing::info!("notice of the database: {notice}")
                    }
                    Ok(_) => {}
                    // The user of the client gets an error, too.
                    Err(e) => {
                        tracing::debug!("a connection with the database was lost: {}", cause(&e));
                        break;
                    }
                }
            }
            if let Some(notified) = &notified {
                notified.notify_one();
            }
        });
        Ok(client)
    }

    /// Converts an error of the database client into an error of the store.
    pub(super) fn meaning(&self, e: &tokio_postgres::Error) -> StoreError {
        let (server, what) = (self.address.to_string(), cause(e));
        let Some(code) = e.code() else {
            return if what.contains("password") {
                StoreError::NotLetIn { server, what }
            } else {
                StoreError::Unreachable { server, what }
            };
        };
        match class(code) {
            "28" | "3D" => StoreError::NotLetIn { server, what },
            // Lost connections, exhausted resources, locks held too long, and servers that start or stop.
            "08" | "53" | "55" | "57" => StoreError::Unreachable { server, what },
            // The server ended the session because it was idle in a transaction.
            "25" if *code == SqlState::IDLE_IN_TRANSACTION_SESSION_TIMEOUT => {
                StoreError::Unreachable { server, what }
            }
            _ => StoreError::Database { server, what },
        }
    }
}

/// Returns the class of an SQL state code: its first two characters.
fn class(code: &SqlState) -> &str {
    code.code().get(..2).unwrap_or_default()
}

/// Returns the cause of an error, in the words of the server or the system.
fn cause(e: &tokio_postgres::Error) -> String {
    match (e.as_db_error(), std::error::Error::source(e)) {
        (Some(db), _) => db.message().to_owned(),
        (None, Some(source)) => source.to_string(),
        (None, None) => e.to_string(),
    }
}

/// Returns true if a repeated transaction may succeed.
pub(super) fn is_conflict(e: &tokio_postgres::Error) -> bool {
    e.code().is_some_and(|code| {
        *code == SqlState::T_R_SERIALIZATION_FAILURE || *code == SqlState::T_R_DEADLOCK_DETECTED
    })
}

/// Returns true if the server rejected a transaction, which then certainly had no effect.
///
/// A server that stops during a commit may have committed.
pub(super) fn is_refused(e: &tokio_postgres::Error) -> bool {
    e.code()
        .is_some_and(|code| !matches!(class(code), "08" | "57"))
}
