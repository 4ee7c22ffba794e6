//! The arguments of `sightline store`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

#[derive(Args, Debug)]
pub struct StoreCommandArgs {
    #[command(subcommand)]
    pub command: StoreCommand,
}

#[derive(Subcommand, Debug)]
pub enum StoreCommand {
    /// Check every record and every blob, and list lost ones. If records or blobs are lost, the exit code is
    /// 3.
    Verify(StoreVerifyArgs),
    /// Write a shorter journal with only the current records. A coordinator compacts its journal at startup
    /// when the journal is over 32 MiB and more than eight times as large as its records.
    Compact(PlaceArgs),
    /// Write all records to a file, one JSON line each. The file does not contain blobs.
    Export(StoreExportArgs),
    /// Read all records from an exported file into an empty store.
    Import(ImportArgs),
    /// Copy all records of a store to an empty one: from disk to PostgreSQL, or back.
    Migrate(MigrateArgs),
}

#[derive(Args, Debug)]
pub struct MigrateArgs {
    /// The store to read: sled:DIR, such as sled:sightline-data/state, or postgres://USER@HOST/DATABASE with
    /// the password in PGPASSWORD. Stop its coordinators first.
    #[arg(value_name = "FROM")]
    pub from: String,
    /// The store to write, in the same form. It must be empty.
    #[arg(value_name = "TO")]
    pub to: String,
    /// The authority of the certificate of the database, as PEM. Default: the authorities of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_STORE_CA",
        hide_env_values = true
    )]
    pub store_ca: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub struct PlaceArgs {
    /// The data directory of a stopped coordinator.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
}

#[derive(Args, Debug)]
pub struct StoreVerifyArgs {
    #[command(flatten)]
    pub place: PlaceArgs,
    /// Location of the records: sled:DIR, or postgres://USER@HOST/DATABASE with the password in PGPASSWORD.
    /// Stop its coordinators first. Default: `state` in --data-dir.
    #[arg(
        long,
        value_name = "URL",
        env = "SIGHTLINE_STORE",
        hide_env_values = true
    )]
    pub store: Option<String>,
    /// The authority of the certificate of the database, as PEM. Default: the authorities of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_STORE_CA",
        hide_env_values = true
    )]
    pub store_ca: Option<PathBuf>,
    /// Location of the blobs, in the form of `sightline coordinator --blobs`. Default: `blobs` in --data-dir.
    #[arg(long, value_name = "URL")]
    pub blobs: Option<String>,
    /// Repair a damaged journal, remove damaged blobs, and mark lost tiles and results to be computed again
    /// at the next start. A copy of a damaged journal stays in `state/damaged`. Default: only check.
    #[arg(long)]
    pub repair: bool,
    /// Record that the blobs belong to this store, so that its coordinator may remove unreferenced blobs. Use
    /// it only if you restored or replaced the records on purpose.
    #[arg(long)]
    pub claim_blobs: bool,
}

#[derive(Args, Debug)]
pub struct StoreExportArgs {
    #[command(flatten)]
    pub place: PlaceArgs,
    /// The file to write.
    #[arg(short, long, value_name = "OUT.json")]
    pub output: PathBuf,
}

#[derive(Args, Debug)]
pub struct ImportArgs {
    #[command(flatten)]
    pub place: PlaceArgs,
    /// The file to read.
    #[arg(value_name = "FILE.json")]
    pub input: PathBuf,
}
