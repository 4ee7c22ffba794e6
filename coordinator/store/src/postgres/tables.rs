//! The tables in the database, and how older ones are brought up to date.
//!
//! They lie in a schema of their own. `entries` is the ordered table of bytes that every store keeps.
//! `leader` is one row that says who leads and until when. `fence` has a row for each leadership: writers
//! lock theirs, so that a take-over, which closes it, waits for their transactions and is seen by later ones;
//! `written` is the number of the last transaction that was committed under it. `migrations` says which steps
//! were taken.

use tokio_postgres::IsolationLevel;

use super::link::Server;
use crate::error::StoreError;

/// The steps from an empty schema to the tables of today. Steps are only ever added.
const STEPS: [&str; 1] = ["
    CREATE TABLE entries (key bytea PRIMARY KEY, value bytea NOT NULL);
    CREATE TABLE leader (
        single boolean PRIMARY KEY DEFAULT true CHECK (single),
        holder text NOT NULL, address text NOT NULL, epoch bigint NOT NULL, until timestamptz NOT NULL
    );
    INSERT INTO leader VALUES (true, '', '', 0, '-infinity');
    CREATE TABLE fence (epoch bigint PRIMARY KEY, written bigint NOT NULL, closed boolean NOT NULL);
"];
/// Held while the tables are changed.
const LOCK: i64 = 0x5349_4748_544c_494e;

/// Makes the tables, or brings them up to date.
///
/// # Errors
/// [`StoreError::NewerTables`] when a newer program made them.
pub(super) async fn migrate(server: &Server) -> Result<(), StoreError> {
    let meaning = |e: tokio_postgres::Error| server.meaning(&e);
    let mut client = server.connect(None).await?;
    let known = STEPS.len() as i32;
    // Most starts change nothing, and then the user needs no right to create anything.
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
