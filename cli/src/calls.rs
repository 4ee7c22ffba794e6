//! Some commands as functions, for programs that want values instead of text, such as the Python package.
//!
//! What a function is to do is said by the flags of its command, so that a new flag needs no work here. What
//! a command prints with `--json` is what the function returns. Lines that a command would write to stderr go
//! to the function given to [`say_to`].

use std::ffi::OsString;
use std::path::Path;
use std::pin::Pin;
use std::time::Duration;

use clap::Parser;
use serde_json::{Value, json};
use sightline_proto::v1;
use sightline_pvs::Pvs;

use crate::args::{BakeArgs, MeasureArgs, VerifyArgs};
use crate::baking;
pub use crate::error::CliError;
pub use crate::opening::Source;
use crate::output::{Format, Output};
use crate::pace::{Left, Pace};
pub use crate::progress::say_to;
pub use crate::remote::Turn;
use crate::remote::{self, with_until};
use crate::remote_args::{FetchArgs, JobRefArgs, JobsArgs, PriorityArgs, SubmitArgs};
use crate::serve::default_name;
use crate::showing;
use crate::verdict::{Hooks, Verdict};
use crate::{client, measuring, submitting, verify as verifying};

/// Time between two looks at whether to stop.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// How far a function is.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// What is done.
    pub done: u64,
    /// All there is; 0 while that is not known.
    pub total: u64,
    /// What is counted.
    pub what: &'static str,
    /// The state of a job in a word; of other work, running.
    pub state: &'static str,
    /// The time left where it can be told.
    pub seconds_left: Option<f64>,
}

/// Whoever waits for a function.
pub trait Watcher: Sync {
    /// Takes the progress.
    fn progress(&self, progress: Progress);
    /// Whether to stop. The function then ends soon, with [`CliError::Interrupted`].
    fn is_stopped(&self) -> bool;
}

/// Resolves when the watcher wants to stop.
fn stopped(watcher: &dyn Watcher) -> Pin<Box<dyn Future<Output = ()> + '_>> {
    Box::pin(async move {
        while !watcher.is_stopped() {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    })
}

/// The progress of a job.
fn of_job(job: &v1::Job, pace: &mut Pace, workers_here: bool) -> Progress {
    let (done, total, what) = match job.cells_total {
        0 => (
            u64::from(job.tiles_done + job.tiles_set_aside),
            u64::from(job.tiles_total),
            "tiles",
        ),
        total => (job.cells_done, total, "cells"),
    };
    let seconds_left = match pace.left(job, workers_here) {
        Left::Seconds(seconds) => Some(seconds),
        Left::Finishing => Some(0.0),
        Left::Paused | Left::NoWorkers | Left::NotKnown => None,
    };
    Progress {
        done,
        total,
        what,
        state: showing::state(job),
        seconds_left,
    }
}

/// Arguments without a command.
#[derive(Parser)]
#[command(no_binary_name = true)]
struct Line<A: clap::Args> {
    #[command(flatten)]
    args: A,
}

/// Reads the arguments of a command: the flags, then those without a flag.
fn read<A: clap::Args>(flags: &[OsString], others: &[&Path]) -> Result<A, CliError> {
    let others = others.iter().map(|path| path.as_os_str().to_owned());
    let line = flags
        .iter()
        .cloned()
        .chain([OsString::from("--")])
        .chain(others);
    Line::try_parse_from(line)
        .map(|line| line.args)
        .map_err(|e| {
            let text = e.to_string();
            let end = ["\n\nUsage:", "\n\nFor more information"]
                .iter()
                .filter_map(|t| text.find(t))
                .min();
            let text = text[..end.unwrap_or(text.len())].trim_start_matches("error: ");
            CliError::Usage(text.split_whitespace().collect::<Vec<_>>().join(" "))
        })
}

/// Bakes in this process, as `sightline bake`, into the file `output`.
///
/// # Errors
/// [`CliError`].
pub fn bake(
    source: &Source,
    output: &Path,
    flags: &[OsString],
    watcher: &dyn Watcher,
) -> Result<Value, CliError> {
    let mut flags = flags.to_vec();
    flags.extend(["--output".into(), output.as_os_str().to_owned()]);
    let args: BakeArgs = read(&flags, &[source.path()])?;
    let input = if let Source::File(path) = source {
        Some(path.as_path())
    } else {
        None
    };
    let output = Output::check(output, Format::Pvs, input)?;
    let mut pace = Pace::new();
    let mut hooks = baking::Hooks {
        follow: &mut |job| watcher.progress(of_job(job, &mut pace, true)),
        stop: &|| watcher.is_stopped(),
        stopped: stopped(watcher),
    };
    let outcome = baking::bake(&args, source, &output, &mut hooks)?;
    Ok(json!({
        "job": outcome.job.id, "from_store": outcome.from_store, "samples": outcome.job.samples,
        "tiles_set_aside": outcome.job.tiles_set_aside,
    }))
}

/// Measures a result, as `sightline measure`. `name` is the result's in messages.
///
/// # Errors
/// [`CliError`].
pub fn measure(
    source: &Source,
    (pvs, name): (&Pvs, &Path),
    flags: &[OsString],
    watcher: &dyn Watcher,
) -> Result<Value, CliError> {
    let args: MeasureArgs = read(flags, &[source.path(), name])?;
    let counter = Counter::new("frames", watcher);
    measuring::measured(&args, pvs, source, &mut |done, total| {
        counter.tell(done, total);
        !watcher.is_stopped()
    })
}

/// Checks a result, as `sightline verify`. `name` is the result's in messages. Where the result is refused,
/// `accepted` is false.
///
/// # Errors
/// [`CliError`].
pub fn verify(
    source: &Source,
    (pvs, name): (&Pvs, &Path),
    flags: &[OsString],
    watcher: &dyn Watcher,
) -> Result<Value, CliError> {
    let args: VerifyArgs = read(flags, &[source.path(), name])?;
    let counter = Counter::new("cells", watcher);
    let hooks = Hooks {
        progress: &|done, cells| counter.tell(u64::from(done), u64::from(cells)),
        cancelled: &|| watcher.is_stopped(),
    };
    match verifying::verified(&args, pvs, source, &hooks)? {
        Verdict::Accepted(value, _) | Verdict::Refused(value, _) => Ok(value),
    }
}

/// Tells of a count of things that take about the same time each.
struct Counter<'a> {
    what: &'static str,
    start: std::time::Instant,
    watcher: &'a dyn Watcher,
}

impl<'a> Counter<'a> {
    fn new(what: &'static str, watcher: &'a dyn Watcher) -> Self {
        Self {
            what,
            start: std::time::Instant::now(),
            watcher,
        }
    }

    fn tell(&self, done: u64, total: u64) {
        let seconds = self.start.elapsed().as_secs_f64();
        let left = (done > 0).then(|| seconds / done as f64 * total.saturating_sub(done) as f64);
        let progress = Progress {
            done,
            total,
            what: self.what,
            state: "running",
            seconds_left: left,
        };
        self.watcher.progress(progress);
    }
}

/// A coordinator, as the commands of a client reach it. Jobs are what `show --json` prints.
#[derive(Clone, Debug)]
pub struct Client {
    /// The flags that say where the coordinator is and how to reach it.
    flags: Vec<OsString>,
}

impl Client {
    /// The client of the coordinator that these flags name; nothing is sent yet.
    ///
    /// # Errors
    /// [`CliError::Usage`] for flags that are none.
    pub fn new(flags: Vec<OsString>) -> Result<Self, CliError> {
        let client = Self { flags };
        client.read::<JobsArgs>(&[], &[])?;
        Ok(client)
    }

    fn read<A: clap::Args>(&self, flags: &[OsString], others: &[&Path]) -> Result<A, CliError> {
        read(&[&self.flags[..], flags].concat(), others)
    }

    fn of_job(&self, job: u64) -> Result<JobRefArgs, CliError> {
        self.read(&[], &[job.to_string().as_ref()])
    }

    /// Uploads a scene and submits a job. Also says whether that existed before.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn submit(
        &self,
        source: &Source,
        flags: &[OsString],
        watcher: &dyn Watcher,
    ) -> Result<(Value, bool), CliError> {
        let args: SubmitArgs = self.read(flags, &[source.path()])?;
        let (scene, request) = submitting::prepare(&args, source)?;
        let traces = args.traces.start("sightline-submit", &default_name()?)?;
        let _sends_the_rest = traces.closing();
        let answer = with_until(&args.remote, stopped(watcher), |client| {
            submitting::submitted(client, &scene, request, &traces)
        })?;
        Ok((
            showing::value(&answer.job.unwrap_or_default()),
            answer.existing,
        ))
    }

    /// The newest jobs, ascending by id.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn jobs(&self, flags: &[OsString], watcher: &dyn Watcher) -> Result<Vec<Value>, CliError> {
        let args: JobsArgs = self.read(flags, &[])?;
        let found = with_until(&args.remote, stopped(watcher), |client| {
            remote::listed(client, &args)
        })?;
        Ok(found.0.iter().map(showing::value).collect())
    }

    /// A job as it is now.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn show(&self, job: u64, watcher: &dyn Watcher) -> Result<Value, CliError> {
        let args = self.of_job(job)?;
        let shown = with_until(&args.remote, stopped(watcher), |client| {
            remote::shown(client, job)
        })?;
        Ok(showing::value(&shown))
    }

    /// Waits until a job ends, which must be with a result.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn wait(&self, job: u64, watcher: &dyn Watcher) -> Result<Value, CliError> {
        let args = self.of_job(job)?;
        let mut pace = Pace::new();
        let mut follow = |job: &v1::Job| watcher.progress(of_job(job, &mut pace, false));
        let remote = &args.remote;
        let ended = with_until(&args.remote, stopped(watcher), |client| {
            client::follow_on(client, remote, job, &mut follow)
        })?;
        client::must_be_done(&ended)?;
        Ok(showing::value(&ended))
    }

    /// Cancels, pauses, resumes or retries a job.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn turn(&self, job: u64, turn: Turn, watcher: &dyn Watcher) -> Result<Value, CliError> {
        let args = self.of_job(job)?;
        let turned = with_until(&args.remote, stopped(watcher), |client| {
            remote::turned(client, job, turn)
        })?;
        Ok(showing::value(&turned))
    }

    /// Gives a job another priority.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn prioritize(
        &self,
        job: u64,
        priority: i32,
        watcher: &dyn Watcher,
    ) -> Result<Value, CliError> {
        let words = [job.to_string(), priority.to_string()];
        let args: PriorityArgs = self.read(&[], &words.each_ref().map(Path::new))?;
        let request = v1::PrioritizeRequest {
            job,
            priority: args.priority,
        };
        let shown = with_until(&args.job.remote, stopped(watcher), |client| {
            remote::prioritized(client, request)
        })?;
        Ok(showing::value(&shown))
    }

    /// Downloads the result of a finished job to a file; returns the number of bytes.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn fetch(&self, job: u64, output: &Path, watcher: &dyn Watcher) -> Result<u64, CliError> {
        let flags = ["--output".into(), output.as_os_str().to_owned()];
        let args: FetchArgs = self.read(&flags, &[job.to_string().as_ref()])?;
        let output = Output::check(output, Format::Pvs, None)?;
        with_until(&args.job.remote, stopped(watcher), |client| {
            remote::fetched(client, job, false, &output)
        })
    }
}
