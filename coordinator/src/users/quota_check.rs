//! Checks of users' quotas, before data of a user is stored.

use std::sync::{MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sightline_store::StoreError;

use crate::coordinator::Coordinator;
use crate::locks::{self, Rank, Ranked};
use crate::quota::{LimitExceeded, Quota, Usage, usage};
use crate::records::JobChanges;
use crate::uploads::chunks::MAX_CHUNKS;

/// Maximum age of the usage count that a new chunk is added to.
const COUNTED_EVERY: Duration = Duration::from_secs(2);

/// The reason why data of a user is not stored.
#[derive(Debug, thiserror::Error)]
pub enum ReservationError {
    /// The data would exceed a limit.
    #[error(transparent)]
    LimitExceeded(#[from] LimitExceeded),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

fn is_bounded(quota: &Quota, owner: &str) -> bool {
    let bounds = [quota.bytes, quota.scenes, quota.jobs, quota.tiles];
    !owner.is_empty() && bounds.iter().any(Option::is_some)
}

/// The right to add to the usage of an owner. While it exists, no other call adds to the usage of an owner
/// with a limit. So the caller checks the usage and records the addition under one lock.
pub(crate) struct QuotaReservation<'c> {
    c: &'c Coordinator,
    owner: String,
    _lock: Option<Ranked<MutexGuard<'c, ()>>>,
}

impl<'c> QuotaReservation<'c> {
    /// Waits for the lock if the owner has a limit. A thread that holds [`JobChanges`] must not call this.
    pub(crate) fn begin(c: &'c Coordinator, owner: &str) -> Self {
        let lock = || locks::lock(Rank::Quota, &c.users.quota);
        Self {
            c,
            owner: owner.to_owned(),
            _lock: is_bounded(&c.config.quotas.for_user(owner), owner).then(lock),
        }
    }

    /// Checks an addition to the usage of the owner. Chunks that do not form a scene yet count, except for
    /// `known` bytes of chunks that become part of the addition.
    ///
    /// # Errors
    /// [`ReservationError`] if the usage would exceed a limit, or the store cannot be read.
    pub(crate) fn reserve(&self, more: Usage, known: u64) -> Result<(), ReservationError> {
        decide(self.c, &self.owner, more, known, Duration::ZERO)
    }

    /// Waits for the lock of the records of jobs, under which the addition is recorded.
    pub(crate) fn job_changes(&self) -> JobChanges<'c> {
        JobChanges::begin(self.c)
    }
}

/// Checks that an owner may upload another chunk of this length. The owner's usage is counted again after two
/// seconds. The number of chunks is limited, too.
pub(crate) fn may_send(c: &Coordinator, owner: &str, bytes: u64) -> Result<(), ReservationError> {
    if !c.uploads.chunks.has_room(owner) {
        let (user, most) = (owner.to_owned(), MAX_CHUNKS as u64);
        let beyond = LimitExceeded::Quota {
            user,
            what: "chunks that are no scene yet",
            most,
            wanted: most + 1,
        };
        c.telemetry.metrics.refused(beyond.name());
        return Err(beyond.into());
    }
    decide(
        c,
        owner,
        Usage {
            bytes,
            ..Usage::default()
        },
        0,
        COUNTED_EVERY,
    )
}

fn decide(
    c: &Coordinator,
    owner: &str,
    more: Usage,
    known: u64,
    old: Duration,
) -> Result<(), ReservationError> {
    let quota = c.config.quotas.for_user(owner);
    if !is_bounded(&quota, owner) {
        return Ok(());
    }
    let has = {
        let mut counted = c
            .users
            .counted
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        match counted.get(owner).filter(|(at, _)| at.elapsed() < old) {
            Some((_, has)) => *has,
            None => {
                let has = usage(c.records.queries(), owner)?;
                counted.retain(|_, (at, _)| at.elapsed() < COUNTED_EVERY);
                counted.insert(owner.to_owned(), (Instant::now(), has));
                has
            }
        }
    };
    let sent = c
        .uploads
        .chunks
        .bytes(owner)
        .saturating_add(c.uploads.unfinished.bytes_of(owner));
    let chunks = Usage {
        bytes: sent.saturating_sub(known),
        ..Usage::default()
    };
    let within = has.and(chunks).and(more).within(&quota, owner);
    Ok(within.inspect_err(|beyond| c.telemetry.metrics.refused(beyond.name()))?)
}
