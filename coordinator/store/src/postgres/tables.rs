//! The tables in the database, and their migration from earlier versions.
//!
//! The tables lie in a separate schema. `entries` is the ordered table of bytes that every store has.
//! `leader` has one row with the leader and the end of its leadership. `fence` has a row for each leadership.
//! Writers lock the row of their leadership, so a take-over, which closes that row, waits for their
//! transactions. Later transactions see that the row is closed. The column `written` is the number of the
//! last transaction that was committed under the leadership. `migrations` lists the completed steps.

use tokio_postgres::IsolationLevel;

use super::link::Server;
use crate::error::StoreError;

/// The migration steps from an empty schema to the current tables. New steps are only appended.
const STEPS: [&str; 1] = ["
    CREATE TABLE entries (key bytea PRIMARY KEY, value bytea NOT NULL);
    CREATE TABLE leader (
        single boolean PRIMARY KEY DEFAULT true CHECK (single),
        holder text NOT NULL, address text NOT NULL, epoch bigint NOT NULL, until timestamptz NOT NULL
    );
    INSERT INTO leader VALUES (true, '', '', 0, '-infinity');
    CREATE TABLE fence (epoch bigint PRIMARY KEY, written bigint NOT NULL, closed boolean NOT NULL);
"];
/// The key of the advisory lock that is held while the tables are changed.
const LOCK: i64 = 0x5349_4748_544c_494e;

/// Creates the tables, or migrates them to the current version.
///
/// # Errors
/// [`StoreError::NewerTables`] if a newer program created the tables.
pub(super) async fn migrate(server: &Server) -> Result<(), StoreError> {
    let meaning = |e: tokio_postgres::Error| server.meaning(&e);
    let mut client = server.connect(None).await?;
    let known = STEPS.len() as i32;
    // Most starts change no tables, and then the user needs no permission to create any.
    let is_there = "SELECT to_regclass('sightline.migrations') IS NOT NULL";
    if client
        .query_one_scalar::<bool, _>(is_there, &[])
        .await
        .map_err(meaning)?
        && reached(&client).await.map_err(meaning)? == known
    {
        return Ok(());
    }
    let change = client
        .build_transaction()
        .isolation_level(IsolationLevel::ReadCommitted);
    let change = change.start().await.map_err(meaning)?;
    change
        .execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])
        .await
        .map_err(meaning)?;
    change
        .batch_execute(
            "CREATE SCHEMA IF NOT EXISTS sightline; \
             CREATE TABLE IF NOT EXISTS migrations (version int PRIMARY KEY, at timestamptz NOT NULL)",
        )
        .await
        .map_err(meaning)?;
    let found = reached(change.client()).await.map_err(meaning)?;
    if found > known {
        return Err(StoreError::NewerTables {
            server: server.address.to_string(),
            found,
            known,
        });
    }
    for (version, step) in (1..).zip(STEPS).skip(found.max(0) as usize) {
        change.batch_execute(step).await.map_err(meaning)?;
        let noted = "INSERT INTO migrations VALUES ($1, clock_timestamp())";
        change.execute(noted, &[&version]).await.map_err(meaning)?;
    }
    change.commit().await.map_err(meaning)
}

async fn reached(client: &tokio_postgres::Client) -> Result<i32, tokio_postgres::Error> {
    client
        .query_one_scalar("SELECT coalesce(max(version), 0) FROM migrations", &[])
        .await
}
