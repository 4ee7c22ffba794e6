//! The usage of a user, counted from the store's records.

use sightline_records::JobState;
use sightline_store::{Queries, StoreError};

use super::{LimitExceeded, Quota};
use crate::jobs::stored_spec;

/// The usage of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Usage {
    pub(crate) bytes: u64,
    pub(crate) scenes: u64,
    pub(crate) jobs: u64,
    pub(crate) tiles: u64,
}

/// Counts the usage of a user from the records. Chunks that are not yet part of a scene do not count.
pub(crate) fn usage(store: &dyn Queries, user: &str) -> Result<Usage, StoreError> {
    let mut usage = Usage::default();
    for scene in store
        .scenes()?
        .into_iter()
        .filter(|scene| scene.owners.contains(user))
    {
        usage.scenes += 1;
        usage.bytes = usage.bytes.saturating_add(scene.bytes);
    }
    for job in store.jobs()?.into_iter().filter(|job| job.owner == user) {
        usage.jobs += 1;
        usage.tiles += u64::from(job.tiles);
        if let JobState::Done { bytes, .. } = job.state {
            usage.bytes = usage.bytes.saturating_add(bytes);
        }
        // If several jobs have the same receivers, each job counts them.
        let receivers = stored_spec::receivers(&job.spec)
            .map_or(0, |ambient| ambient.bytes.unwrap_or_default());
        usage.bytes = usage.bytes.saturating_add(receivers);
    }
    Ok(usage)
}

impl Usage {
    /// Returns the sum of two usages.
    pub(crate) fn and(self, more: Self) -> Self {
        Self {
            bytes: self.bytes.saturating_add(more.bytes),
            scenes: self.scenes + more.scenes,
            jobs: self.jobs + more.jobs,
            tiles: self.tiles + more.tiles,
        }
    }

    /// Checks the usage against the quota of a user.
    ///
    /// # Errors
    /// [`LimitExceeded::Quota`] with the first exceeded limit.
    pub(crate) fn within(self, quota: &Quota, user: &str) -> Result<(), LimitExceeded> {
        let limits = [
            ("bytes", self.bytes, quota.bytes),
            ("scenes", self.scenes, quota.scenes),
            ("jobs", self.jobs, quota.jobs),
            ("tiles", self.tiles, quota.tiles),
        ];
        for (what, wanted, most) in limits {
            if let Some(most) = most.filter(|most| wanted > *most) {
                return Err(LimitExceeded::Quota {
                    user: user.to_owned(),
                    what,
                    most,
                    wanted,
                });
            }
        }
        Ok(())
    }
}
