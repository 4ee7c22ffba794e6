//! The arguments of the commands that speak with a coordinator as clients.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use sightline::{Client, CredentialFiles, Credentials, Endpoint, Error, JobOptions};

use crate::args::kinds::KindArgs;
use crate::args::traces::TraceArgs;

#[derive(Args, Debug, Clone)]
pub struct RemoteArgs {
    /// Address of the coordinator: https:// where it has a certificate.
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

/// Whom a client trusts, and who it says it is.
#[derive(Args, Debug, Clone)]
pub struct KeyArgs {
    /// The certificate, as PEM, of the authority that signed the coordinator's. Default: those of the system.
    #[arg(
        long,
        value_name = "FILE",
        env = "SIGHTLINE_CA",
        hide_env_values = true
    )]
    pub ca: Option<PathBuf>,
    /// A certificate of one's own, as PEM: workers may show one instead of a token.
    #[arg(
        long,
        value_name = "FILE",
        requires = "key",
        env = "SIGHTLINE_CERT",
        hide_env_values = true
    )]
    pub cert: Option<PathBuf>,
    /// The key of --cert, as PEM.
    #[arg(
        long,
        value_name = "FILE",
        requires = "cert",
        env = "SIGHTLINE_KEY",
        hide_env_values = true
    )]
    pub key: Option<PathBuf>,
    /// File with the token, as `sightline token new` prints it. Default: the text in SIGHTLINE_TOKEN, if it
    /// is set.
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

    /// Reads the credentials.
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
    /// Name shown beside the job's number, cut to 32 characters. Default: the scene's file name.
    #[arg(long)]
    pub name: Option<String>,
    /// Makes `submit` safe to repeat: submitting again with the same text gives the same job. Default: a new
    /// text each time.
    #[arg(long, value_name = "TEXT")]
    pub request_id: Option<String>,
    /// Jobs of higher priority get workers first, -1000 to 1000. Tiles at work are not taken back.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    #[arg(value_parser = priority)]
    pub priority: i32,
    /// Who submits. Jobs of the same priority share the workers evenly between users, however many jobs each
    /// has. Default: the login name.
    #[arg(long, value_name = "NAME")]
    pub user: Option<String>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// Submit nothing and send no scene: say how many tiles the job has, what it is expected to cost by the
    /// coordinator's finished jobs, and which jobs come before it.
    #[arg(long)]
    pub dry_run: bool,
}

/// Reads the number of a job.
fn job_number(text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| "a job is named by its number; `sightline jobs` lists the numbers".to_owned())
}

#[derive(Args, Debug)]
pub struct JobRefArgs {
    /// The job's number, as `submit` and `jobs` print it.
    #[arg(value_name = "JOB", value_parser = job_number)]
    pub id: u64,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct ShowArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// Print all tiles of the job instead, a line each: state, worker, cost, and on whom it failed and why.
    #[arg(long)]
    pub tiles: bool,
}

#[derive(Args, Debug)]
pub struct PauseArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// Stop the tiles at work, too. After `resume` they go on from their last finished phase.
    #[arg(long)]
    pub now: bool,
}

#[derive(Args, Debug)]
pub struct LogsArgs {
    /// The job's number. Default: everything that happened on the farm.
    #[arg(value_name = "JOB", value_parser = job_number)]
    pub id: Option<u64>,
    /// Go on with what happens from now on, until Ctrl-C.
    #[arg(short, long)]
    pub follow: bool,
    /// Print the time line of the job's tiles as Chrome trace JSON, for chrome://tracing or
    /// ui.perfetto.dev: a row for each worker, from lease to end.
    #[arg(long, requires = "id", conflicts_with_all = ["follow", "after"])]
    pub trace: bool,
    /// Only events with greater numbers; --json prints the numbers.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub after: u64,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct WorkersArgs {
    /// Let this quarantined worker work again, instead of listing workers: its name, or its signature
    /// NAME#IDENTITY from the list.
    #[arg(long, value_name = "WORKER")]
    pub release: Option<String>,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct InvalidateArgs {
    /// The job's number. Default: all jobs; then --worker is needed.
    #[arg(value_name = "JOB", value_parser = job_number, required_unless_present = "worker")]
    pub id: Option<u64>,
    /// This tile of the job alone. Can be given several times.
    #[arg(long = "tile", value_name = "N", requires = "id")]
    pub tiles: Vec<u32>,
    /// Only tiles in which this worker may have had a hand.
    #[arg(long, value_name = "WORKER")]
    pub worker: Option<String>,
    /// Only tiles that were committed in this last time, such as 90m or 2h.
    #[arg(long, value_name = "DUR", value_parser = sightline::options::text::parse_duration)]
    pub since: Option<Duration>,
    /// Only tiles that were committed before this last time.
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
    /// Of a job that has not ended, what is done so far. Cells that are not done show everything, as
    /// undecided.
    #[arg(long)]
    pub partial: bool,
}

#[derive(Args, Debug)]
pub struct JobsArgs {
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Most jobs to list, 1 to 1000: the newest.
    #[arg(long, value_name = "N", default_value_t = 100,
        value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub limit: u32,
    /// List only jobs older than this one.
    #[arg(long, value_name = "JOB", value_parser = first_after_none)]
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
    /// List all jobs, however many there are.
    #[arg(long, conflicts_with_all = ["limit", "before"])]
    pub all: bool,
}

#[derive(Args, Debug)]
pub struct PriorityArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// The new priority, -1000 to 1000. A job has 0 unless `submit` was told otherwise.
    #[arg(value_name = "N", allow_negative_numbers = true, value_parser = priority)]
    pub priority: i32,
}

fn priority(text: &str) -> Result<i32, String> {
    let number = text.parse().ok().filter(|n| (-1000..=1000).contains(n));
    number.ok_or_else(|| "a priority is a whole number from -1000 to 1000".to_owned())
}

/// The number of a job with older ones before it.
fn first_after_none(text: &str) -> Result<u64, String> {
    match job_number(text)? {
        0 | 1 => Err("no job is older: jobs are numbered from 1".to_owned()),
        n => Ok(n),
    }
}
