//! The arguments of the commands that are clients of a coordinator.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use sightline::{Client, CredentialFiles, Credentials, Endpoint, Error, JobOptions};

use crate::args::kinds::KindArgs;
use crate::args::traces::TraceArgs;

#[derive(Args, Debug, Clone)]
pub struct RemoteArgs {
    /// Address of the coordinator: https:// if the coordinator has a certificate.
    #[arg(
        long,
        value_name = "URL",
        default_value = "http://127.0.0.1:7600",
        env = "SIGHTLINE_COORDINATOR"
    )]
    #[arg(hide_env_values = true)]
    pub coordinator: String,
    #[command(flatten)]
    pub keys: KeyArgs,
}

/// The authority that a client trusts, and the credentials of the client.
#[derive(Args, Debug, Clone)]
pub struct KeyArgs {
    /// The certificate of the authority that signed the certificate of the coordinator, as PEM. Default: the
    /// authorities of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_CA",
        hide_env_values = true
    )]
    pub ca: Option<PathBuf>,
    /// The certificate of this client, as PEM. A worker can use a certificate instead of a token.
    #[arg(
        long,
        value_name = "FILE",
        requires = "key",
        env = "SIGHTLINE_CERT",
        hide_env_values = true
    )]
    pub cert: Option<PathBuf>,
    /// The private key of --cert, as PEM.
    #[arg(
        long,
        value_name = "FILE",
        requires = "cert",
        env = "SIGHTLINE_KEY",
        hide_env_values = true
    )]
    pub key: Option<PathBuf>,
    /// The file with the token that `sightline token new` printed. Default: the text of SIGHTLINE_TOKEN, if
    /// it is set.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_TOKEN_FILE",
        hide_env_values = true
    )]
    pub token_file: Option<PathBuf>,
}

impl RemoteArgs {
    /// Creates a client of the coordinator.
    pub fn client(&self) -> Result<Client, Error> {
        Client::new(self.endpoint()?)
    }

    /// Returns the endpoint of the coordinator.
    pub fn endpoint(&self) -> Result<Endpoint, Error> {
        Ok(Endpoint::new(&self.coordinator).with_credentials(self.credentials()?))
    }

    /// Reads the credentials from their files.
    pub fn credentials(&self) -> Result<Credentials, Error> {
        self.keys.files().read()
    }
}

impl KeyArgs {
    /// Returns the files with the credentials.
    pub fn files(&self) -> CredentialFiles {
        CredentialFiles {
            ca: self.ca.clone(),
            cert: self.cert.clone(),
            key: self.key.clone(),
            token_file: self.token_file.clone(),
        }
    }
}

#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    #[command(flatten)]
    pub remote: RemoteArgs,
    #[command(flatten)]
    pub job: JobOptions,
    /// Name of the job, which lists show next to its number. Only the first 32 characters are used. Default:
    /// the file name of the scene.
    #[arg(long)]
    pub name: Option<String>,
    /// Text that identifies the submission, so that `submit` is safe to repeat: a second submission with the
    /// same text returns the same job. Default: a new random text.
    #[arg(long, value_name = "TEXT")]
    pub request_id: Option<String>,
    /// Priority of the job, -1000 to 1000. Jobs of higher priority get workers first. Running tiles are not
    /// interrupted.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    #[arg(value_parser = priority)]
    pub priority: i32,
    /// Name of the user who submits the job. Jobs of the same priority share the workers evenly between
    /// users, regardless of the number of jobs per user. Default: the login name.
    #[arg(long, value_name = "NAME")]
    pub user: Option<String>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// Print the number of tiles, the expected cost according to the finished jobs of the coordinator, and
    /// the jobs that come first. Neither uploads the scene nor submits the job.
    #[arg(long)]
    pub dry_run: bool,
}

/// Parses the number of a job.
fn job_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| {
        "give the number of a job, such as 7; `sightline jobs` lists the numbers".to_owned()
    })
}

#[derive(Args, Debug)]
pub struct JobRefArgs {
    /// The number of the job, as `submit` and `jobs` print it.
    #[arg(value_name = "JOB", value_parser = job_number)]
    pub id: u64,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct ShowArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// Print all tiles of the job instead, one per line: state, worker, cost, and for failed attempts the
    /// workers and reasons.
    #[arg(long)]
    pub tiles: bool,
}

#[derive(Args, Debug)]
pub struct PauseArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// Stop running tiles, too. After `resume`, they continue from their last finished phase.
    #[arg(long)]
    pub now: bool,
}

#[derive(Args, Debug)]
pub struct LogsArgs {
    /// The number of the job. Default: the events of the whole farm.
    #[arg(value_name = "JOB", value_parser = job_number)]
    pub id: Option<u64>,
    /// Continue to print new events until Ctrl-C.
    #[arg(short, long)]
    pub follow: bool,
    /// Print the timeline of the tiles of the job as Chrome trace JSON, for chrome://tracing or
    /// ui.perfetto.dev. The timeline has a row per worker and shows each tile from its lease to its end.
    #[arg(long, requires = "id", conflicts_with_all = ["follow", "after"])]
    pub trace: bool,
    /// Number of an event: print only events with higher numbers. --json prints the numbers.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub after: u64,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct WorkersArgs {
    /// Release this worker from quarantine, instead of listing workers: its name, or its signature
    /// NAME#IDENTITY from the list.
    #[arg(long, value_name = "WORKER")]
    pub release: Option<String>,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct InvalidateArgs {
    /// The number of the job. Default: all jobs, which requires --worker.
    #[arg(value_name = "JOB", value_parser = job_number, required_unless_present = "worker")]
    pub id: Option<u64>,
    /// Select only this tile of the job. Can be given several times.
    #[arg(long = "tile", value_name = "N", requires = "id")]
    pub tiles: Vec<u32>,
    /// Select only tiles to which this worker may have contributed.
    #[arg(long, value_name = "WORKER")]
    pub worker: Option<String>,
    /// Select only tiles that were committed within this duration before now, such as 90m or 2h.
    #[arg(long, value_name = "DUR", value_parser = sightline::options::text::parse_duration)]
    pub since: Option<Duration>,
    /// Select only tiles that were committed earlier than this duration before now, such as 30m.
    #[arg(long, value_name = "DUR", value_parser = sightline::options::text::parse_duration)]
    pub until: Option<Duration>,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct FetchArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// The result file to write.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
    /// Download the finished cells of an unfinished job. The sets of all other cells contain every triangle,
    /// as undecided.
    #[arg(long)]
    pub partial: bool,
}

#[derive(Args, Debug)]
pub struct JobsArgs {
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Maximum number of jobs to list, 1 to 1000, the newest first.
    #[arg(long, value_name = "N", default_value_t = 100,
        value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub limit: u32,
    /// List only jobs with lower numbers than this job.
    #[arg(long, value_name = "JOB", value_parser = job_number_above_one)]
    pub before: Option<u64>,
    /// List only jobs in this state. Can be given several times.
    #[arg(long = "state", value_name = "STATE",
        value_parser = ["queued", "running", "paused", "cancelled", "failed", "done"])]
    pub states: Vec<String>,
    /// List only jobs whose name contains this text.
    #[arg(
        long,
        value_name = "TEXT",
        default_value = "",
        hide_default_value = true
    )]
    pub name: String,
    /// List only jobs of this user.
    #[arg(
        long,
        value_name = "USER",
        default_value = "",
        hide_default_value = true
    )]
    pub user: String,
    /// List all jobs, without a limit.
    #[arg(long, conflicts_with_all = ["limit", "before"])]
    pub all: bool,
}

#[derive(Args, Debug)]
pub struct PriorityArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// The new priority, -1000 to 1000. The priority of a job is 0 unless `submit --priority` set another
    /// one.
    #[arg(value_name = "N", allow_negative_numbers = true, value_parser = priority)]
    pub priority: i32,
}

fn priority(text: &str) -> Result<i32, String> {
    let number = text.parse().ok().filter(|n| (-1000..=1000).contains(n));
    number.ok_or_else(|| "a priority is a whole number from -1000 to 1000".to_owned())
}

/// Parses the job number of `--before`, which is at least 2, so that a lower job number exists.
fn job_number_above_one(text: &str) -> Result<u64, String> {
    match job_number(text)? {
        0 | 1 => Err("job numbers start at 1; give a number of at least 2".to_owned()),
        n => Ok(n),
    }
}
