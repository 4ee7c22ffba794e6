//! The arguments of the commands that serve: the coordinator and the worker.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use sightline::options::arguments::named;
use sightline_model::TracerChoice;

use crate::args::remote::RemoteArgs;
use crate::args::traces::TraceArgs;

/// How a line of the log looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line: timestamp, level, target, the message and its fields, and the spans around it.
    Json,
}

#[derive(Args, Debug)]
pub struct CoordinatorArgs {
    /// Address to listen on, such as 127.0.0.1:7600. Port 0 takes any free port; the address is printed to
    /// stdout.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:7600")]
    pub listen: SocketAddr,
    /// Directory for jobs, scenes and results.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Where scenes and results are: dir:PATH, or s3://BUCKET/PREFIX with
    /// ?endpoint=https://HOST:PORT&region=NAME&ca=FILE&keys=FILE&cache=BYTES&direct=yes. The keys of a bucket
    /// are read from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or from the file. With direct=yes, or
    /// direct=https://HOST:PORT where workers use another address, workers read and write large blobs there
    /// by themselves. Default: `blobs` in --data-dir.
    #[arg(long, value_name = "URL")]
    pub blobs: Option<String>,
    /// Serve a dashboard for browsers, and the calls as JSON, at this address, such as 127.0.0.1:7601. Off by
    /// default.
    #[arg(long, value_name = "ADDR:PORT")]
    pub http: Option<SocketAddr>,
    /// Serve /metrics for Prometheus, /livez and /readyz at this address, such as 0.0.0.0:9464, as plain
    /// HTTP and to everybody: they name workers, and no jobs, users or scenes. Off by default.
    #[arg(long, value_name = "ADDR:PORT")]
    pub metrics_listen: Option<SocketAddr>,
    /// What each user of --tokens may have and do, such as bytes=100G,scenes=100,jobs=1000,tiles=1000000:
    /// bytes of scenes and results, scenes, jobs and their tiles; and requests a second and calls at a
    /// time, which are 200 and 256 if nothing else is said. `none` is no limit. With USER: in front it is
    /// for this user alone. Can be given several times.
    #[arg(long, value_name = "[USER:]NAME=N,…", requires = "tokens")]
    pub quota: Vec<String>,
    /// Delete jobs with their results this long after they ended, and scenes that no job names any more,
    /// such as 720h. A step of the wall clock pauses this. Default: keep them.
    #[arg(long, value_name = "DUR", value_parser = sightline::options::text::parse_duration)]
    pub keep: Option<Duration>,
    /// While results and scenes have more bytes than this, delete the ended job with the lowest number, such
    /// as 500G. Default: no bound.
    #[arg(long, value_name = "BYTES", value_parser = sightline_coordinator::bytes)]
    pub keep_bytes: Option<u64>,
    /// Have this share of the tiles, 0 to 1, computed again by another worker. Where the bytes differ, a
    /// third one says who was wrong; that worker is quarantined, and what it did is computed again.
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = share)]
    pub spot_check: f64,
    /// How the log on stderr looks: text, or one JSON object a line.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,
    /// Allow connections from other machines without encryption, where the network is private.
    #[arg(long)]
    pub allow_plaintext: bool,
    /// The coordinator's certificate, as PEM, with those between it and its authority: connections are
    /// encrypted. SIGHUP reads it again.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// The key of --tls-cert, as PEM.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// The authority of the workers' certificates, as PEM: a worker must show a certificate that it has
    /// signed, or a token with the scope worker.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub client_ca: Option<PathBuf>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// The file of tokens, as `sightline token new` makes it: every call needs one of them, and users see
    /// their own jobs and scenes alone. A change takes effect within two seconds.
    #[arg(long, value_name = "FILE")]
    pub tokens: Option<PathBuf>,
}

#[derive(Args)]
pub struct StoreArgs {
    /// Where the records of jobs, scenes and tiles are: sled:DIR on this disk, memory: until the end, or
    /// postgres://USER@HOST/DATABASE, which several coordinators share: one leads, the others pass calls on
    /// to it. The database's password is in PGPASSWORD. Default: sled in the data directory.
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
    /// Where the other coordinators of the database call this one. Default: the address of --listen.
    #[arg(long, value_name = "URL")]
    pub advertise: Option<String>,
    /// The authority of the other coordinators' certificates, as PEM. Default: those of the system.
    #[arg(long, value_name = "FILE")]
    pub peer_ca: Option<PathBuf>,
}

impl std::fmt::Debug for StoreArgs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // The address may hold a password.
        f.debug_struct("StoreArgs")
            .field("advertise", &self.advertise)
            .finish_non_exhaustive()
    }
}

#[derive(Args, Debug)]
pub struct WorkerArgs {
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Backends that this worker offers: cpu, gpu, or auto, every backend that works on this machine.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
    /// Use the Vulkan adapter whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    pub adapter: Option<String>,
    /// Threads for sampling and queries, 1 to 1024. Default: one per core.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
    /// Name that the coordinator shows. Default: host name, process number and a random number.
    #[arg(long)]
    pub name: Option<String>,
    /// Serve /metrics for Prometheus, /livez and /readyz at this address, such as 0.0.0.0:9465, as plain
    /// HTTP and to everybody. Ready is a worker that its coordinator knows. Off by default.
    #[arg(long, value_name = "ADDR:PORT")]
    pub metrics_listen: Option<SocketAddr>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// How the log on stderr looks: text, or one JSON object a line.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,
    /// Read and write every blob through the coordinator, also where it offers addresses of its object
    /// store: for a machine that must not reach that, or would only wait for it.
    #[arg(long)]
    pub no_direct: bool,
    /// Stop when the coordinator cannot be reached for this many seconds. Default: keep trying.
    #[arg(long, value_name = "S")]
    pub give_up_after: Option<u64>,
}

/// Reads a share.
fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("give a share from 0 to 1, such as 0.02".to_owned()),
    }
}

/// Reads a number of threads.
fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err(
            "give a number from 1 to 1024, or leave --threads out for one thread per core"
                .to_owned(),
        ),
    }
}
