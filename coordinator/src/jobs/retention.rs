//! Retention: the removal of ended jobs that are too old or too many, of their scenes, and of unneeded blobs.
//!
//! The clock of retention measures ages, so that a step of the wall clock does not delete anything.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use sightline_records::ids::{Digest, JobId};
use sightline_records::{JobRecord, JobState};
use sightline_store::StoreError;

use crate::blobs::ownership;
use crate::blobs::references::{self, KeepingError};
use crate::jobs::control::JobError;
use crate::jobs::delete;
use crate::jobs::retention_clock::{Age, SpanUse};
use crate::records::{JobChanges, OutputRemoval};
use crate::state::Coordinator;
use crate::telemetry::events::{self, LogEvent};

/// The largest difference between the clock of a file server or a bucket and the clock of this machine.
const OTHER_CLOCKS: Duration = Duration::from_secs(15 * 60);

/// Something that stands in the way.
#[derive(Debug, thiserror::Error)]
enum RetentionFault {
    #[error(transparent)]
    Keeping(#[from] KeepingError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Job(#[from] JobError),
}

/// Removes what is not kept. A fault is logged, and what it left is removed the next time.
pub(crate) fn tidy_up(c: &Arc<Coordinator>) {
    if let Err(e) = old_jobs(c)
        .and_then(|()| many_bytes(c))
        .and_then(|()| old_scenes(c))
    {
        tracing::warn!("what is too old is not removed yet: {e}");
    }
    if !ownership::may_remove(c) {
        return;
    }
    let alone = |remove: &mut dyn FnMut()| {
        // While these are held, no job that names a blob is submitted and no output is committed.
        let changes = JobChanges::begin(c);
        let _removal = OutputRemoval::begin(c);
        // Who leads no more does not know what others need.
        if c.store.may_change().is_ok() {
            remove();
        }
        changes.finish().run(c);
    };
    let grace = c.retention.grace;
    let is_old =
        |digest: &Digest, written| is_old_blob(c, SpanUse::Blobs, (digest, written), grace);
    match references::sweep(c.store.queries(), &*c.blobs, &is_old, &alone) {
        Ok((0, _)) => {}
        Ok((blobs, bytes)) => {
            let text = format!("{blobs} blobs that nobody needs are removed, {bytes} bytes");
            tracing::info!("{text}");
            c.happened(LogEvent::of(events::Kind::Coordinator, text));
        }
        Err(e) => tracing::warn!("blobs that nobody needs are not removed yet: {e}"),
    }
    // A blob whose file cannot be inspected counts as stored.
    c.uploads.forget_removed(c.retention.grace, |chunk| {
        c.blobs.has(chunk).unwrap_or(true)
    });
    // Outputs of workers that did not come to commit them.
    if let Some(direct) = c.blobs.direct()
        && c.store.may_change().is_ok()
    {
        // The times are of the bucket's clock. A time in the future comes right with the wall clock.
        let is_old = |written| blob_age(c, SpanUse::Blobs, written, grace) == Age::Old;
        match direct.sweep(&is_old) {
            Ok(0) => {}
            Ok(count) => {
                tracing::info!("{count} outputs that were written and not committed are removed")
            }
            Err(e) => tracing::warn!("outputs that were not committed are not removed yet: {e}"),
        }
    }
    c.future_blobs().end_pass();
    tracing::debug!("retention has finished");
}

/// Returns the age of a blob with this time.
fn blob_age(c: &Coordinator, kind: SpanUse, written: SystemTime, age: Duration) -> Age {
    // A server of files has another clock; buckets answer only requests whose clock is this close to theirs.
    let written = written.duration_since(UNIX_EPOCH).unwrap_or_default();
    let written = written
        .saturating_add(OTHER_CLOCKS.min(age / 16))
        .as_millis();
    let now = c.now();
    c.retention_clock()
        .age(kind, u64::try_from(written).unwrap_or(u64::MAX), age, now)
}

/// Returns true if a blob is older than `age`. A blob whose time lies in the future has a wrong time, so
/// its age counts from the first look at it.
fn is_old_blob(
    c: &Coordinator,
    kind: SpanUse,
    (digest, written): (&Digest, SystemTime),
    age: Duration,
) -> bool {
    match blob_age(c, kind, written, age) {
        Age::Unknown | Age::Young => false,
        Age::Old => true,
        Age::Future => {
            let now = c.now();
            let ran_ms = c.retention_clock().ran_ms(now);
            c.future_blobs().is_old(kind, *digest, age, ran_ms)
        }
    }
}

fn delete(c: &Arc<Coordinator>, job: JobId, why: &str) -> Result<(), RetentionFault> {
    tracing::info!("job {job} is deleted: {why}");
    match delete::delete(c, job) {
        // Somebody was faster, or it is tried again.
        Ok(_)
        | Err(JobError::Store(
            StoreError::UnknownJob { .. } | StoreError::IllegalTransition { .. },
        )) => Ok(()),
        Err(e) => Err(e.into()),
    }
}

/// Returns the ended jobs with the times of their ends, ascending by number: times may be wrong.
fn ended(c: &Coordinator) -> Result<Vec<(u64, JobRecord)>, RetentionFault> {
    let with_end_time = |job: JobRecord| {
        job.finished_at_ms
            .filter(|_| job.state.phase().ended())
            .map(|at| (at, job))
    };
    Ok(c.store
        .jobs()?
        .into_iter()
        .filter_map(with_end_time)
        .collect())
}

fn old_jobs(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(keep) = c.retention.keep else {
        return Ok(());
    };
    let now = c.now();
    for (at, job) in ended(c)? {
        let age = c.retention_clock().age(SpanUse::Jobs, at, keep, now);
        if matches!(age, Age::Old | Age::Future) {
            delete(c, job.id, "it ended longer ago than jobs are kept")?;
        }
    }
    Ok(())
}

fn many_bytes(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(most) = c.retention.keep_bytes else {
        return Ok(());
    };
    let mut scenes: BTreeMap<Digest, u64> = BTreeMap::new();
    for scene in c.store.scenes()? {
        scenes.insert(scene.digest, scene.bytes);
    }
    let ended = ended(c)?;
    let named: BTreeSet<Digest> = ended.iter().map(|(_, job)| job.scene).collect();
    // These do not go with a job.
    let stays = scenes
        .iter()
        .filter(|(scene, _)| !named.contains(*scene))
        .map(|(_, bytes)| *bytes);
    let stays = stays.fold(0, u64::saturating_add);
    if stays >= most {
        tracing::warn!(
            "scenes without ended jobs have {stays} bytes, more than are kept: no job is deleted"
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
            "results and scenes have more bytes than are kept",
        )?;
        if let JobState::Done { result, bytes } = job.state
            && let Some((_, jobs)) = results.get_mut(&result)
        {
            *jobs -= 1;
            if *jobs == 0 {
                sum -= bytes;
            }
        }
        // It goes with the last job that names it.
        if c.store.scene(&job.scene)?.is_none() {
            sum -= scenes.remove(&job.scene).unwrap_or(0);
        }
    }
    Ok(())
}

/// Scenes that no job names any more, and that were sent longer ago than jobs are kept.
fn old_scenes(c: &Arc<Coordinator>) -> Result<(), RetentionFault> {
    let Some(keep) = c.retention.keep else {
        return Ok(());
    };
    for scene in c.store.scenes()? {
        let written = c.blobs.written(&scene.digest).map_err(KeepingError::from)?;
        // One whose blob is lost can only be sent again.
        if written.is_none_or(|at| is_old_blob(c, SpanUse::Jobs, (&scene.digest, at), keep)) {
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
