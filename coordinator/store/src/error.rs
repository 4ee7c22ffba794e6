//! The errors of the store. Each message names the fault, its place and a remedy.
//!
//! The errors can be cloned: one failed disk write answers every command that shared it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sightline_records::JobPhase;
use sightline_records::ids::{Digest, JobId, TileIndex, hex};

/// An error of a command or a query.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StoreError {
    /// The requested job does not exist.
    #[error("job {job} does not exist; list the jobs to see their numbers")]
    UnknownJob {
        /// The requested job.
        job: JobId,
    },
    /// The requested tile does not exist.
    #[error(
        "job {job} has {tiles} tiles, numbered from 0, and no tile {tile}; the worker or client uses a \
         different plan"
    )]
    UnknownTile {
        /// The job.
        job: JobId,
        /// The requested tile.
        tile: TileIndex,
        /// The number of the job's tiles.
        tiles: u32,
    },
    /// The job's scene was not recorded.
    #[error("scene {} is not stored; upload it first", hex(.scene))]
    UnknownScene {
        /// The digest of the scene.
        scene: Digest,
    },
    /// The scene was recorded with another size or other numbers of triangles or objects.
    #[error(
        "scene {} is already recorded with another size or number of triangles or objects; one of the \
         two loaders is faulty",
        hex(.scene)
    )]
    SceneDiffers {
        /// The digest of the scene.
        scene: Digest,
    },
    /// The request id was used for a different submission.
    #[error(
        "request id {request_id:?} was used for job {job} with another scene or other \
         parameters; choose a fresh one"
    )]
    RequestIdReused {
        /// The request id.
        request_id: String,
        /// The job that the request id belongs to.
        job: JobId,
    },
    /// The state of the job does not allow the change.
    #[error("job {job} is {is}, so it cannot be {wanted}; {}", remedy(.job, .is))]
    IllegalTransition {
        /// The job.
        job: JobId,
        /// The state of the job.
        is: JobPhase,
        /// The requested change, as a participle for the message.
        wanted: &'static str,
    },
    /// The tile is not open, so it cannot be set aside.
    #[error(
        "tile {tile} of job {job} is no longer open, so it cannot be set aside; its output stays \
         stored"
    )]
    TileNotOpen {
        /// The job.
        job: JobId,
        /// The tile.
        tile: TileIndex,
    },
    /// The job has open tiles, so it cannot be finished.
    #[error("job {job} has {open} open tiles (of {tiles}), so it cannot be finished")]
    TilesOpen {
        /// The job.
        job: JobId,
        /// The number of tiles that are neither done nor set aside.
        open: u32,
        /// The number of tiles of the job.
        tiles: u32,
    },
    /// The finished job has another result.
    #[error(
        "job {job} is done with result {}, not {}; its inputs or the machine are at fault",
        hex(.kept), hex(.offered)
    )]
    ResultDiffers {
        /// The job.
        job: JobId,
        /// The digest of the stored result.
        kept: Digest,
        /// The digest of the rejected result.
        offered: Digest,
    },
    /// The job's plan has another number of tiles.
    #[error("job {job} was planned with {kept} tiles, not {offered}; a plan must not change")]
    PlanDiffers {
        /// The job.
        job: JobId,
        /// The recorded number of tiles.
        kept: u32,
        /// The rejected number of tiles.
        offered: u32,
    },
    /// A text or a list exceeds the maximum length.
    #[error("{what} is {length} {unit} long; shorten it to at most {limit} {unit}")]
    TooLong {
        /// The name of the text or list.
        what: &'static str,
        /// The length of the text or list.
        length: usize,
        /// The unit of the length in the plural, such as `bytes`.
        unit: &'static str,
        /// The maximum length.
        limit: usize,
    },
    /// A text contains a forbidden character.
    #[error("{what} contains the character {found:?}, which is not allowed; remove the character")]
    BadCharacter {
        /// The name of the text.
        what: &'static str,
        /// The forbidden character.
        found: char,
    },
    /// Another process uses the directory.
    #[error(
        "{} is in use by another coordinator (process {pid}); stop that coordinator, or choose another \
         data directory",
        .path.display()
    )]
    InUse {
        /// The path of the lock file.
        path: PathBuf,
        /// The id of the process that holds the lock, as written in the lock file.
        pid: String,
    },
    /// The journal rejected the command.
    ///
    /// After [`JournalError::Unusable`], the command may or may not take effect at the next start. After any
    /// other error, the command has no effect.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The value of an imported entry does not fit its key.
    #[error(
        "the entry with the key {key} is not a record of a store ({what}); use an unchanged export"
    )]
    Foreign {
        /// The key of the entry.
        key: String,
        /// The description of the fault.
        what: String,
    },
    /// The view cannot be read. The journal is not affected.
    #[error(
        "the store's view is damaged ({what}); restart the coordinator, which rebuilds the \
         view from the journal"
    )]
    View {
        /// The description of the fault.
        what: String,
    },
    /// The system cannot start the writer thread.
    #[error(
        "the system cannot start another thread ({what}); raise its limit of threads, or free \
         memory"
    )]
    Thread {
        /// The system's error.
        what: String,
    },
    /// The journal contains events that this version cannot decode.
    #[error(
        "the journal's frame before byte {before} cannot be decoded ({what}); use the program \
         version that wrote the frame"
    )]
    Unreadable {
        /// The offset of the end of the frame, in bytes.
        before: u64,
        /// The description of the fault.
        what: String,
    },
    /// A file operation on the store's directory failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The path of the file.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// The scene cannot be removed because a job references it.
    #[error("scene {} belongs to job {job}; delete its jobs first", hex(.scene))]
    SceneInUse {
        /// The digest of the scene.
        scene: Digest,
        /// A job that references the scene.
        job: JobId,
    },
    /// A blob that a change needs is temporarily unreadable.
    #[error("a required blob is temporarily unreadable ({what}); the coordinator tries again")]
    BlobWaits {
        /// The description of the fault.
        what: String,
    },
    /// The store contains scenes or jobs, so it cannot import the entries of another store.
    #[error(
        "the store contains scenes or jobs, so it cannot import another store; give an empty store"
    )]
    NotEmpty,
    /// The system returns no random numbers.
    #[error("the system returns no random numbers ({what}), which spot checks need")]
    Random {
        /// The system's error.
        what: String,
    },
    /// The address of the database is invalid.
    #[error(
        "{what}; give --store as postgres://USER@HOST/DATABASE, with the password in PGPASSWORD"
    )]
    Address {
        /// The description of the fault, without the address, because that may contain a password.
        what: String,
    },
    /// The database does not answer. The command had no effect.
    #[error("{server} does not answer ({what}); check that it runs and can be reached from here")]
    Unreachable {
        /// The address of the database, without the password.
        server: String,
        /// The description of the fault.
        what: String,
    },
    /// The database rejects the login.
    #[error(
        "{server} rejects the login ({what}); check the user, the name of the database and the \
         password in PGPASSWORD"
    )]
    NotLetIn {
        /// The address of the database, without the password.
        server: String,
        /// The answer of the database.
        what: String,
    },
    /// A newer program created the tables.
    #[error(
        "{server} contains tables of version {found}, but this program supports versions up to \
         {known}; run the newer program that created the tables"
    )]
    NewerTables {
        /// The address of the database, without the password.
        server: String,
        /// The version of the tables.
        found: i32,
        /// The highest version that this program supports.
        known: i32,
    },
    /// The database rejects a statement. The command had no effect.
    #[error("{server} rejects a statement ({what}); see the log of the database")]
    Database {
        /// The address of the database, without the password.
        server: String,
        /// The answer of the database.
        what: String,
    },
    /// Entries of the database cannot be decoded.
    #[error("{server} contains an unreadable entry ({what}); restore the database from a backup")]
    Damaged {
        /// The address of the database, without the password.
        server: String,
        /// The description of the fault.
        what: String,
    },
    /// The coordinator led, but could not renew its leadership in time.
    #[error(
        "this coordinator could not renew its leadership in time (its epoch was {epoch}: {what}), \
         so another one may lead; this process ends, and becomes a standby after a restart"
    )]
    NotRenewed {
        /// The epoch of the leadership.
        epoch: i64,
        /// The error of the last attempt.
        what: String,
    },
    /// Another coordinator leads. The command had no effect.
    #[error(
        "this coordinator no longer leads (its epoch was {epoch}), so it rejects the change; send \
         the request again, and the new leader answers"
    )]
    Fenced {
        /// The epoch of this coordinator's leadership.
        epoch: i64,
    },
    /// The writer thread has ended.
    #[error("the store has shut down; restart the coordinator")]
    Closed,
}

/// An error that occurred while the journal was read or written.
#[derive(Clone, Debug, thiserror::Error)]
pub enum JournalError {
    /// Another version wrote the journal.
    #[error(
        "{} is a journal that this version cannot read ({what}); use the version that wrote it, or move the \
         data directory away to begin with an empty store",
        .path.display()
    )]
    BadHeader {
        /// The path of the journal.
        path: PathBuf,
        /// The description of the fault.
        what: String,
    },
    /// Acknowledged frames are damaged or missing. The journal stays unchanged.
    #[error(
        "{} is damaged at byte {offset}: {what}{}; restore {} from a backup, or run `{}` to repair \
         it",
        .path.display(), after_semicolon(.lost), folder_of(.path).display(), repair_command(.path)
    )]
    Damaged {
        /// The path of the journal.
        path: PathBuf,
        /// The offset of the first bad frame, in bytes.
        offset: u64,
        /// The description of the fault.
        what: String,
        /// A sentence about the acknowledged changes that a repair would lose; may be empty.
        lost: String,
    },
    /// A part of the journal cannot be read. The journal stays unchanged.
    #[error(
        "{} cannot be read: {source}; if the error persists, copy {} to another disk or restore it from a \
         backup, or run `{}` to keep the readable part",
        .path.display(), folder_of(.path).display(), repair_command(.path)
    )]
    Unreadable {
        /// The path of the journal.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// The journal is missing, but its watermark or its view exists.
    #[error(
        "{} is missing, but files that were created with it exist; restore {} from a backup, or \
         run `{}` to continue with the records in these files",
        .path.display(), folder_of(.path).display(), repair_command(.path)
    )]
    Missing {
        /// The expected path of the journal.
        path: PathBuf,
    },
    /// The disk is full. The command had no effect.
    #[error(
        "no space left for {}; free some space, and the store continues automatically",
        .path.display()
    )]
    NoSpace {
        /// The path of the journal.
        path: PathBuf,
    },
    /// A write failed and was undone. The command had no effect.
    #[error("cannot write {}: {source}; check the disk", .path.display())]
    Write {
        /// The path of the journal.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// A sync, or the undoing of a write, failed, so the content on the disk is unknown.
    #[error(
        "{} is no longer reliable ({source}); check the disk and restart the coordinator",
        .path.display()
    )]
    Unusable {
        /// The path of the journal.
        path: PathBuf,
        /// The system's error.
        source: Arc<std::io::Error>,
    },
    /// A file operation failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The path of the file.
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

/// Returns an instruction for a user, for a job in this state.
fn remedy(job: &JobId, is: &JobPhase) -> String {
    match is {
        JobPhase::Cancelled | JobPhase::Failed => {
            format!("`sightline retry {job}` continues the job")
        }
        JobPhase::Paused => format!("`sightline resume {job}` continues the job"),
        JobPhase::Done => format!("`sightline fetch {job} -o FILE.pvs` downloads the result"),
        _ => format!("`sightline show {job}` prints the details"),
    }
}
