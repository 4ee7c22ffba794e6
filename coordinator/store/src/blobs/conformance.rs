//! The test suite of all blob stores. Random operations are compared with a map, after each operation and at
//! the end.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read as _, Write as _};

use proptest::prelude::*;
use sightline_records::ids::Digest;

use super::object::tests::Served;
use super::*;

#[derive(Clone, Debug)]
enum BlobOp {
    Put(u8),
    PutUnsynced(u8),
    /// A stream of the first blob in pieces of this many bytes, with the digest of the second blob.
    Stream(u8, u8, usize),
    /// A stream that is dropped before it is finished.
    Abandon(u8),
    Remove(u8),
}

/// Returns the bytes of blob `n`. Their length is `n * 37`, so that blob 0 is empty.
fn content(n: u8) -> Vec<u8> {
    (0..usize::from(n) * 37)
        .map(|i| (i as u8).wrapping_mul(n))
        .collect()
}

fn digest(n: u8) -> Digest {
    *blake3::hash(&content(n)).as_bytes()
}

fn step(blobs: &dyn Blobs, model: &mut BTreeMap<u8, Vec<u8>>, op: &BlobOp) {
    match *op {
        BlobOp::Put(n) => {
            assert_eq!(blobs.put(&content(n)).unwrap(), digest(n));
            model.insert(n, content(n));
        }
        BlobOp::PutUnsynced(n) => {
            assert_eq!(blobs.put_unsynced(&content(n)).unwrap(), digest(n));
            model.insert(n, content(n));
        }
        BlobOp::Stream(n, announced, piece) => {
            let mut writer = blobs.put_stream().unwrap();
            for (i, bytes) in content(n).chunks(piece).enumerate() {
                if i % 2 == 0 {
                    writer.append(bytes).unwrap();
                } else {
                    writer.write_all(bytes).unwrap();
                }
            }
            assert_eq!(writer.length(), content(n).len() as u64);
            let finished = writer.finish(Some(&digest(announced)));
            if n == announced {
                assert_eq!(finished.unwrap(), digest(n));
                model.insert(n, content(n));
            } else {
                assert!(matches!(finished, Err(BlobError::Mismatch { .. })));
            }
        }
        BlobOp::Abandon(n) => blobs.put_stream().unwrap().append(&content(n)).unwrap(),
        BlobOp::Remove(n) => assert_eq!(
            blobs.remove(&digest(n)).unwrap(),
            model.remove(&n).is_some()
        ),
    }
}

fn compare(blobs: &dyn Blobs, model: &BTreeMap<u8, Vec<u8>>) {
    for n in 0..4 {
        let expected = model.get(&n);
        assert_eq!(blobs.has(&digest(n)).unwrap(), expected.is_some());
        assert_eq!(
            blobs.len(&digest(n)).unwrap(),
            expected.map(|bytes| bytes.len() as u64)
        );
        match (
            blobs.read(&digest(n)),
            blobs.open_checked(&digest(n)),
            expected,
        ) {
            (Ok(read), Ok(mut opened), Some(expected)) => {
                assert_eq!(&read, expected);
                let mut read = Vec::new();
                opened.bytes.read_to_end(&mut read).unwrap();
                assert_eq!((&read, opened.length), (expected, expected.len() as u64));
            }
            (Err(BlobError::Missing { .. }), Err(BlobError::Missing { .. }), None) => {}
            _ => panic!("blob {n} is not as in the model"),
        }
    }
}

fn op() -> impl Strategy<Value = BlobOp> {
    let n = || 0..4_u8;
    prop_oneof![
        n().prop_map(BlobOp::Put),
        n().prop_map(BlobOp::PutUnsynced),
        (n(), 1..50_usize).prop_map(|(n, piece)| BlobOp::Stream(n, n, piece)),
        (n(), n(), 1..50_usize)
            .prop_map(|(n, announced, piece)| BlobOp::Stream(n, announced, piece)),
        n().prop_map(BlobOp::Abandon),
        n().prop_map(BlobOp::Remove),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(32) })]

    #[test]
    fn blobs_in_memory_and_files_match_model(ops in prop::collection::vec(op(), 1..20)) {
        let directory = tempfile::tempdir().unwrap();
        let files = FileBlobs::open(directory.path()).unwrap();
        let memory = MemoryBlobs::new();
        let stores: [&dyn Blobs; 2] = [&files, &memory];
        for blobs in stores {
            let mut model = BTreeMap::new();
            for op in &ops {
                step(blobs, &mut model, op);
            }
            compare(blobs, &model);
        }
        // A blob in a file survives the store that wrote it.
        let reopened = FileBlobs::open(directory.path()).unwrap();
        for n in 0..4 {
            prop_assert_eq!(reopened.has(&digest(n)).unwrap(), memory.has(&digest(n)).unwrap());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(8) })]

    #[test]
    fn blobs_in_bucket_match_model(ops in prop::collection::vec(op(), 1..20), cache in 0..200_u64) {
        let served = Served::new();
        let blobs = served.open(cache);
        let mut model = BTreeMap::new();
        for op in &ops {
            step(&blobs, &mut model, op);
        }
        compare(&blobs, &model);
        // The bucket contains only the blobs.
        let objects = served.server.objects("farm", "").len();
        prop_assert_eq!(objects, model.len());
        drop(blobs);
        compare(&served.open(cache), &model);
    }
}

#[test]
fn io_error_contains_blob_error() {
    let directory = tempfile::tempdir().unwrap();
    let files = FileBlobs::open(directory.path()).unwrap();
    let memory = MemoryBlobs::new();
    let stores: [&dyn Blobs; 2] = [&files, &memory];
    for blobs in stores {
        let full = |e| matches!(blobs.io_error(e), BlobError::NoSpace { .. });
        assert!(full(ErrorKind::StorageFull.into()) && !full(ErrorKind::PermissionDenied.into()));
        assert!(full(std::io::Error::other(BlobError::NoSpace {
            path: "x".into()
        })));
    }
}
