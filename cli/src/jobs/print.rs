//! The output of client commands about jobs.

use std::time::Duration;

use sightline::words::human;
use sightline::{Error, Job};
use sightline_model::job::message::time_budget_ms;
use sightline_proto::v1;
use sightline_traces::TraceId;

use crate::terminal::printable;
use crate::terminal::stdout::print;

/// Prints a job with its specification.
pub fn show_whole(job: &Job, json: bool) -> Result<(), Error> {
    let message = job.message();
    // The specification has the names and defaults of the interface, so that it can be submitted again.
    let spec = serde_json::to_value(&message.spec).map_err(Error::internal)?;
    if json {
        let mut value = job.to_json();
        value["spec"] = spec;
        return print(&value.to_string());
    }
    let spec = spec.as_object().map(|fields| {
        let shown = |(name, field): (&String, &serde_json::Value)| format!("\n  {name}: {field}");
        fields.iter().map(shown).collect::<String>()
    });
    let trace = TraceId::of_bytes(&message.trace).map(|trace| format!("\n  trace: {trace}"));
    print(&format!(
        "{}{}{}",
        listing(job),
        trace.unwrap_or_default(),
        spec.unwrap_or_default()
    ))
}

/// Returns a job in one line with its age and, while it runs, the remaining time.
pub fn listing(job: &Job) -> String {
    let whole = line(job);
    let job = job.message();
    let since = |ms: u64| human(Duration::from_millis(job.now_ms.saturating_sub(ms)));
    let age = match job.finished_at_ms {
        0 => format!("submitted {} ago", since(job.submitted_at_ms)),
        end => format!("ended {} ago", since(end)),
    };
    let left = job
        .left_millis
        .map(|ms| format!(", about {} left", human(Duration::from_millis(ms))));
    let (first, rest) = whole
        .split_once('\n')
        .map_or((&*whole, None), |(first, rest)| (first, Some(rest)));
    let rest = rest.map(|rest| format!("\n{rest}")).unwrap_or_default();
    format!("{first}, {age}{}{rest}", left.unwrap_or_default())
}

/// Returns the final state and the duration of a job, and the next command. For a failed or cancelled job,
/// the error at the end of the program contains the reason or the next command.
pub fn ending(job: &Job) -> String {
    let (state, has_receivers) = (job.state_name(), job.has_receivers());
    let job = job.message();
    let took = Duration::from_millis(job.finished_at_ms.saturating_sub(job.submitted_at_ms));
    let next = match job.state() {
        v1::JobState::Done if has_receivers => {
            format!("; the result has {} bytes", job.result_bytes)
        }
        v1::JobState::Done => {
            let bytes = job.result_bytes;
            format!(
                "; the result has {bytes} bytes, `sightline fetch {} -o FILE.pvs` downloads the result",
                job.id
            )
        }
        _ => String::new(),
    };
    format!(
        "job {} ended as {} {} after its submission{next}",
        job.id,
        state,
        human(took)
    )
}

/// Prints a job.
pub fn show_job(job: &Job, json: bool) -> Result<(), Error> {
    print(&if json {
        job.to_json().to_string()
    } else {
        line(job)
    })
}

/// Returns a job in one line, followed by details. The details are a line per running tile, and a line per
/// reason why workers cannot compute tiles of the job.
pub fn line(job: &Job) -> String {
    let (state, noun) = (job.state_name(), job.cell_noun());
    let job = job.message();
    let reason = if job.reason.is_empty() {
        String::new()
    } else {
        format!(": {}", job.reason)
    };
    // Only a job that has ended can be retried.
    let again = match job.state() {
        v1::JobState::Done | v1::JobState::Failed | v1::JobState::Cancelled => {
            format!(" (`sightline retry {}` computes these tiles again)", job.id)
        }
        _ => String::new(),
    };
    let aside = match job.tiles_set_aside {
        0 => String::new(),
        some => format!(", {some} SET ASIDE{again}"),
    };
    let workers = match (job.state(), job.workers) {
        (v1::JobState::Queued | v1::JobState::Running, 0) => {
            ", NO WORKERS: start some with `sightline worker`"
        }
        _ => "",
    };
    let priority = match job.priority {
        0 => String::new(),
        n => format!(", priority {n}"),
    };
    let user = if job.user.is_empty() {
        String::new()
    } else {
        format!(" of {}", job.user)
    };
    let teams: String = job
        .teams
        .iter()
        .map(|t| format!("\n  {}", team_line(t)))
        .collect();
    // In such a job, a worker without a tile is idle by design.
    let alone = job.spec.as_ref().is_some_and(has_single_workers);
    let alone = if alone && !job.teams.is_empty() {
        "\n  each tile has one worker: workers do not share a tile with a time budget, cubes or receivers"
    } else {
        ""
    };
    let more: String = job
        .unable
        .iter()
        .map(|u| format!("\n  {}", unable_line(u)))
        .collect();
    let more = format!("{teams}{alone}{more}");
    format!(
        "job {} {}{user} {}{reason}: {}/{} tiles{aside}, {} {}, {} samples{priority}{workers}{more}",
        job.id,
        printable::name(&job.name),
        state,
        job.tiles_done,
        job.tiles_total,
        job.cells_done,
        noun,
        job.samples
    )
}

fn team_line(t: &v1::Team) -> String {
    let v1::Team { tile, leader, .. } = t;
    if !t.has_begun {
        return format!(
            "tile {tile}: leased to worker {leader}, not started (the worker prepares, or computes \
             another tile)"
        );
    }
    match &t.helpers[..] {
        [] => format!("tile {tile}: computed by worker {leader}"),
        helpers => format!(
            "tile {tile}: worker {leader} leads, helped by {}",
            helpers.join(", ")
        ),
    }
}

fn unable_line(u: &v1::UnableWorkers) -> String {
    let more = match (u.workers as usize).saturating_sub(u.names.len()) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let worker = if u.workers == 1 { "worker" } else { "workers" };
    format!(
        "{worker} {}{more} cannot compute tiles of the job: {}",
        u.names.join(", "),
        u.reason
    )
}

/// Returns true if workers do not share a tile of the job.
fn has_single_workers(spec: &v1::JobSpec) -> bool {
    use v1::{job_spec::Task, sampling::Sampler, visibility::Method};
    let task = match &spec.task {
        Some(Task::Visibility(task)) => task,
        Some(Task::Ambient(_)) => return true,
        None => return false,
    };
    let sampling = match &task.method {
        Some(Method::Aggressive(method)) => method.sampling.as_ref(),
        Some(Method::Exact(method)) => method.sampling.as_ref(),
        Some(Method::Portals(_)) | None => None,
    };
    let sampler = sampling.and_then(|sampling| sampling.sampler.as_ref());
    matches!(sampler, Some(Sampler::Cubes(_))) || time_budget_ms(spec).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ending_names_state_duration_and_next_command() {
        let mut job = v1::Job {
            id: 7,
            submitted_at_ms: 1000,
            finished_at_ms: 62_000,
            result_bytes: 12,
            ..v1::Job::default()
        };
        job.set_state(v1::JobState::Done);
        let text = ending(&job.clone().into());
        assert!(
            text.starts_with("job 7 ended as done ") && text.contains("sightline fetch 7"),
            "{text}"
        );
        job.set_state(v1::JobState::Cancelled);
        let text = ending(&job.into());
        assert!(
            text.starts_with("job 7 ended as cancelled ") && !text.contains("fetch"),
            "{text}"
        );
    }
}
