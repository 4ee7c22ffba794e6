//! Tags of leases: proofs that a coordinator of this store gave a lease.
//!
//! A tag is a keyed BLAKE3 hash of the lease and its use, under a key of the store. So a coordinator
//! recognises leases of earlier epochs without a record of each, and a client cannot forge one. The tag of a
//! helper differs from the tag of the leader, so that a helper cannot send the output.

use sightline_proto::v1;
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_store::StoreIdentity;

/// The purpose of the key.
const PURPOSE: &str = "sightline 2026-11-28 tags of leases";

/// The use that a lease is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// To compute the tile and to send its output.
    Hold,
    /// To help the holder.
    Help,
}

/// The key of the tags.
#[derive(Clone)]
pub(crate) struct LeaseTags([u8; 32]);

/// A lease whose tag is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "lease {} of epoch {} on tile {} of job {} was never given by this coordinator; workers send leases back \
     as they came",
    lease.id.number,
    lease.id.epoch.0,
    lease.tile,
    lease.job
)]
pub(crate) struct Forged {
    /// The lease as it was named.
    pub(crate) lease: Lease,
}

impl LeaseTags {
    /// Derives the key of a store.
    pub(crate) fn new(identity: &StoreIdentity) -> Self {
        Self(identity.key(PURPOSE))
    }

    /// Returns the wire form of a lease with its tag.
    pub(crate) fn to_wire(&self, lease: &Lease, to: Use) -> v1::Lease {
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

    /// Reads a lease whose tag is right.
    ///
    /// # Errors
    /// [`Forged`] for every other lease.
    pub(crate) fn check(&self, lease: &v1::Lease, to: Use) -> Result<Lease, Forged> {
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
            Err(Forged { lease: named })
        }
    }

    fn tag(&self, lease: &Lease, to: Use) -> u64 {
        let Lease { job, tile, id } = *lease;
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(&[match to {
            Use::Hold => 1,
            Use::Help => 2,
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
    fn only_given_lease_is_accepted_and_only_for_its_use() {
        let identity = StoreIdentity::random().unwrap();
        let tags = LeaseTags::new(&identity);
        let given = lease(3, 5, 2, 7);
        let wire = tags.to_wire(&given, Use::Hold);
        assert_eq!(tags.check(&wire, Use::Hold), Ok(given));
        assert_eq!(
            LeaseTags::new(&identity).check(&wire, Use::Hold),
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
            tags.to_wire(&given, Use::Help),
        ];
        for other in others {
            let refusal = tags.check(&other, Use::Hold).unwrap_err();
            let text = refusal.to_string();
            assert!(
                text.contains(&format!("tile {} of job {}", other.tile, other.job)),
                "{text}"
            );
        }
        let foreign = LeaseTags::new(&StoreIdentity::random().unwrap());
        assert!(
            foreign.check(&wire, Use::Hold).is_err(),
            "a lease of another store"
        );
    }

    #[test]
    fn hundred_thousand_random_leases_are_refused() {
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
                tags.check(&forged, Use::Hold).is_err() && tags.check(&forged, Use::Help).is_err()
            );
        }
    }
}
