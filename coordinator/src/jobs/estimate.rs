//! Cost estimates of submissions, from the plan and from the costs of similar finished jobs.
//!
//! The estimate assumes that time and bytes are proportional to the number of cells. This holds from 512
//! cells upwards, because blocks of cells do not share samples. Each cell of a smaller grid costs more.

use std::sync::Arc;

use sightline_model::numbers::{RayCount, TargetError};
use sightline_model::{
    Crediting, CubeParams, JobSpec, LineAim, MethodName, PlannedJob, Sampler, SamplerName,
    Sampling, Stop, Visibility,
};
use sightline_records::ids::JobId;
use sightline_records::{JobPhase, JobRecord, JobState, owned_key, owned_request};
use sightline_scheduler::cells_total;
use sightline_viewcells::Division;

use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::jobs::control::{self, Summary};
use crate::jobs::stored_spec;
use crate::jobs::submit::{Submission, SubmitError};

/// Maximum number of jobs that an estimate inspects, starting at the newest.
const MOST_LOOKED_AT: usize = 1000;

/// The estimated cost of a submission.
pub(crate) struct Estimate {
    pub(crate) tiles: u32,
    /// The number of cells. 0 if the number is not known.
    pub(crate) cells: u64,
    /// The existing job that the submission would return.
    pub(crate) existing: Option<Summary>,
    /// The number of queued or running jobs with open tiles that precede the submission: with a higher
    /// priority, or with the same priority and the same user.
    pub(crate) jobs_before: u32,
    pub(crate) workers: u32,
    pub(crate) cost: Option<Cost>,
}

/// An expected cost, derived from finished jobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Cost {
    pub(crate) jobs: u32,
    /// True if the finished jobs have the same scene and parameters.
    pub(crate) same_scene: bool,
    /// The expected worker time in milliseconds, scaled from the cheapest, the median and the most expensive
    /// finished job. `bytes` contains the expected sizes of the result, in bytes and in the same order.
    pub(crate) millis: [u64; 3],
    pub(crate) bytes: [u64; 3],
}

/// The cost of a finished job.
struct Finished {
    like: bool,
    cells: u64,
    millis: u64,
    bytes: u64,
}

/// Estimates the cost of a submission, without changing any state.
pub(crate) fn estimate(
    c: &Arc<Coordinator>,
    caller: &Caller,
    submission: &Submission,
) -> Result<Estimate, SubmitError> {
    let job = &submission.job;
    let cells = cells_total(job);
    let known = match c
        .records
        .job_by_request(&owned_request(&submission.request_id, &submission.owner))?
    {
        Some(job) => Some(job),
        None => c
            .records
            .job_by_key(&owned_key(job.key(), &submission.owner))?,
    };
    let answers =
        |job: &JobRecord| !matches!(job.state.phase(), JobPhase::Failed | JobPhase::Cancelled);
    let existing = known
        .filter(answers)
        .map(|job| control::summary(c, job.id))
        .transpose()?;
    let (jobs_before, workers) = c.dispatcher.read(|scheduler| {
        let before = |id: &JobId| {
            scheduler.job(*id).is_some_and(|job| {
                let equal = job.record.priority == submission.priority
                    && job.record.user == submission.user;
                let answers = existing
                    .as_ref()
                    .is_some_and(|answer| answer.record.id == *id);
                job.runs()
                    && job.open() > 0
                    && !answers
                    && (job.record.priority > submission.priority || equal)
            })
        };
        (
            scheduler.job_ids().iter().filter(|id| before(id)).count() as u32,
            scheduler.workers(),
        )
    });
    let cost = (cells > 0)
        .then(|| finished(c, caller, job))
        .transpose()?
        .and_then(|jobs| cost(&jobs, cells));
    Ok(Estimate {
        tiles: job.plan().tiles.len() as u32,
        cells,
        existing,
        jobs_before,
        workers,
        cost,
    })
}

/// Returns the costs of finished jobs with the same method and sampler that `caller` may see.
fn finished(
    c: &Coordinator,
    caller: &Caller,
    job: &PlannedJob,
) -> Result<Vec<Finished>, SubmitError> {
    let (records, _) = c.records.jobs_before(JobId(u64::MAX), MOST_LOOKED_AT)?;
    let (spec, kind) = (job.spec(), JobKind::from_spec(job.spec()));
    let mut jobs = Vec::new();
    for record in records
        .into_iter()
        .filter(|record| caller.sees(&record.owner))
    {
        let JobState::Done { bytes, .. } = record.state else {
            continue;
        };
        // The specification of another version does not predict this version's cost.
        let Ok(other) = stored_spec::spec_without_viewpoints(&*c.blobs, &record.spec) else {
            continue;
        };
        if JobKind::from_spec(&other) != kind {
            continue;
        }
        let sum = control::summary(c, record.id)?;
        if sum.cells_done == 0 || sum.tiles_set_aside > 0 {
            continue;
        }
        let like = other.scene == spec.scene && samples_alike(&other, spec);
        jobs.push(Finished {
            like,
            cells: sum.cells_done,
            millis: sum.tile_millis,
            bytes,
        });
    }
    Ok(jobs)
}

/// The properties that two jobs share if the time of one predicts the time of the other.
#[derive(PartialEq)]
struct JobKind {
    /// The method and the sampler; `None` for ambient occlusion.
    method: Option<(MethodName, Option<SamplerName>)>,
    has_certificates: bool,
    has_budget: bool,
    has_boxes: bool,
}

impl JobKind {
    fn from_spec(spec: &JobSpec) -> Self {
        let task = spec.visibility();
        let sampler = |sampling: &Sampling| sampling.sampler.name();
        Self {
            method: task.map(|task| (task.method.name(), task.sampling().map(sampler))),
            has_certificates: task.is_some_and(Visibility::has_certificates),
            has_budget: spec.time_budget().is_some(),
            has_boxes: task.is_some_and(|task| matches!(task.division(), Division::Tree(_))),
        }
    }
}

/// Returns true if two jobs sample with the same parameters. Their cells may differ.
fn samples_alike(a: &JobSpec, b: &JobSpec) -> bool {
    let parameters = |spec: &JobSpec| {
        let task = spec.visibility()?;
        let sampling = task.sampling().map(|sampling| {
            let sampler = match &sampling.sampler {
                Sampler::Lines { aim, .. } => match aim {
                    LineAim::Known { error, stop, .. } => SamplerParams::Lines(*error, *stop),
                    LineAim::Adaptive { error, .. } => SamplerParams::Lines(*error, Stop::Expected),
                },
                Sampler::Guided { rays, credit, .. } => SamplerParams::Guided(*rays, *credit),
                Sampler::Cubes { params, .. } => SamplerParams::Cubes(*params),
            };
            (sampler, sampling.contributions)
        });
        Some((sampling, task.items(), task.far, task.pairs))
    };
    parameters(a) == parameters(b)
}

/// The parameters of a sampler, without its cells.
#[derive(PartialEq)]
enum SamplerParams {
    Lines(TargetError, Stop),
    Guided(RayCount, Crediting),
    Cubes(CubeParams),
}

/// Returns the expected cost of `cells` cells, or `None` without finished jobs. If jobs on the same scene
/// exist, only these count.
fn cost(jobs: &[Finished], cells: u64) -> Option<Cost> {
    let same_scene = jobs.iter().any(|job| job.like);
    let used: Vec<&Finished> = jobs.iter().filter(|job| job.like || !same_scene).collect();
    let min_median_max = |what: &dyn Fn(&Finished) -> u64| {
        let scaled = |job: &&Finished| {
            let exact = u128::from(what(job)) * u128::from(cells) / u128::from(job.cells);
            u64::try_from(exact).unwrap_or(u64::MAX)
        };
        let mut all: Vec<u64> = used.iter().map(scaled).collect();
        all.sort_unstable();
        Some([*all.first()?, *all.get(all.len() / 2)?, *all.last()?])
    };
    let (millis, bytes) = (
        min_median_max(&|job| job.millis)?,
        min_median_max(&|job| job.bytes)?,
    );
    Some(Cost {
        jobs: used.len() as u32,
        same_scene,
        millis,
        bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_on_the_same_scene_count_before_others() {
        let job = |like, cells, millis| Finished {
            like,
            cells,
            millis,
            bytes: 10 * millis,
        };
        assert_eq!(cost(&[], 8), None);
        let others = [job(false, 10, 100), job(false, 1, 2), job(false, 5, 20)];
        let found = cost(&others, 10).unwrap();
        assert_eq!((found.jobs, found.same_scene), (3, false));
        assert_eq!(
            (found.millis, found.bytes),
            ([20, 40, 100], [200, 400, 1000])
        );
        let found = cost(&[job(false, 1, 1000), job(true, 4, 8)], 8).unwrap();
        assert_eq!(
            (found.jobs, found.same_scene, found.millis),
            (1, true, [16, 16, 16])
        );
        let most = [Finished {
            like: true,
            cells: 1,
            millis: u64::MAX,
            bytes: 0,
        }];
        assert_eq!(cost(&most, 9).unwrap().millis[0], u64::MAX);
    }
}
