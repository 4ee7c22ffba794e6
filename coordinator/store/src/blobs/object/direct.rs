//! Signed addresses of a bucket for workers, and the objects that workers write below `staged/` of the
//! prefix.

use std::time::{Duration, SystemTime};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use object_store::path::Path;
use object_store::signer::{HeaderName, HeaderValue, Method, SignedUrlOptions};
use sightline_records::ids::Digest;

use super::super::api::BlobWriter as _;
use super::super::direct::{Address, Direct, Staged};
use super::super::error::BlobError;
use super::ObjectBlobs;

/// The validity of an address. A worker must begin its request in this time; the request may last longer. The
/// clocks of machines may differ by some minutes.
const LIVES: Duration = Duration::from_secs(600);
/// The folder of the objects that workers write.
const STAGED: &str = "staged";

impl ObjectBlobs {
    fn staged(&self, staged: &Staged) -> Path {
        self.0.bucket.key(&format!("{STAGED}/{}", staged.name()))
    }

    fn sign(
        &self,
        method: Method,
        key: &Path,
        headers: &[(&'static str, String)],
    ) -> Result<Address, BlobError> {
        let mut options = SignedUrlOptions::new();
        for (name, value) in headers {
            let value = HeaderValue::from_str(value).map_err(|_| BlobError::Unusable {
                place: self.0.bucket.at(key),
                reason: format!("the header {name} cannot be sent"),
            })?;
            options = options.with_signed_header(HeaderName::from_static(name), value);
        }
        let url = self.0.bucket.sign(method, key, LIVES, &options)?;
        Ok(Address {
            url,
            headers: headers.to_vec(),
            lives: LIVES,
        })
    }
}

impl Direct for ObjectBlobs {
    fn authorities(&self) -> &[u8] {
        self.0.bucket.authorities()
    }

    fn reading(&self, digest: &Digest) -> Result<Address, BlobError> {
        self.sign(Method::GET, &self.key(digest), &[])
    }

    fn writing(&self, staged: &Staged) -> Result<Address, BlobError> {
        // The signed checksum admits only these bytes; a length cannot be signed.
        let checksum = ("x-amz-checksum-sha256", STANDARD.encode(staged.sha256));
        self.sign(Method::PUT, &self.staged(staged), &[checksum])
    }

    fn read_staged(&self, staged: &Staged) -> Result<Vec<u8>, BlobError> {
        let key = self.staged(staged);
        let damaged = || BlobError::Damaged {
            path: self.0.bucket.at(&key).into(),
        };
        let mut bytes = Vec::new();
        self.0.bucket.get(&key, |piece| {
            // Memory grows with the received bytes, and is limited by the announced length.
            if (bytes.len() + piece.len()) as u64 > staged.bytes {
                return Err(damaged());
            }
            bytes.extend_from_slice(piece);
            Ok(())
        })?;
        if bytes.len() as u64 == staged.bytes {
            Ok(bytes)
        } else {
            Err(damaged())
        }
    }

    fn adopt(&self, staged: &Staged, digest: &Digest, bytes: &[u8]) -> Result<(), BlobError> {
        // If the store verifies checksums, the address admitted only bytes with this SHA-256, so the copied
        // bytes are the bytes that were read. Otherwise, the digest of the blob detects a difference at the
        // next read.
        self.0
            .bucket
            .copy(&self.staged(staged), &self.key(digest))?;
        let kept = self.0.cache.files().writer().and_then(|mut writer| {
            writer.append(bytes)?;
            self.0.cache.keep(writer, *digest, bytes.len() as u64)
        });
        if let Err(e) = kept {
            tracing::warn!("{e}; the blob is in the object store, but the cache has no copy");
        }
        Ok(())
    }

    fn discard(&self, staged: &Staged) -> Result<(), BlobError> {
        self.0.bucket.delete(&self.staged(staged))
    }

    fn sweep(&self, is_old: &dyn Fn(SystemTime) -> bool) -> Result<u64, BlobError> {
        let mut old = Vec::new();
        self.0.bucket.list(Some(STAGED), |key, _, written| {
            if is_old(written) {
                old.push(key.clone());
            }
            true
        })?;
        old.iter().try_for_each(|key| self.0.bucket.delete(key))?;
        Ok(old.len() as u64)
    }
}
