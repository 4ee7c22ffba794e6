//! The arguments of the commands that serve: the coordinator and the worker.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use sightline::options::arguments::named;
use sightline_model::TracerChoice;

use crate::args::remote::RemoteArgs;
use crate::args::traces::TraceArgs;

/// The format of the log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// Plain text for users.
    #[default]
    Text,
    /// One JSON object per line: timestamp, level, target, the message with its fields, and the enclosing
    /// spans.
    Json,
}

#[derive(Args, Debug)]
pub struct CoordinatorArgs {
    /// Address to listen on, such as 127.0.0.1:7600. With port 0, the system selects a free port. The address
    /// is printed to stdout.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:7600")]
    pub listen: SocketAddr,
    /// Directory for jobs, scenes and results.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Location of scenes and results: dir:PATH, or s3://BUCKET/PREFIX with
    /// ?endpoint=https://HOST:PORT&region=NAME&ca=FILE&keys=FILE&cache=BYTES&direct=yes. The keys of a bucket
    /// are read from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or from the file. With direct=yes, workers
    /// read and write large blobs directly in the bucket; use direct=https://HOST:PORT if workers need a
    /// different address. Default: `blobs` in --data-dir.
    #[arg(long, value_name = "URL")]
    pub blobs: Option<String>,
    /// Address of the HTTP server, such as 127.0.0.1:7601: a dashboard for browsers, and the calls of
    /// clients as JSON, except streams (docs/farm.md). Default: off.
    #[arg(long, value_name = "ADDR:PORT")]
    pub http: Option<SocketAddr>,
    /// Address of the metrics server, such as 0.0.0.0:9464: /metrics for Prometheus, /livez and /readyz, as
    /// plain HTTP without authentication. The metrics name workers, but no jobs, users or scenes. Default:
    /// off.
    #[arg(long, value_name = "ADDR:PORT")]
    pub metrics_listen: Option<SocketAddr>,
    /// Quota of each user of --tokens, such as bytes=100G,scenes=100,jobs=1000,tiles=1000000. The names are
    /// bytes (of scenes and results), scenes, jobs, tiles (of all jobs), requests (per second, default 200)
    /// and calls (at the same time, default 256). `none` means no limit. With USER: in front, the quota is
    /// only for this user. Can be given several times. Default: only the limits of requests and calls.
    #[arg(long, value_name = "[USER:]NAME=N,…", requires = "tokens")]
    pub quota: Vec<String>,
    /// Retention time of ended jobs with their results and of unreferenced scenes, such as 720h. After a step
    /// of the wall clock, no job is deleted by age until the coordinator has run for this time. Default:
    /// unlimited.
    #[arg(long, value_name = "DUR", value_parser = sightline::options::text::parse_duration)]
    pub keep: Option<Duration>,
    /// Maximum size of results and scenes in bytes, such as 500G. While they are larger, the coordinator
    /// deletes the ended job with the lowest number. Default: unlimited.
    #[arg(long, value_name = "BYTES", value_parser = sightline_coordinator::bytes)]
    pub keep_bytes: Option<u64>,
    /// Share of the tiles, 0 to 1, that a second worker computes again. If the outputs differ, a third worker
    /// computes the tile and determines the faulty worker. The coordinator quarantines the faulty worker and
    /// has its tiles computed again.
    #[arg(long, value_name = "P", default_value_t = 0.0, value_parser = share)]
    pub spot_check: f64,
    /// The format of the log on stderr: text, or one JSON object per line.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,
    /// Allow unencrypted connections from other machines. Use it only in private networks.
    #[arg(long)]
    pub allow_plaintext: bool,
    /// The certificate of the coordinator with its intermediate certificates, as PEM, to encrypt connections.
    /// SIGHUP reads it again. Default: no encryption.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// The private key of --tls-cert, as PEM.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// The authority of the certificates of workers, as PEM. A worker then needs a certificate from this
    /// authority, or a token with the scope worker.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub client_ca: Option<PathBuf>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// The file of tokens that `sightline token new` creates. Every call then needs a token, and users see
    /// only their own jobs and scenes. Changes of the file take effect within two seconds. Default: no
    /// authentication.
    #[arg(long, value_name = "FILE")]
    pub tokens: Option<PathBuf>,
}

#[derive(Args)]
pub struct StoreArgs {
    /// Location of the records of jobs, scenes and tiles: sled:DIR on this disk, memory: until the
    /// coordinator ends, or postgres://USER@HOST/DATABASE with the password in PGPASSWORD. Several
    /// coordinators can share a database: one leads, and the others forward calls to the leader. Default:
    /// sled in the data directory.
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
    /// Address at which the other coordinators of the database call this one. Default: the address of
    /// --listen.
    #[arg(long, value_name = "URL")]
    pub advertise: Option<String>,
    /// The authority of the certificates of the other coordinators, as PEM. Default: the authorities of the
    /// system.
    #[arg(long, value_name = "FILE")]
    pub peer_ca: Option<PathBuf>,
}

impl std::fmt::Debug for StoreArgs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Omit the address from debug output, because it may contain a password.
        f.debug_struct("StoreArgs")
            .field("advertise", &self.advertise)
            .finish_non_exhaustive()
    }
}

#[derive(Args, Debug)]
pub struct WorkerArgs {
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Backends that this worker offers: cpu, gpu, embree or auto. auto offers cpu, and gpu if it works on
    /// this machine.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
    /// Use the Vulkan adapter whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    pub adapter: Option<String>,
    /// Threads for sampling and queries, 1 to 1024. Default: one per core.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
    /// Name of the worker in lists and logs. Default: host name, process number and a random number.
    #[arg(long)]
    pub name: Option<String>,
    /// Address of the metrics server, such as 0.0.0.0:9465: /metrics for Prometheus, /livez and /readyz, as
    /// plain HTTP without authentication. The worker is ready while it is registered at its coordinator.
    /// Default: off.
    #[arg(long, value_name = "ADDR:PORT")]
    pub metrics_listen: Option<SocketAddr>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// The format of the log on stderr: text, or one JSON object per line.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t)]
    pub log_format: LogFormat,
    /// Transfer every blob through the coordinator, even if the coordinator offers addresses of its object
    /// store. Use this option if the machine must not reach the object store, or cannot reach it, so that
    /// attempts to connect only cost time.
    #[arg(long)]
    pub no_direct: bool,
    /// Duration in seconds after which the worker stops if the coordinator is unreachable. Default:
    /// unlimited.
    #[arg(long, value_name = "S")]
    pub give_up_after: Option<u64>,
}

/// Parses a share of the tiles, from 0 to 1.
fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("give a share from 0 to 1, such as 0.02".to_owned()),
    }
}

/// Parses a number of threads from 1 to 1024.
fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err(
            "give a number from 1 to 1024, or omit --threads for one thread per core".to_owned(),
        ),
    }
}
