//! Tags of leases, which prove that a coordinator of this store granted a lease.
//!
//! A tag is a keyed BLAKE3 hash of the lease and its use, under a key of the store. So a coordinator
//! recognises leases of earlier epochs without a record of each, and a client cannot forge a lease. The tag
//! of a helper differs from the tag of the leader, so a helper cannot send the output.

use sightline_proto::v1;
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_store::StoreIdentity;

/// The context string of the key.
const PURPOSE: &str = "sightline 2026-11-28 tags of leases";

/// The use of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LeaseUse {
    /// Permission to compute the tile and to send its output.
    Hold,
    /// Permission to help the holder of the lease.
    Help,
}

/// The key of the tags.
#[derive(Clone)]
pub(crate) struct LeaseTags([u8; 32]);

/// A lease whose tag is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "lease {} of epoch {} on tile {} of job {} was never granted by this coordinator; workers must \
     return leases unchanged",
    lease.id.number,
    lease.id.epoch.0,
    lease.tile,
    lease.job
)]
pub(crate) struct ForgedLease {
    /// The lease that the message names.
    pub(crate) lease: Lease,
}

impl LeaseTags {
    /// Derives the key of a store.
    pub(crate) fn new(identity: &StoreIdentity) -> Self {
        Self(identity.key(PURPOSE))
    }

    /// Returns the wire form of a lease with its tag.
    pub(crate) fn to_wire(&self, lease: &Lease, to: LeaseUse) -> v1::Lease {
        let Lease { job, tile, id } = *lease;
        let tag = self.tag(lease, to);
        v1::Lease {
            job: job.0,
            tile: tile.0,
            epoch: id.epoch.0,
            lease: id.number,
            tag,
        }
    }

    /// Checks the tag of a lease and returns the lease.
    ///
    /// # Errors
    /// [`ForgedLease`] if the tag is wrong.
    pub(crate) fn check(&self, lease: &v1::Lease, to: LeaseUse) -> Result<Lease, ForgedLease> {
        let id = LeaseId {
            epoch: Epoch(lease.epoch),
            number: lease.lease,
        };
        let named = Lease {
            job: JobId(lease.job),
            tile: TileIndex(lease.tile),
            id,
        };
        if self.tag(&named, to) == lease.tag {
            Ok(named)
        } else {
            Err(ForgedLease { lease: named })
        }
    }

    fn tag(&self, lease: &Lease, to: LeaseUse) -> u64 {
        let Lease { job, tile, id } = *lease;
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(&[match to {
            LeaseUse::Hold => 1,
            LeaseUse::Help => 2,
        }]);
        hasher.update(&job.0.to_le_bytes());
        hasher.update(&tile.0.to_le_bytes());
        hasher.update(&id.epoch.0.to_le_bytes());
        hasher.update(&id.number.to_le_bytes());
        let mut tag = [0; 8];
        hasher.finalize_xof().fill(&mut tag);
        u64::from_le_bytes(tag)
    }
}

#[cfg(test)]
mod tests {
    use sightline_numbers::random::SplitMix64;

    use super::*;

    fn lease(job: u64, tile: u32, epoch: u64, number: u64) -> Lease {
        Lease {
            job: JobId(job),
            tile: TileIndex(tile),
            id: LeaseId {
                epoch: Epoch(epoch),
                number,
            },
        }
    }

    #[test]
    fn only_granted_lease_is_accepted_and_only_for_its_use() {
        let identity = StoreIdentity::random().unwrap();
        let tags = LeaseTags::new(&identity);
        let given = lease(3, 5, 2, 7);
        let wire = tags.to_wire(&given, LeaseUse::Hold);
        assert_eq!(tags.check(&wire, LeaseUse::Hold), Ok(given));
        assert_eq!(
            LeaseTags::new(&identity).check(&wire, LeaseUse::Hold),
            Ok(given),
            "a restart keeps the key"
        );
        let others = [
            v1::Lease { job: 4, ..wire },
            v1::Lease { tile: 6, ..wire },
            v1::Lease { epoch: 1, ..wire },
            v1::Lease { lease: 8, ..wire },
            v1::Lease {
                tag: wire.tag ^ 1,
                ..wire
            },
            v1::Lease { tag: 0, ..wire },
            tags.to_wire(&given, LeaseUse::Help),
        ];
        for other in others {
            let refusal = tags.check(&other, LeaseUse::Hold).unwrap_err();
            let text = refusal.to_string();
            assert!(
                text.contains(&format!("tile {} of job {}", other.tile, other.job)),
                "{text}"
            );
        }
        let foreign = LeaseTags::new(&StoreIdentity::random().unwrap());
        assert!(
            foreign.check(&wire, LeaseUse::Hold).is_err(),
            "a lease of another store"
        );
    }

    #[test]
    fn hundred_thousand_random_leases_are_rejected() {
        let tags = LeaseTags::new(&StoreIdentity::random().unwrap());
        let mut random = SplitMix64::named(&[17]);
        for _ in 0..100_000 {
            let [job, tile, epoch, number] = std::array::from_fn(|_| random.bits() % 4);
            let forged = v1::Lease {
                job,
                tile: tile as u32,
                epoch,
                lease: number,
                tag: random.bits(),
            };
            assert!(
                tags.check(&forged, LeaseUse::Hold).is_err()
                    && tags.check(&forged, LeaseUse::Help).is_err()
            );
        }
    }
}
