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
    /// Check every record and every blob, and list the lost ones. Exit code 3 if records or blobs are lost.
    Verify(StoreVerifyArgs),
    /// Write the journal anew with what there is now, which is shorter. A coordinator does that itself at
    /// its start when it is worth it.
    Compact(PlaceArgs),
    /// Write all records to a file, one JSON line each. Blobs are files of their own.
    Export(StoreExportArgs),
    /// Read all records from such a file into an empty store.
    Import(ImportArgs),
    /// Copy all records of one store into another, empty one: from disk into PostgreSQL, or back.
    Migrate(MigrateArgs),
}

#[derive(Args, Debug)]
pub struct MigrateArgs {
    /// The store to read: sled:DIR, such as sled:sightline-data/state, or postgres://USER@HOST/DATABASE
    /// with the password in PGPASSWORD. No coordinator may use it.
    #[arg(value_name = "FROM")]
    pub from: String,
    /// The store to fill, which must be empty.
    #[arg(value_name = "TO")]
    pub to: String,
    /// The authority of the database's certificate, as PEM. Default: those of the system.
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
    /// The directory of a coordinator that does not run.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
}

#[derive(Args, Debug)]
pub struct StoreVerifyArgs {
    #[command(flatten)]
    pub place: PlaceArgs,
    /// Where the records are: sled:DIR, or postgres://USER@HOST/DATABASE with the password in PGPASSWORD. No
    /// coordinator may use them. Default: `state` in --data-dir.
    #[arg(
        long,
        value_name = "URL",
        env = "SIGHTLINE_STORE",
        hide_env_values = true
    )]
    pub store: Option<String>,
    /// The authority of the database's certificate, as PEM. Default: those of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_STORE_CA",
        hide_env_values = true
    )]
    pub store_ca: Option<PathBuf>,
    /// Where the blobs are, as for the coordinator. Default: `blobs` in --data-dir.
    #[arg(long, value_name = "URL")]
    pub blobs: Option<String>,
    /// Repair a damaged journal, remove damaged blobs, and compute lost tiles and results again at the next
    /// start. A copy of a damaged journal stays in `state/damaged`. Default: check only.
    #[arg(long)]
    pub repair: bool,
    /// Record that the blobs belong to this store, so that its coordinator may remove unreferenced ones.
    /// Only for a store whose records were restored or replaced on purpose.
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
