//! The arguments of the commands that serve: the coordinator and the worker.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use sightline_model::BackendChoice;

use crate::choices::choice;
use crate::remote_args::RemoteArgs;

#[derive(Args, Debug)]
pub struct CoordinatorArgs {
    /// Address to listen on, such as 127.0.0.1:7600. Port 0 takes any free port; the address is printed to
    /// stdout.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:7600")]
    pub listen: SocketAddr,
    /// Directory for jobs, scenes and results.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
    /// Where scenes and results are: dir:PATH, or s3://BUCKET/PREFIX with
    /// ?endpoint=https://HOST:PORT&region=NAME&ca=FILE&keys=FILE&cache=BYTES. The keys of a bucket are read
    /// from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or from the file. Default: `blobs` in --data-dir.
    #[arg(long, value_name = "URL")]
    pub blobs: Option<String>,
    /// Serve a dashboard for browsers, and the calls as JSON, at this address, such as 127.0.0.1:7601. Off by
    /// default.
    #[arg(long, value_name = "ADDR:PORT")]
    pub http: Option<SocketAddr>,
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
    /// The file of tokens, as `sightline token new` makes it: every call needs one of them, and users see
    /// their own jobs and scenes alone. A change takes effect within two seconds.
    #[arg(long, value_name = "FILE")]
    pub tokens: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub struct WorkerArgs {
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Backends that this worker offers: cpu, gpu, or auto, every backend that works on this machine.
    #[arg(long, value_parser = choice::<BackendChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: BackendChoice,
    /// Use the Vulkan adapter whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    pub adapter: Option<String>,
    /// Threads for sampling and queries, 1 to 1024. Default: one per core.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
    /// Name that the coordinator shows. Default: host name, process number and a random number.
    #[arg(long)]
    pub name: Option<String>,
    /// Stop when the coordinator cannot be reached for this many seconds. Default: keep trying.
    #[arg(long, value_name = "S")]
    pub give_up_after: Option<u64>,
}

/// Reads a number of threads.
fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err("give a number from 1 to 1024, or leave --threads out for one thread per core".to_owned()),
    }
}
