//! Named objects below a prefix of a bucket, without a blob store.

use bytes::Bytes;

use super::bucket::Bucket;
use super::place::BucketPlace;
use crate::blobs::error::BlobError;

/// Objects below a prefix, by name. Each object appears complete.
pub struct ObjectFolder(Bucket);

impl ObjectFolder {
    /// Opens the bucket: writes, reads and deletes one small object.
    ///
    /// # Errors
    /// A [`BlobError`] if the settings or the store are unusable.
    pub fn open(place: &BucketPlace) -> Result<Self, BlobError> {
        Bucket::open(place).map(Self)
    }

    /// Returns the name of an object for messages.
    pub fn name(&self, object: &str) -> String {
        self.0.at(&self.0.key(object))
    }

    /// Reads an object, or returns `None` if it does not exist.
    ///
    /// # Errors
    /// A [`BlobError`] if the store does not answer or rejects the request.
    pub fn read(&self, object: &str) -> Result<Option<Vec<u8>>, BlobError> {
        let mut bytes = Vec::new();
        let read = self.0.get(&self.0.key(object), |piece| {
            bytes.extend_from_slice(piece);
            Ok(())
        });
        match read {
            Ok(()) => Ok(Some(bytes)),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// Returns true if an object exists.
    ///
    /// # Errors
    /// A [`BlobError`] if the store does not answer or rejects the request.
    pub fn has(&self, object: &str) -> Result<bool, BlobError> {
        self.0
            .len(&self.0.key(object))
            .map(|length| length.is_some())
    }

    /// Writes an object, and replaces an earlier one.
    ///
    /// # Errors
    /// A [`BlobError`] if the store does not answer or rejects the request.
    pub fn write(&self, object: &str, bytes: Vec<u8>) -> Result<(), BlobError> {
        self.0.put(&self.0.key(object), Bytes::from(bytes))
    }
}
