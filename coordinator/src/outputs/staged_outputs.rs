//! The outputs that workers may write directly to the blob store.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use sightline_records::ids::Lease;
use sightline_store::Staged;

/// The outputs that workers may write at the moment. Each lease has one output, so that a worker cannot fill
/// the blob store.
#[derive(Default)]
pub(crate) struct StagedOutputs(Mutex<BTreeMap<Lease, ([u8; 32], Instant)>>);

impl StagedOutputs {
    /// Reserves an output until the time `until`. Returns true if its lease has no other output.
    pub(crate) fn claims(&self, staged: &Staged, until: Instant) -> bool {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        all.retain(|_, (_, until)| *until > now);
        match all.get(&staged.lease) {
            Some((sha256, _)) if *sha256 != staged.sha256 => false,
            _ => {
                all.insert(staged.lease, (staged.sha256, until));
                true
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use sightline_records::ids::{Epoch, JobId, LeaseId, TileIndex};

    #[test]
    fn lease_has_one_output() {
        let id = LeaseId {
            epoch: Epoch(1),
            number: 1,
        };
        let lease = Lease {
            job: JobId(1),
            tile: TileIndex(0),
            id,
        };
        let staged_with_hash = |sha256| Staged {
            lease,
            sha256: [sha256; 32],
            bytes: 1,
        };
        let (staging, later) = (
            StagedOutputs::default(),
            Instant::now() + Duration::from_secs(60),
        );
        assert!(
            staging.claims(&staged_with_hash(1), later)
                && staging.claims(&staged_with_hash(1), later)
        );
        assert!(!staging.claims(&staged_with_hash(2), later));
        let other = Staged {
            lease: Lease {
                tile: TileIndex(1),
                ..lease
            },
            ..staged_with_hash(2)
        };
        assert!(staging.claims(&other, Instant::now()));
        // The reservation has expired.
        assert!(staging.claims(
            &Staged {
                sha256: [3; 32],
                ..other
            },
            later
        ));
    }
}
