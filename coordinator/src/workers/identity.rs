//! Identities of workers, which distinguish workers with the same name.
//!
//! A worker with a token or a certificate is identified by its user. Every other worker receives a random
//! identity at its first connection, and shows it at later ones. Quarantine and authorship apply to the name
//! together with the identity. So an unknown worker cannot cause the quarantine of a worker with the same
//! name.

use sightline_records::ids::WorkerIdentity;
use sightline_store::{StoreError, StoreIdentity};

use crate::access::Caller;

/// The context string of the key.
const PURPOSE: &str = "sightline 2026-11-28 identities of workers";
/// The length of a proof, in bytes.
const PROOF_BYTES: usize = 16;

/// The key of the proofs of identities.
#[derive(Clone)]
pub(crate) struct IdentityProofs([u8; 32]);

impl IdentityProofs {
    /// Derives the key of a store.
    pub(crate) fn new(identity: &StoreIdentity) -> Self {
        Self(identity.key(PURPOSE))
    }

    /// Returns the identity of a worker, with the bytes that the worker shows next time. A token has
    /// precedence, then a checked certificate, then the shown bytes. A worker that shows no bytes, or wrong
    /// bytes, receives a new identity.
    ///
    /// # Errors
    /// [`StoreError::Random`] if the system has no random numbers.
    pub(crate) fn identify(
        &self,
        caller: &Caller,
        certificate: Option<&[u8]>,
        shown: &[u8],
    ) -> Result<(WorkerIdentity, Vec<u8>), StoreError> {
        let id = match (caller, certificate, self.check(shown)) {
            (Caller::User { name, .. }, ..) => self.derived(b"user", name.as_bytes()),
            (Caller::Nobody, Some(certificate), _) => self.derived(b"cert", certificate),
            (Caller::Nobody, None, Some(id)) => id,
            (Caller::Nobody, None, None) => {
                let drawn = getrandom::u64().map_err(|e| StoreError::Random {
                    what: e.to_string(),
                })?;
                WorkerIdentity(drawn)
            }
        };
        let number = id.0.to_be_bytes();
        Ok((id, number.into_iter().chain(self.proof(number)).collect()))
    }

    /// Derives the identity of a credential. `kind` separates users from certificates.
    fn derived(&self, kind: &[u8; 4], credential: &[u8]) -> WorkerIdentity {
        let mut number = [0; 8];
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher
            .update(kind)
            .update(credential)
            .finalize_xof()
            .fill(&mut number);
        WorkerIdentity(u64::from_be_bytes(number))
    }

    /// Returns the identity in bytes with a correct proof, or `None`.
    fn check(&self, shown: &[u8]) -> Option<WorkerIdentity> {
        let (number, proof) = shown.split_first_chunk::<8>()?;
        let is_right = proof.len() == PROOF_BYTES
            && proof
                .iter()
                .zip(self.proof(*number))
                .fold(0, |differ, (a, b)| differ | (a ^ b))
                == 0;
        is_right.then(|| WorkerIdentity(u64::from_be_bytes(*number)))
    }

    fn proof(&self, number: [u8; 8]) -> [u8; PROOF_BYTES] {
        let mut proof = [0; PROOF_BYTES];
        blake3::Hasher::new_keyed(&self.0)
            .update(&[1])
            .update(&number)
            .finalize_xof()
            .fill(&mut proof);
        proof
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::Scopes;

    fn proofs() -> IdentityProofs {
        IdentityProofs::new(&StoreIdentity::random().unwrap())
    }

    #[test]
    fn worker_without_credentials_keeps_identity_that_it_shows() {
        let proofs = proofs();
        let (first, shown) = proofs.identify(&Caller::Nobody, None, b"").unwrap();
        assert_eq!(
            proofs.identify(&Caller::Nobody, None, &shown).unwrap(),
            (first, shown.clone())
        );
        assert_ne!(
            proofs.identify(&Caller::Nobody, None, b"").unwrap().0,
            first
        );
        for at in 0..shown.len() {
            let mut forged = shown.clone();
            forged[at] ^= 1;
            assert_eq!(proofs.check(&forged), None, "byte {at}");
        }
        assert_eq!(proofs.check(&shown[..8]), None);
        assert_eq!(proofs.check(&[shown.as_slice(), &[0]].concat()), None);
        assert_eq!(super::tests::proofs().check(&shown), None, "another store");
    }

    #[test]
    fn credentials_override_shown_identity() {
        let proofs = proofs();
        let user = |name: &str| Caller::User {
            name: name.to_owned(),
            scopes: Scopes::default(),
        };
        let (ada, shown) = proofs.identify(&user("ada"), None, b"").unwrap();
        assert_eq!(
            proofs.identify(&user("ada"), None, b"nonsense").unwrap().0,
            ada
        );
        assert_ne!(proofs.identify(&user("bob"), None, &shown).unwrap().0, ada);
        let certified = |certificate| {
            proofs
                .identify(&Caller::Nobody, Some(certificate), &shown)
                .unwrap()
                .0
        };
        assert_eq!(certified(b"one"), certified(b"one"));
        assert_ne!(certified(b"one"), certified(b"two"));
        assert_ne!(certified(b"ada"), ada);
    }
}
