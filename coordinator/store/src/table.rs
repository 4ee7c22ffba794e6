//! The encoding of records in an ordered table of bytes: keys, checksummed and versioned values, typed
//! reading.
//!
//! Every store uses one such table, so all stores read and change it with the same code. The layout of a
//! value is `[version u8][crc32c u32 LE][JSON]`. The checksum covers key, version and JSON, so a value under
//! a wrong key is detected like a damaged value. This module neither decides (`rules.rs`) nor writes to a
//! disk.

use std::collections::BTreeMap;

use serde::{Serialize, de::DeserializeOwned};
use sightline_records::ids::{Digest, JobId, TileIndex};
use sightline_records::{JobRecord, QuarantineRecord, RetentionStamp, SceneRecord, TileRecord};

use super::error::StoreError;
use super::identity::StoreIdentity;
use super::journal::Numbers;
use super::limits::check_length;

/// Maximum length of a value, in bytes, because sled's space grows on every overwrite of a large value.
pub(super) const MAX_VALUE_BYTES: usize = 4096;
const VALUE_VERSION: u8 = 1;
const VALUE_HEADER: usize = 5;

pub(super) type Bytes = Vec<u8>;
/// The changes of an event: the new value of each key, `None` for a removed key.
pub(super) type Changes = BTreeMap<Bytes, Option<Bytes>>;

/// An ordered table of bytes.
pub(super) trait Table {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError>;
    /// Returns all entries whose keys begin with `prefix`, ascending.
    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError>;
}

impl Table for BTreeMap<Bytes, Bytes> {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        Ok(BTreeMap::get(self, key).cloned())
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        let from_prefix = self.range(prefix.to_vec()..);
        Ok(from_prefix
            .take_while(|(key, _)| key.starts_with(prefix))
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect())
    }
}

/// A table with changes that are not written to it yet.
pub(super) struct ChangedTable<'a> {
    pub(super) under: &'a dyn Table,
    pub(super) changes: &'a Changes,
}

impl Table for ChangedTable<'_> {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, StoreError> {
        match self.changes.get(key) {
            Some(changed) => Ok(changed.clone()),
            None => self.under.get(key),
        }
    }

    fn scan(&self, prefix: &[u8]) -> Result<Vec<(Bytes, Bytes)>, StoreError> {
        let mut entries: BTreeMap<Bytes, Bytes> = self.under.scan(prefix)?.into_iter().collect();
        for (key, value) in self
            .changes
            .range(prefix.to_vec()..)
            .take_while(|(key, _)| key.starts_with(prefix))
        {
            match value {
                Some(value) => entries.insert(key.clone(), value.clone()),
                None => entries.remove(key),
            };
        }
        Ok(entries.into_iter().collect())
    }
}

/// The keys of the table. The first letter is the kind of record; numbers are big-endian, so that they sort.
pub(super) mod key {
    use super::Bytes;
    use sightline_records::ids::{Digest, JobId, TileIndex};

    pub(crate) const SCENES: &[u8] = b"s";
    pub(crate) const JOBS: &[u8] = b"j";
    pub(crate) const REQUESTS: &[u8] = b"r";
    pub(crate) const EPOCH: &[u8] = b"e";
    pub(crate) const NEXT_JOB: &[u8] = b"n";
    pub(crate) const QUARANTINED: &[u8] = b"q";
    pub(crate) const IDENTITY: &[u8] = b"i";
    pub(crate) const RETENTION_STAMP: &[u8] = b"c";

    fn join(parts: &[&[u8]]) -> Bytes {
        parts.concat()
    }

    pub(crate) fn scene(digest: &Digest) -> Bytes {
        join(&[SCENES, digest])
    }
    pub(crate) fn job(job: JobId) -> Bytes {
        join(&[JOBS, &job.0.to_be_bytes()])
    }
    /// Returns the prefix of the index of jobs by key. Each index key ends with the job's id in eight bytes.
    pub(crate) fn jobs_of_key(key: &Digest) -> Bytes {
        join(&[b"k", key])
    }
    pub(crate) fn job_of_key(key: &Digest, job: JobId) -> Bytes {
        join(&[b"k", key, &job.0.to_be_bytes()])
    }
    pub(crate) fn request(request_id: &str) -> Bytes {
        join(&[REQUESTS, request_id.as_bytes()])
    }
    pub(crate) fn quarantined(worker: &str) -> Bytes {
        join(&[QUARANTINED, worker.as_bytes()])
    }
    pub(crate) fn tiles(job: JobId) -> Bytes {
        join(&[b"t", &job.0.to_be_bytes()])
    }
    pub(crate) fn tile(job: JobId, tile: TileIndex) -> Bytes {
        join(&[b"t", &job.0.to_be_bytes(), &tile.0.to_be_bytes()])
    }
}

fn checksum(key: &[u8], body: &[u8]) -> u32 {
    let crc = crc32c::crc32c(key);
    crc32c::crc32c_append(crc32c::crc32c_append(crc, &[VALUE_VERSION]), body)
}

/// Encodes a record as the value under `key`.
pub(super) fn encode<T: Serialize>(key: &[u8], record: &T) -> Result<Bytes, StoreError> {
    let body = serde_json::to_vec(record).map_err(|e| StoreError::View {
        what: e.to_string(),
    })?;
    check_length(
        "the record",
        VALUE_HEADER + body.len(),
        "bytes",
        MAX_VALUE_BYTES,
    )?;
    let mut value = vec![VALUE_VERSION];
    value.extend(checksum(key, &body).to_le_bytes());
    value.extend(body);
    Ok(value)
}

/// Returns the JSON of a value under `key`, after checks of its version and checksum.
pub(super) fn check<'a>(key: &[u8], value: &'a [u8]) -> Result<&'a [u8], StoreError> {
    let damaged = |what: &str| StoreError::View {
        what: format!("the value under the key {} {what}", key.escape_ascii()),
    };
    let (&version, rest) = value.split_first().ok_or_else(|| damaged("is empty"))?;
    let (crc, body) = rest
        .split_first_chunk::<4>()
        .ok_or_else(|| damaged("is too short"))?;
    if version != VALUE_VERSION {
        return Err(damaged("has another version"));
    }
    if u32::from_le_bytes(*crc) != checksum(key, body) {
        return Err(damaged("does not match its checksum"));
    }
    Ok(body)
}

/// Decodes the record under `key`, after checks of its version and checksum.
pub(super) fn decode<T: DeserializeOwned>(key: &[u8], value: &[u8]) -> Result<T, StoreError> {
    serde_json::from_slice(check(key, value)?).map_err(|e| StoreError::View {
        what: format!(
            "the value under the key {} cannot be decoded: {e}",
            key.escape_ascii()
        ),
    })
}

/// Typed read access to a table.
#[derive(Clone, Copy)]
pub(super) struct View<'a>(pub(super) &'a dyn Table);

impl View<'_> {
    fn one<T: DeserializeOwned>(self, key: &[u8]) -> Result<Option<T>, StoreError> {
        self.0
            .get(key)?
            .map(|value| decode(key, &value))
            .transpose()
    }

    fn all<T: DeserializeOwned>(self, prefix: &[u8]) -> Result<Vec<T>, StoreError> {
        self.0
            .scan(prefix)?
            .iter()
            .map(|(key, value)| decode(key, value))
            .collect()
    }

    /// Returns true if the table contains neither scenes nor jobs.
    pub(super) fn is_empty(self) -> Result<bool, StoreError> {
        Ok(self.0.scan(key::SCENES)?.is_empty() && self.0.scan(key::JOBS)?.is_empty())
    }

    pub(super) fn scene(self, digest: &Digest) -> Result<Option<SceneRecord>, StoreError> {
        self.one(&key::scene(digest))
    }

    pub(super) fn scenes(self) -> Result<Vec<SceneRecord>, StoreError> {
        self.all(key::SCENES)
    }

    pub(super) fn job(self, job: JobId) -> Result<Option<JobRecord>, StoreError> {
        self.one(&key::job(job))
    }

    /// Returns a job, or an error if it does not exist.
    pub(super) fn known_job(self, job: JobId) -> Result<JobRecord, StoreError> {
        self.job(job)?.ok_or(StoreError::UnknownJob { job })
    }

    pub(super) fn jobs(self) -> Result<Vec<JobRecord>, StoreError> {
        self.all(key::JOBS)
    }

    pub(super) fn jobs_before(
        self,
        before: JobId,
        most: usize,
    ) -> Result<(Vec<JobRecord>, bool), StoreError> {
        // Ids are assigned consecutively, so few of them are missing.
        let newest = before.0.min(self.next_job()?.0);
        let mut jobs = Vec::new();
        for id in (1..newest).rev().map(JobId) {
            if jobs.len() == most {
                if self.0.get(&key::job(id))?.is_some() {
                    jobs.reverse();
                    return Ok((jobs, true));
                }
            } else if let Some(job) = self.job(id)? {
                jobs.push(job);
            }
        }
        jobs.reverse();
        Ok((jobs, false))
    }

    pub(super) fn job_by_key(self, digest: &Digest) -> Result<Option<JobRecord>, StoreError> {
        let ids: Vec<JobId> = self.all(&key::jobs_of_key(digest))?;
        ids.into_iter()
            .max()
            .map(|id| self.known_job(id))
            .transpose()
    }

    pub(super) fn job_by_request(self, request_id: &str) -> Result<Option<JobRecord>, StoreError> {
        if request_id.is_empty() {
            return Ok(None);
        }
        let id: Option<JobId> = self.one(&key::request(request_id))?;
        id.map(|id| self.known_job(id)).transpose()
    }

    /// Returns the table keys of the request ids of the submissions that received this job.
    pub(super) fn requests_of(self, job: JobId) -> Result<Vec<Bytes>, StoreError> {
        let mut keys = Vec::new();
        for (key, value) in self.0.scan(key::REQUESTS)? {
            if decode::<JobId>(&key, &value)? == job {
                keys.push(key);
            }
        }
        Ok(keys)
    }

    /// Returns the tiles that have a record, ascending.
    pub(super) fn recorded_tiles(self, job: JobId) -> Result<Vec<TileRecord>, StoreError> {
        self.all(&key::tiles(job))
    }

    pub(super) fn tiles(self, job: JobId) -> Result<Vec<TileRecord>, StoreError> {
        let tiles = self.known_job(job)?.tiles;
        let mut all: Vec<TileRecord> = (0..tiles)
            .map(|tile| TileRecord::open(TileIndex(tile)))
            .collect();
        for record in self.recorded_tiles(job)? {
            if let Some(slot) = all.get_mut(record.tile.at()) {
                *slot = record;
            }
        }
        Ok(all)
    }

    /// Returns a job and one of its tiles, or an error if either does not exist.
    pub(super) fn job_and_tile(
        self,
        job: JobId,
        tile: TileIndex,
    ) -> Result<(JobRecord, TileRecord), StoreError> {
        let record = self.known_job(job)?;
        if tile.0 >= record.tiles {
            return Err(StoreError::UnknownTile {
                job,
                tile,
                tiles: record.tiles,
            });
        }
        let found = self
            .one(&key::tile(job, tile))?
            .unwrap_or_else(|| TileRecord::open(tile));
        Ok((record, found))
    }

    pub(super) fn quarantined(self) -> Result<Vec<QuarantineRecord>, StoreError> {
        self.all(key::QUARANTINED)
    }

    pub(super) fn is_quarantined(self, worker: &str) -> Result<bool, StoreError> {
        Ok(self.0.get(&key::quarantined(worker))?.is_some())
    }

    pub(super) fn identity(self) -> Result<Option<StoreIdentity>, StoreError> {
        self.one(key::IDENTITY)
    }

    pub(super) fn retention_stamp(self) -> Result<Option<RetentionStamp>, StoreError> {
        self.one(key::RETENTION_STAMP)
    }

    pub(super) fn epoch(self) -> Result<u64, StoreError> {
        Ok(self.one(key::EPOCH)?.unwrap_or(0))
    }

    /// Returns the numbers that the store has assigned.
    pub(super) fn numbers(self) -> Result<Numbers, StoreError> {
        Ok(Numbers {
            next_job: self.next_job()?.0,
            epoch: self.epoch()?,
        })
    }

    pub(super) fn next_job(self) -> Result<JobId, StoreError> {
        Ok(self.one(key::NEXT_JOB)?.unwrap_or(JobId(1)))
    }
}
