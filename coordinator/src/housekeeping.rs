//! What is removed by itself: jobs that are older than they are kept, or more than there is room for, and
//! blobs that nobody needs.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::chronicle::{Happening, Kind};
use crate::deleting;
use crate::ids::{Digest, JobId};
use crate::jobs::JobError;
use crate::keeping::{self, KeepingError};
use crate::state::Coordinator;
use crate::store::{JobRecord, JobState, StoreError};

/// Something that stands in the way.
#[derive(Debug, thiserror::Error)]
enum Fault {
    #[error(transparent)]
    Keeping(#[from] KeepingError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Job(#[from] JobError),
}

/// Removes what is not kept. A fault is logged, and what it left is removed the next time.
pub(crate) fn tidy_up(c: &Arc<Coordinator>) {
    if let Err(e) = old_jobs(c).and_then(|()| many_bytes(c)).and_then(|()| old_scenes(c)) {
        tracing::warn!("what is too old is not removed yet: {e}");
    }
    let alone = |remove: &mut dyn FnMut()| {
        let _turn = c.turn();
        let _alone = c.no_commits();
        // Who leads no more does not know what others need.
        if c.store.may_change().is_ok() {
            remove();
        }
    };
    match keeping::sweep(&*c.store, &*c.blobs, c.retention.grace, &alone) {
        Ok((0, _)) => {}
        Ok((blobs, bytes)) => {
            let text = format!("{blobs} blobs that nobody needs are removed, {bytes} bytes");
            tracing::info!("{text}");
            c.happened(Happening::of(Kind::Coordinator, text));
        }
        Err(e) => tracing::warn!("blobs that nobody needs are not removed yet: {e}"),
    }
    // Outputs of workers that did not come to commit them.
    if let Some(direct) = c.blobs.direct()
        && c.store.may_change().is_ok()
    {
        match direct.sweep(c.retention.grace) {
            Ok(0) => {}
            Ok(count) => tracing::info!("{count} outputs that were written and not committed are removed"),
            Err(e) => tracing::warn!("outputs that were not committed are not removed yet: {e}"),
        }
    }
}

fn delete(c: &Arc<Coordinator>, job: JobId, why: &str) -> Result<(), Fault> {
    tracing::info!("job {job} is deleted: {why}");
    match deleting::delete(c, job) {
        // Somebody was faster, or it is tried again.
        Ok(_)
        | Err(JobError::Store(StoreError::UnknownJob { .. } | StoreError::IllegalTransition { .. })) => {
            Ok(())
        }
        Err(e) => Err(e.into()),
    }
}

/// Ended jobs and when they ended, the first one first.
fn ended(c: &Coordinator) -> Result<Vec<(u64, JobRecord)>, Fault> {
    let of = |job: JobRecord| job.finished_at_ms.filter(|_| job.state.phase().ended()).map(|at| (at, job));
    let mut ended: Vec<_> = c.store.jobs()?.into_iter().filter_map(of).collect();
    ended.sort_by_key(|(at, job)| (*at, job.id));
    Ok(ended)
}

fn old_jobs(c: &Arc<Coordinator>) -> Result<(), Fault> {
    let Some(keep) = c.retention.keep else { return Ok(()) };
    let before = c.now().unix_ms.saturating_sub(keep.as_millis() as u64);
    for (_, job) in ended(c)?.into_iter().take_while(|(at, _)| *at < before) {
        delete(c, job.id, "it ended longer ago than jobs are kept")?;
    }
    Ok(())
}

fn many_bytes(c: &Arc<Coordinator>) -> Result<(), Fault> {
    let Some(most) = c.retention.keep_bytes else { return Ok(()) };
    let mut scenes: BTreeMap<Digest, u64> = BTreeMap::new();
    for scene in c.store.scenes()? {
        scenes.insert(scene.digest, scene.bytes);
    }
    let ended = ended(c)?;
    let named: BTreeSet<Digest> = ended.iter().map(|(_, job)| job.scene).collect();
    // These do not go with a job.
    let stays = scenes.iter().filter(|(scene, _)| !named.contains(*scene)).map(|(_, bytes)| *bytes);
    let stays = stays.fold(0, u64::saturating_add);
    if stays >= most {
        tracing::warn!("scenes without ended jobs have {stays} bytes, more than are kept: no job is deleted");
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
    let mut sum = of_results.chain(scenes.values().copied()).fold(0, u64::saturating_add);
    for (_, job) in ended {
        if sum <= most {
            break;
        }
        delete(c, job.id, "results and scenes have more bytes than are kept")?;
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
fn old_scenes(c: &Arc<Coordinator>) -> Result<(), Fault> {
    let Some(keep) = c.retention.keep else { return Ok(()) };
    for scene in c.store.scenes()? {
        let written = c.blobs.written(&scene.digest).map_err(KeepingError::from)?;
        // One whose blob is lost can only be sent again.
        if written.is_none_or(|at| at.elapsed().is_ok_and(|age| age >= keep)) {
            match c.store.delete_scene(scene.digest) {
                Ok(_) | Err(StoreError::SceneInUse { .. } | StoreError::UnknownScene { .. }) => {}
                Err(e) => return Err(e.into()),
            }
        }
    }
    Ok(())
}
