//! Tests of outputs that workers write directly to a bucket, on a real server.
//!
//! They cover the checks before a commit, and the removal of rejected objects.

use std::sync::Arc;

use sightline_assemble::OutputError;
use sightline_model::CellSet;
use sightline_records::ids::{Digest, Lease, TileIndex};
use sightline_scheduler::Grant;
use sightline_store::{Address, BlobPlace, MemoryStore, ObjectBlobs, Staged};
use sightline_test_s3::{KEY, S3Server, SECRET};
use sightline_tests::ask;
use tempfile::TempDir;

use crate::clock::ManualClock;
use crate::config::Leases;
use crate::coordinator::Coordinator;
use crate::outputs::commit::{self, OutputBytes, ResultError, SizeLimit, UploadHeader};
use crate::tests::life::{granted, join, output, output_of, two_tiles};

/// A coordinator on a bucket, and two tiles that are granted to a worker.
struct Farm {
    c: Arc<Coordinator>,
    grants: [Grant; 2],
    server: S3Server,
    _folder: TempDir,
}

impl Farm {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let server = S3Server::start(&folder.path().join("s3"), "farm");
        let keys = folder.path().join("keys");
        let text = format!("aws_access_key_id = {KEY}\naws_secret_access_key = {SECRET}\n");
        std::fs::write(&keys, text).unwrap();
        let place = format!(
            "s3://farm/one?endpoint={}&keys={}&direct=yes",
            server.endpoint(),
            keys.display()
        );
        let BlobPlace::Bucket(place) = place.parse().unwrap() else {
            panic!("{place}")
        };
        let blobs = ObjectBlobs::open(&place, &folder.path().join("copies")).unwrap();
        let clock = Box::new(Arc::new(ManualClock::default()));
        let store = Box::new(MemoryStore::new());
        let c = Coordinator::new(Leases::default(), store, Box::new(blobs), clock).unwrap();
        let scene = c.take_scene(&crate::tests::life::triangle()).unwrap();
        two_tiles(&c, scene);
        let (_, mut commands) = join(&c, "a");
        let grants = [granted(&mut commands), granted(&mut commands)];
        Self {
            c,
            grants,
            server,
            _folder: folder,
        }
    }

    /// Returns the number of staged objects next to the blobs.
    fn staged(&self) -> usize {
        self.server.objects("farm/one/staged", "").len()
    }
}

fn staged(lease: Lease, bytes: &[u8]) -> Staged {
    let sha256 = ring::digest::digest(&ring::digest::SHA256, bytes)
        .as_ref()
        .try_into()
        .unwrap();
    Staged {
        lease,
        sha256,
        bytes: bytes.len() as u64,
    }
}

/// Sends a write to an address. Returns the status of the answer.
fn put(address: &Address, bytes: &[u8]) -> u32 {
    let (host, path) = address
        .url
        .strip_prefix("http://")
        .unwrap()
        .split_once('/')
        .unwrap();
    let headers: String = address
        .headers
        .iter()
        .map(|(name, value)| format!("{name}: {value}\r\n"))
        .collect();
    ask(
        &format!("http://{host}"),
        &format!("PUT /{path}"),
        &headers,
        bytes,
    )
    .0
}

/// Writes the bytes of an address.
fn write(address: &Address, bytes: &[u8]) {
    assert_eq!(put(address, bytes), 200);
}

fn commit(c: &Arc<Coordinator>, staged: &Staged, digest: Digest) -> Result<(), ResultError> {
    let announced = UploadHeader {
        lease: staged.lease,
        digest,
        bytes: staged.bytes,
        samples: 1,
        millis: 1,
    };
    commit::put(c, &announced, &OutputBytes::Staged(staged), SizeLimit::Any)
}

#[test]
fn written_output_counts_after_check() {
    let farm = Farm::new();
    let (c, bytes) = (&farm.c, output(&farm.grants[0], &[0]));
    let (upload, digest) = (
        staged(farm.grants[0].lease, &bytes),
        *blake3::hash(&bytes).as_bytes(),
    );
    // The worker has not written the object yet.
    let none = commit(c, &upload, digest).unwrap_err();
    assert!(
        matches!(&none, ResultError::Unstaged(_)) && none.to_string().contains("send the output"),
        "{none}"
    );
    write(&commit::address(c, &upload).unwrap().unwrap(), &bytes);
    assert_eq!((farm.staged(), c.blobs.has(&digest).unwrap()), (1, false));
    let written = c.blobs.carried().unwrap().written;
    commit(c, &upload, digest).unwrap();
    assert_eq!(
        c.blobs.carried().unwrap().written,
        written,
        "the bucket copies it"
    );
    assert_eq!(c.blobs.read(&digest).unwrap(), bytes);
    assert_eq!(farm.staged(), 0);
    // The worker repeats the commit after a lost answer, and has to send the output.
    assert!(matches!(
        commit(c, &upload, digest),
        Err(ResultError::Unstaged(_))
    ));
}

#[test]
fn wrong_output_is_rejected_and_removed() {
    let farm = Farm::new();
    let (c, lease) = (&farm.c, farm.grants[0].lease);
    let unreached = output_of(
        &farm.grants[0],
        &CellSet {
            unreached: true,
            ..CellSet::default()
        },
    );
    let upload = staged(lease, &unreached);
    write(&commit::address(c, &upload).unwrap().unwrap(), &unreached);
    // The output is announced with another digest, and then with its own.
    assert!(matches!(
        commit(c, &upload, [7; 32]),
        Err(ResultError::Digest)
    ));
    assert_eq!(farm.staged(), 0);
    write(&commit::address(c, &upload).unwrap().unwrap(), &unreached);
    let digest = *blake3::hash(&unreached).as_bytes();
    assert!(matches!(
        commit(c, &upload, digest),
        Err(ResultError::Output(OutputError::Viewpoints))
    ));
    assert_eq!((farm.staged(), c.blobs.has(&digest).unwrap()), (0, false));
    // The bytes differ from the signed ones. This server rejects them, but keeps the object.
    let others: Vec<u8> = unreached.iter().map(|byte| byte ^ 1).collect();
    assert_eq!(
        put(&commit::address(c, &upload).unwrap().unwrap(), &others),
        400
    );
    assert_eq!(farm.staged(), 1);
    assert!(matches!(
        commit(c, &upload, digest),
        Err(ResultError::Digest)
    ));
    assert_eq!((farm.staged(), c.blobs.has(&digest).unwrap()), (0, false));
    // The object is longer than announced, so it is read only up to the announced length.
    write(&commit::address(c, &upload).unwrap().unwrap(), &unreached);
    let shorter = Staged { bytes: 3, ..upload };
    assert!(matches!(
        commit(c, &shorter, digest),
        Err(ResultError::Unstaged(_))
    ));
}

#[test]
fn only_lease_holder_may_write_and_only_one_output() {
    let farm = Farm::new();
    let (c, lease) = (&farm.c, farm.grants[0].lease);
    let upload = staged(lease, b"an output");
    assert!(commit::address(c, &upload).unwrap().is_some());
    assert!(
        commit::address(c, &upload).unwrap().is_some(),
        "the answer may have been lost"
    );
    assert!(
        commit::address(c, &staged(lease, b"another"))
            .unwrap()
            .is_none()
    );
    let mut of_nobody = lease;
    of_nobody.id.number += 100;
    assert!(
        commit::address(c, &staged(of_nobody, b"an output"))
            .unwrap()
            .is_none()
    );
    let elsewhere = Lease {
        tile: TileIndex(77),
        ..lease
    };
    assert!(
        commit::address(c, &staged(elsewhere, b"an output"))
            .unwrap()
            .is_none()
    );
    assert!(
        commit::address(
            c,
            &Staged {
                bytes: u64::MAX,
                ..upload
            }
        )
        .unwrap()
        .is_none()
    );
    // Nor does the coordinator read bytes for them.
    let read = c.blobs.carried().unwrap().read;
    assert!(commit(c, &staged(of_nobody, b"an output"), [1; 32]).is_err());
    assert_eq!(c.blobs.carried().unwrap().read, read);
}
