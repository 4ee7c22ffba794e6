//! Retention: the removal of old ended jobs, of their scenes, and of unreferenced blobs.
//!
//! Jobs are also removed if their results and scenes exceed the maximum size. The clock of retention measures
//! ages, so a step of the wall clock does not delete anything.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobRecord, JobState};
use sightline_store::StoreError;

use crate::blobs::ownership;
use crate::blobs::references::{self, KeepingError};
use crate::coordinator::Coordinator;
use crate::jobs::control::JobError;
use crate::jobs::delete;
use crate::jobs::retention_clock::{Age, SpanUse};
use crate::records::{JobChanges, OutputRemoval, Records};
use crate::telemetry::events::{self, LogEvent};

/// The largest difference between the clock of a file server or a bucket and the clock of this machine.
const OTHER_CLOCKS: Duration = Duration::from_secs(15 * 60);

/// A failure of the removal.
#[derive(Debug, thiserror::Error)]
enum RetentionFault {
    #[error(transparent)]
    Keeping(#[from] KeepingError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Job(#[from] JobError),
}

/// Removes data that exceeds the limits of retention. A failure is logged, and the next call removes the
/// rest.
pub(crate) fn tidy_up(c: &Arc<Coordinator>) {
    if let Err(e) = old_jobs(c)
        .and_then(|()| many_bytes(c))
        .and_then(|()| old_scenes(c))
    {
        tracing::warn!("expired jobs and scenes are not removed yet: {e}");
    }
    if !ownership::may_remove(c) {
        return;
    }
    let alone = |remove: &mut dyn FnMut()| {
        // While this thread holds these two locks, no job that references a blob is submitted and no output
        // is committed.
        let changes = JobChanges::begin(c);
        let _removal = OutputRemoval::begin(c);
        // A coordinator that no longer leads does not know the references of newer jobs.
        if c.records.may_change().is_ok() {
            remove();
        }
        changes.finish().run(c);
    };
    let grace = c.config.retention.grace;
    let is_old = |digest: &Digest, written| is_old_blob(c, SpanUse::Blobs, digest, written, grace);
    match references::sweep(c.records.queries(), &*c.blobs, &is_old, &alone) {
        Ok((0, _)) => {}
        Ok((blobs, bytes)) => {
            let text = format!("{blobs} unreferenced blobs with {bytes} bytes are removed");
            tracing::info!("{text}");
            c.record_event(LogEvent::new(events::EventKind::Coordinator, text));
        }
        Err(e) => tracing::warn!("unreferenced blobs are not removed yet: {e}"),
    }
    // A blob whose file cannot be inspected counts as stored.
    c.uploads
        .chunks
        .forget_removed(c.config.retention.grace, |chunk| {
            c.blobs.has(chunk).unwrap_or(true)
        });
    // Remove outputs that workers uploaded directly to the blob store and did not commit.
    if let Some(direct) = c.blobs.direct()
        && c.records.may_change().is_ok()
    {
        // The times are from the bucket's clock. The advancing wall clock resolves a time in the future.
        let is_old = |written| blob_age(c, SpanUse::Blobs, written, grace) == Age::Old;
        match direct.sweep(&is_old) {
            Ok(0) => {}
            Ok(count) => {
                tracing::info!("{count} uncommitted outputs are removed")
            }
            Err(e) => tracing::warn!("uncommitted outputs are not removed yet: {e}"),
        }
    }
    c.clock.future_blobs().end_pass();
    tracing::debug!("retention has finished");
}

/// Returns the age of a blob that was written at this time.
fn blob_age(c: &Coordinator, span_use: SpanUse, written: SystemTime, age: Duration) -> Age {
    // A file server has its own clock. Buckets reject requests whose clock differs from theirs by more than
    // this margin.
    let written = written.duration_since(UNIX_EPOCH).unwrap_or_default();
    let written = written
        .saturating_add(OTHER_CLOCKS.min(age / 16))
        .as_millis();
    let now = c.now();
    c.clock.retention().age(
        span_use,
        u64::try_from(written).unwrap_or(u64::MAX),
        age,
        now,
    )
}

/// Returns true if a blob is older than `age`. A blob whose time lies in the future has a wrong time, so its
/// age is measured from the first look at it.
fn is_old_blob(
    c: &Coordinator,
    span_use: SpanUse,
    digest: &Digest,
    written: SystemTime,
    age: Duration,
) -> bool {
    match blob_age(c, span_use, written, age) {
        Age::Unknown | Age::Young => false,
        Age::Old => true,
        Age::Future => {
            let now = c.now();
            let ran_ms = c.clock.retention().ran_ms(now);
            c.clock
                .future_blobs()
                .is_old(span_use, *digest, age, ran_ms)
        }
    }
}

fn delete(c: &Arc<Coordinator>, job: JobId, why: &str) -> Result<(), RetentionFault> {
    tracing::info!("job {job} is deleted: {why}");
    match delete::delete(c, job) {
        // Another thread removed the job first, or the next call tries again.
        Ok(_)
        | Err(JobError::Store(
            StoreError::UnknownJob { .. } | StoreError::IllegalTransition { .. },
        )) => Ok(()),
        Err(e) => Err(e.into()),
    }
}

/// Returns the ended jobs with the times of their ends, in ascending order of their numbers, since times may
/// be wrong.
fn ended(records: &Records) -> Result<Vec<(u64, JobRecord)>, RetentionFault> {
    let with_end_time = |job: JobRecord| {
        job.finished_at_ms
            .filter(|_| job.state.phase().ended())
            .map(|at| (at, job))
    };
    Ok(records
        .jobs()?
        .into_iter()
        .filter_map(with_end_time)
        .collect())
}

fn old_jobs(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(keep) = c.config.retention.keep else {
        return Ok(());
    };
    let now = c.now();
    for (at, job) in ended(&c.records)? {
        let age = c.clock.retention().age(SpanUse::Jobs, at, keep, now);
        if matches!(age, Age::Old | Age::Future) {
            delete(c, job.id, "the job ended longer ago than --keep allows")?;
        }
    }
    Ok(())
}

fn many_bytes(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(most) = c.config.retention.keep_bytes else {
        return Ok(());
    };
    let mut scenes: BTreeMap<Digest, u64> = BTreeMap::new();
    for scene in c.records.scenes()? {
        scenes.insert(scene.digest, scene.bytes);
    }
    let ended = ended(&c.records)?;
    let named: BTreeSet<Digest> = ended.iter().map(|(_, job)| job.scene).collect();
    // The removal of jobs does not free these scenes.
    let stays = scenes
        .iter()
        .filter(|(scene, _)| !named.contains(*scene))
        .map(|(_, bytes)| *bytes);
    let stays = stays.fold(0, u64::saturating_add);
    if stays >= most {
        tracing::warn!(
            "scenes without ended jobs have {stays} bytes, which is not below --keep-bytes; no job \
             is deleted"
        );
        return Ok(());
    }
    // Jobs with the same result share its blob.
    let mut results: BTreeMap<Digest, (u64, u32)> = BTreeMap::new();
    for (_, job) in &ended {
        if let JobState::Done { result, bytes } = job.state {
            results.entry(result).or_insert((bytes, 0)).1 += 1;
        }
    }
    let of_results = results.values().map(|(bytes, _)| *bytes);
    let mut sum = of_results
        .chain(scenes.values().copied())
        .fold(0, u64::saturating_add);
    for (_, job) in ended {
        if sum <= most {
            break;
        }
        delete(
            c,
            job.id,
            "results and scenes have more bytes than --keep-bytes allows",
        )?;
        if let JobState::Done { result, bytes } = job.state
            && let Some((_, jobs)) = results.get_mut(&result)
        {
            *jobs -= 1;
            if *jobs == 0 {
                sum -= bytes;
            }
        }
        // The removal of the last job that references the scene removes the scene, too.
        if c.records.scene(&job.scene)?.is_none() {
            sum -= scenes.remove(&job.scene).unwrap_or(0);
        }
    }
    Ok(())
}

/// Removes scenes that no job references and that were uploaded longer ago than `keep`.
fn old_scenes(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(keep) = c.config.retention.keep else {
        return Ok(());
    };
    for scene in c.records.scenes()? {
        let written = c.blobs.written(&scene.digest).map_err(KeepingError::from)?;
        // A client can replace a lost blob only by a new upload, so remove the record.
        if written.is_none_or(|at| is_old_blob(c, SpanUse::Jobs, &scene.digest, at, keep)) {
            let mut changes = JobChanges::begin(c);
            let deleted = changes.delete_scene(scene.digest);
            changes.finish().run(c);
            match deleted {
                Ok(_) | Err(StoreError::SceneInUse { .. } | StoreError::UnknownScene { .. }) => {}
                Err(e) => return Err(e.into()),
            }
        }
    }
    Ok(())
}
