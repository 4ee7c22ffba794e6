//! Checks that the value of an imported entry fits its key.
//!
//! A checksum does not prove this, because any program that writes a file can compute the checksum. The
//! checks also bound the numbers that determine allocations and the lengths of searches.

use serde::de::DeserializeOwned;
use sightline_records::ids::JobId;
use sightline_records::{
    JobRecord, QuarantineRecord, RetentionStamp, SceneRecord, TileRecord, TrustedSpan,
};
use sightline_records::{
    MAX_IDENTIFIER_BYTES, MAX_NAME_BYTES, MAX_OWNER_BYTES, MAX_SIGNATURE_BYTES, MAX_SPEC_BYTES,
    MAX_TILES,
};

use super::entries::Entry;
use super::error::StoreError;
use super::identity::StoreIdentity;
use super::limits::{check_identifier, check_length, check_name};
use super::table::{decode, key};

/// Maximum number of a job in an imported entry. [`Queries::jobs_before`](super::Queries::jobs_before) counts
/// down through the numbers, and no store has assigned this many.
const MOST_JOBS: u64 = 1 << 24;

/// Checks the key, the texts and the numbers of one imported entry.
pub(super) fn entry(entry: &Entry) -> Result<(), StoreError> {
    let Entry { key: at, value } = entry;
    let is_at = |own: Vec<u8>| {
        if own == *at {
            Ok(())
        } else {
            Err(foreign(at, "the record belongs to another key"))
        }
    };
    match at.first() {
        Some(b's') => is_at(key::scene(&read::<SceneRecord>(entry)?.digest)),
        Some(b'j') => {
            let job = read::<JobRecord>(entry)?;
            check_length("the plan", job.tiles as usize, "tiles", MAX_TILES as usize)?;
            check_length(
                "the job's specification",
                job.spec.len(),
                "bytes",
                MAX_SPEC_BYTES,
            )?;
            check_identifier("the request id", &job.request_id, MAX_IDENTIFIER_BYTES)?;
            check_name("the job's name", &job.name, MAX_NAME_BYTES)?;
            check_name("the user's name", &job.user, MAX_NAME_BYTES)?;
            check_identifier("the owner's name", &job.owner, MAX_OWNER_BYTES)?;
            check_number(at, job.id)?;
            is_at(key::job(job.id))
        }
        Some(b't') => {
            let tile = read::<TileRecord>(entry)?;
            let job = at
                .get(1..9)
                .and_then(|bytes| bytes.try_into().ok())
                .map(u64::from_be_bytes);
            is_at(
                job.map(|job| key::tile(JobId(job), tile.tile))
                    .unwrap_or_default(),
            )
        }
        Some(b'q') => {
            let record = read::<QuarantineRecord>(entry)?;
            check_identifier("the worker's name", &record.worker, MAX_SIGNATURE_BYTES)?;
            is_at(key::quarantined(&record.worker))
        }
        Some(b'k' | b'r' | b'n') => check_number(at, decode::<JobId>(at, value)?),
        Some(b'i') => {
            decode::<StoreIdentity>(at, value)?;
            is_at(key::IDENTITY.to_vec())
        }
        Some(b'c') => {
            let stamp = decode::<RetentionStamp>(at, value)?;
            let begun =
                |span: TrustedSpan| span.begun_ms.max(span.next.map_or(0, |next| next.begun_ms));
            if begun(stamp.jobs).max(begun(stamp.blobs)) > stamp.ran_ms {
                return Err(foreign(
                    at,
                    "a trusted span begins after the end of the run time",
                ));
            }
            is_at(key::RETENTION_STAMP.to_vec())
        }
        Some(b'e') => decode::<u64>(at, value).map(drop),
        _ => Err(foreign(at, "no record has such a key")),
    }
}

fn read<T: DeserializeOwned>(entry: &Entry) -> Result<T, StoreError> {
    decode(&entry.key, &entry.value)
}

fn check_number(at: &[u8], job: JobId) -> Result<(), StoreError> {
    if job.0 > MOST_JOBS {
        return Err(foreign(at, "the number of a job is too large"));
    }
    Ok(())
}

fn foreign(at: &[u8], what: &str) -> StoreError {
    StoreError::Foreign {
        key: at.escape_ascii().to_string(),
        what: what.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use crate::api::Queries as _;
    use proptest::prelude::*;
    use serde_json::Value;

    use super::super::api::Store;
    use super::super::conformance::everything;
    use super::super::memory::MemoryStore;
    use super::super::table::{check, encode};
    use super::*;
    use sightline_records::NextSpan;

    /// Returns every record from the data of an earlier version.
    fn records() -> Vec<Entry> {
        let text = include_str!("../../../tests/earlier/data/001/records.jsonl");
        let entries = text.lines().filter(|line| line.starts_with('['));
        entries
            .map(|line| serde_json::from_str::<(String, String)>(line).unwrap())
            .map(|(key, value)| Entry::parse(&key, &value).unwrap())
            .collect()
    }

    /// Replaces one value of a JSON document: the value with the index `at` in depth-first order.
    fn change(value: &mut Value, at: &mut usize, to: &Value) {
        if *at == 0 {
            *value = to.clone();
        }
        *at = at.wrapping_sub(1);
        match value {
            Value::Array(all) => all.iter_mut().for_each(|one| change(one, at, to)),
            Value::Object(all) => {
                all.remove(if *at == 1 { "state" } else { "" });
                all.values_mut().for_each(|one| change(one, at, to));
            }
            _ => {}
        }
    }

    fn anything() -> impl Strategy<Value = Value> {
        prop_oneof![
            any::<u64>().prop_map(Value::from),
            any::<i64>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            any::<String>().prop_map(Value::from),
            Just(Value::Null),
            Just(serde_json::json!([])),
            Just(serde_json::json!({ "Failed": { "reason": 7 } })),
            Just(Value::from("Done")),
            Just(Value::from(u64::from(u32::MAX))),
        ]
    }

    #[test]
    fn store_imports_records_of_earlier_versions() {
        let store = MemoryStore::new();
        let records = records();
        records.iter().for_each(|record| entry(record).unwrap());
        store.import(records.clone(), true).unwrap();
        assert_eq!(store.entries().unwrap(), records);
        everything(&store);
    }

    #[test]
    fn stamp_with_span_after_its_run_time_is_rejected() {
        let key = key::RETENTION_STAMP.to_vec();
        let mut stamp = RetentionStamp {
            ran_ms: 5,
            ..RetentionStamp::default()
        };
        stamp.jobs.begun_ms = 5;
        let encoded = |stamp: &RetentionStamp| Entry {
            value: encode(&key, stamp).unwrap(),
            key: key.clone(),
        };
        entry(&encoded(&stamp)).unwrap();
        stamp.blobs.begun_ms = 6;
        assert!(matches!(
            entry(&encoded(&stamp)),
            Err(StoreError::Foreign { .. })
        ));
        stamp.blobs.begun_ms = 5;
        stamp.blobs.next = Some(NextSpan {
            begun_ms: 6,
            doubt_ms: 0,
        });
        assert!(matches!(
            entry(&encoded(&stamp)),
            Err(StoreError::Foreign { .. })
        ));
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

        /// Checks that an import of a record with an arbitrary value fails, or leaves a store that works.
        #[test]
        fn no_record_breaks_store(
            which in any::<prop::sample::Index>(),
            mut at in 0_usize..40,
            to in anything(),
        ) {
            let mut records = records();
            let record = which.get(&records).clone();
            let mut value: Value =
                serde_json::from_slice(check(&record.key, &record.value).unwrap()).unwrap();
            change(&mut value, &mut at, &to);
            let Ok(value) = encode(&record.key, &value) else { return Ok(()) };
            records.iter_mut().filter(|r| r.key == record.key).for_each(|r| r.value = value.clone());
            let store = MemoryStore::new();
            if store.import(records, true).is_ok() {
                everything(&store);
                store.begin_epoch().unwrap();
            }
        }

        #[test]
        fn arbitrary_values_are_read_or_rejected(key in "[sjtqkrneix][ -~]{0,20}", value: Vec<u8>) {
            let _ = entry(&Entry { key: key.into_bytes(), value });
        }
    }
}
