//! Whether a user may have more: asked before anything of a user is stored.

use std::sync::{MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sightline_store::StoreError;

use crate::locks::Ranked;
use crate::quota::{LimitExceeded, Quota, Usage, usage};
use crate::state::Coordinator;
use crate::uploads::chunks::MAX_CHUNKS;

/// How old the count may be to which a chunk is added.
const COUNTED_EVERY: Duration = Duration::from_secs(2);

/// Something that is not stored.
#[derive(Debug, thiserror::Error)]
pub enum HavingError {
    /// It would be too much.
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

/// The right to add to what an owner has, who has a bound: until it is recorded.
pub(crate) fn turn_of<'a>(c: &'a Coordinator, owner: &str) -> Option<Ranked<MutexGuard<'a, ()>>> {
    is_bounded(&c.quotas.of(owner), owner).then(|| c.quota_turn())
}

/// Whether an owner may have this, too; nobody may have anything. Chunks that are no scene yet count, but for
/// `known` bytes of them that become what is asked for.
pub(crate) fn reserve_quota(
    c: &Coordinator,
    owner: &str,
    more: Usage,
    known: u64,
) -> Result<(), HavingError> {
    decide(c, owner, more, known, Duration::ZERO)
}

/// Checks that an owner may send another chunk of this length. The owner's usage is counted again after two
/// seconds. Chunks are limited in number, too.
pub(crate) fn may_send(c: &Coordinator, owner: &str, bytes: u64) -> Result<(), HavingError> {
    if !c.uploads.has_room(owner) {
        let (user, most) = (owner.to_owned(), MAX_CHUNKS as u64);
        let beyond = LimitExceeded::Quota {
            user,
            what: "chunks that are no scene yet",
            most,
            wanted: most + 1,
        };
        c.metrics.refused(beyond.name());
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
) -> Result<(), HavingError> {
    let quota = c.quotas.of(owner);
    if !is_bounded(&quota, owner) {
        return Ok(());
    }
    let has = {
        let mut counted = c.counted.lock().unwrap_or_else(PoisonError::into_inner);
        match counted.get(owner).filter(|(at, _)| at.elapsed() < old) {
            Some((_, has)) => *has,
            None => {
                let has = usage(c.store.queries(), owner)?;
                counted.retain(|_, (at, _)| at.elapsed() < COUNTED_EVERY);
                counted.insert(owner.to_owned(), (Instant::now(), has));
                has
            }
        }
    };
    let sent = c
        .uploads
        .bytes(owner)
        .saturating_add(c.unfinished.of(owner));
    let chunks = Usage {
        bytes: sent.saturating_sub(known),
        ..Usage::default()
    };
    let within = has.and(chunks).and(more).within(&quota, owner);
    Ok(within.inspect_err(|beyond| c.metrics.refused(beyond.name()))?)
}
