//! The errors of the store. Each message names the fault, its place and a remedy.
//!
//! The errors can be cloned: one failed disk write answers every command that shared it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sightline_records::JobPhase;
use sightline_records::ids::{Digest, JobId, TileIndex, hex};

/// A command or query that could not be answered.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StoreError {
    /// No such job.
    #[error("job {job} is not known here; list the jobs to see which are")]
    UnknownJob {
        /// The id of the request.
        job: JobId,
    },
    /// No such tile.
    #[error(
        "job {job} has tiles 0..{tiles}, not {tile}; the worker or client that asked follows another plan"
    )]
    UnknownTile {
        /// The job.
        job: JobId,
        /// The tile of the request.
        tile: TileIndex,
        /// The number of the job's tiles.
        tiles: u32,
    },
    /// A job names a scene that was not recorded.
    #[error("scene {} is not known here; upload it first", hex(.scene))]
    UnknownScene {
        /// Its digest.
        scene: Digest,
    },
    /// The scene was recorded with other counts.
    #[error("scene {} was recorded before with other counts; one of the two loaders is wrong", hex(.scene))]
    SceneDiffers {
        /// Its digest.
        scene: Digest,
    },
    /// A request id used for two different submissions.
    #[error(
        "request id {request_id:?} was used for job {job} with another scene or other \
         parameters; choose a fresh one"
    )]
    RequestIdReused {
        /// The id.
        request_id: String,
        /// The job it belongs to.
        job: JobId,
    },
    /// The state of a job does not allow the change.
    #[error("job {job} is {is}, so it cannot be {wanted}; {}", remedy(.job, .is))]
    IllegalTransition {
        /// The job.
        job: JobId,
        /// Its state.
        is: JobPhase,
        /// The requested change.
        wanted: &'static str,
    },
    /// A tile that is no longer open cannot be set aside.
    #[error(
        "tile {tile} of job {job} is no longer open, so it cannot be set aside; what it has stays"
    )]
    TileNotOpen {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
    },
    /// A job with open tiles cannot be finished.
    #[error("job {job} has {open} open tiles (of {tiles}), so it cannot be finished")]
    TilesOpen {
        /// The job.
        job: JobId,
        /// Tiles neither done nor set aside.
        open: u32,
        /// Tiles it has.
        tiles: u32,
    },
    /// A finished job has another result.
    #[error(
        "job {job} is done with result {}, not {}; its inputs or the machine are at fault",
        hex(.kept), hex(.offered)
    )]
    ResultDiffers {
        /// The job.
        job: JobId,
        /// The result that stays.
        kept: Digest,
        /// The one refused.
        offered: Digest,
    },
    /// A plan with another number of tiles.
    #[error("job {job} was planned with {kept} tiles, not {offered}; a plan must not change")]
    PlanDiffers {
        /// The job.
        job: JobId,
        /// The number that stays.
        kept: u32,
        /// The one refused.
        offered: u32,
    },
    /// A text or list is longer than the store accepts.
    #[error("{what} is {length} long, more than the {limit} allowed; shorten it")]
    TooLong {
        /// The name of the text.
        what: &'static str,
        /// Its length.
        length: usize,
        /// The bound.
        limit: usize,
    },
    /// A text holds a character it may not.
    #[error("{what} holds the character {found:?}, which is not allowed there; leave it out")]
    BadCharacter {
        /// The name of the text.
        what: &'static str,
        /// The character.
        found: char,
    },
    /// Another process has the directory open.
    #[error(
        "{} is in use by another coordinator (process {pid}); stop that one, or choose another data \
            directory",
        .path.display()
    )]
    InUse {
        /// The lock file.
        path: PathBuf,
        /// Who holds it, as written in the lock file.
        pid: String,
    },
    /// The journal refused the command. After [`JournalError::Unusable`] the command may or may not take
    /// effect at the next start; after any other error it does not.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// An entry of another store is not what its key says.
    #[error(
        "the entry under {key} is no record of a store ({what}); take an export that nobody has changed"
    )]
    Foreign {
        /// Its key.
        key: String,
        /// What is wrong.
        what: String,
    },
    /// The view (not the journal) cannot be read.
    #[error(
        "the store's view is damaged ({what}); restart the coordinator, it rebuilds the view from the journal"
    )]
    View {
        /// The fault.
        what: String,
    },
    /// The writer thread cannot be started.
    #[error(
        "the system cannot start another thread ({what}); raise its limit of threads, or free memory"
    )]
    Thread {
        /// The system's error.
        what: String,
    },
    /// The journal holds events this version does not know.
    #[error(
        "the journal's frame before byte {before} cannot be understood ({what}); use the version that wrote \
         it"
    )]
    Unreadable {
        /// Where the frame ends.
        before: u64,
        /// The fault.
        what: String,
    },
    /// A file operation on the store's directory failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// A scene that a job names cannot be removed.
    #[error("scene {} is that of job {job}; delete its jobs first", hex(.scene))]
    SceneInUse {
        /// Its digest.
        scene: Digest,
        /// A job that names it.
        job: JobId,
    },
    /// A blob that a change needs cannot be read for now.
    #[error("a blob that is needed cannot be read for now ({what}); it is tried again")]
    BlobWaits {
        /// The fault.
        what: String,
    },
    /// Only an empty store takes over the entries of another one.
    #[error(
        "the store has scenes or jobs, and takes over those of another one only while it is empty; \
         give a new one"
    )]
    NotEmpty,
    /// The system gives no random numbers.
    #[error("the system gives no random numbers ({what}), by which tiles are drawn for checks")]
    Random {
        /// The system's error.
        what: String,
    },
    /// The address of a database cannot be used.
    #[error(
        "{what}; give --store as postgres://USER@HOST/DATABASE, with the password in PGPASSWORD"
    )]
    Address {
        /// The fault, without the address, which may hold a password.
        what: String,
    },
    /// The database does not answer. Nothing was changed.
    #[error("{server} does not answer ({what}); check that it runs and can be reached from here")]
    Unreachable {
        /// The database, without its password.
        server: String,
        /// The fault.
        what: String,
    },
    /// The database does not let this user in.
    #[error(
        "{server} does not let us in ({what}); check the user, the database's name and the password in \
             PGPASSWORD"
    )]
    NotLetIn {
        /// The database, without its password.
        server: String,
        /// Its answer.
        what: String,
    },
    /// The tables were made by a newer program.
    #[error(
        "{server} holds tables of version {found}, and this program knows those up to version {known}; run \
             the newer program that made them"
    )]
    NewerTables {
        /// The database, without its password.
        server: String,
        /// The version of its tables.
        found: i32,
        /// The last version that this program knows.
        known: i32,
    },
    /// The database refuses a statement. Nothing was changed.
    #[error("{server} refuses a statement ({what}); its log says more")]
    Database {
        /// The database, without its password.
        server: String,
        /// Its answer.
        what: String,
    },
    /// Entries of the database cannot be read.
    #[error("{server} holds what cannot be read ({what}); restore it from a backup")]
    Damaged {
        /// The database, without its password.
        server: String,
        /// The fault.
        what: String,
    },
    /// The coordinator led and could not tell the database so in time.
    #[error(
        "this coordinator could not renew its leadership in time (its epoch was {epoch}: {what}), so that \
         another one may lead; it ends here, and stands by when it is started again"
    )]
    NotRenewed {
        /// The epoch of its leadership.
        epoch: i64,
        /// What the last attempt met.
        what: String,
    },
    /// Another coordinator leads. Nothing was changed.
    #[error(
        "this coordinator does not lead any more (its epoch was {epoch}), so it changes nothing; ask again, \
             the one that leads now will answer"
    )]
    Fenced {
        /// The epoch of this coordinator's leadership.
        epoch: i64,
    },
    /// The writer thread is gone.
    #[error("the store has shut down; restart the coordinator")]
    Closed,
}

/// The journal could not be read or written.
#[derive(Clone, Debug, thiserror::Error)]
pub enum JournalError {
    /// A journal of another version.
    #[error(
        "{} is a journal that this version cannot read ({what}); use the version that wrote it, or move the \
         data directory away to begin with an empty store",
        .path.display()
    )]
    BadHeader {
        /// The file.
        path: PathBuf,
        /// The fault.
        what: String,
    },
    /// Acknowledged frames are damaged or missing. The journal stays as it is.
    #[error(
        "{} is damaged at byte {offset}: {what}{}; restore {} from a backup, or run `{}` to repair it",
        .path.display(), after_semicolon(.lost), folder_of(.path).display(), repair_command(.path)
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The offset of the first bad frame.
        offset: u64,
        /// The fault.
        what: String,
        /// A sentence about acknowledged changes that a repair would lose; may be empty.
        lost: String,
    },
    /// A part of the journal cannot be read. The journal stays as it is.
    #[error(
        "{} cannot be read: {source}; if that stays so, copy {} to another disk or restore it from a backup, \
         or run `{}` to keep the readable part",
        .path.display(), folder_of(.path).display(), repair_command(.path)
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// The journal is missing, but its watermark or its view exists.
    #[error(
        "{} is missing, and files that were made with it exist; restore {} from a backup, or run `{}` to \
         continue with the records that these files hold",
        .path.display(), folder_of(.path).display(), repair_command(.path)
    )]
    Missing {
        /// The expected path of the journal.
        path: PathBuf,
    },
    /// The disk is full. Nothing changed.
    #[error("no space left for {}; free some, the store goes on by itself", .path.display())]
    NoSpace {
        /// The journal.
        path: PathBuf,
    },
    /// A write failed and was undone. Nothing changed.
    #[error("cannot write {}: {source}; check the disk", .path.display())]
    Write {
        /// The journal.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// A sync, or the undoing of a write, failed: the content of the disk is unknown.
    #[error(
        "{} cannot be trusted any more ({source}); check the disk and restart the coordinator",
        .path.display()
    )]
    Unusable {
        /// The journal.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// A file operation failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
}

/// Returns the folder of the store whose journal is at `path`.
fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(path)
}

/// Returns the command that repairs the store whose journal is at `path`.
fn repair_command(path: &Path) -> String {
    let folder = folder_of(path);
    match folder
        .parent()
        .filter(|_| folder.file_name().is_some_and(|name| name == "state"))
    {
        Some(data) => format!(
            "sightline store verify --repair --data-dir {}",
            quoted(data)
        ),
        None => {
            format!(
                "sightline store verify --repair --store {}",
                format_args!("sled:{}", quoted(folder))
            )
        }
    }
}

/// Quotes a path for a shell where that is necessary.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "/._-+:".contains(c);
    match text.is_empty() {
        true => ".".to_owned(),
        false if text.chars().all(plain) => text,
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

fn after_semicolon(sentence: &str) -> String {
    if sentence.is_empty() {
        String::new()
    } else {
        format!("; {sentence}")
    }
}

/// What a user can do with a job in a state.
fn remedy(job: &JobId, is: &JobPhase) -> String {
    match is {
        JobPhase::Cancelled | JobPhase::Failed => format!("`sightline retry {job}` continues it"),
        JobPhase::Paused => format!("`sightline resume {job}` continues it"),
        JobPhase::Done => format!("`sightline fetch {job} -o FILE.pvs` downloads its result"),
        _ => format!("`sightline show {job}` says more"),
    }
}
