//! Tests of blobs in a bucket, against a real server. The server may also die, return wrong bytes or
//! disconnect.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use sightline_test_s3::{KEY, S3Server, SECRET};
use tempfile::TempDir;

use super::*;

/// A server with its folder and a file of keys.
pub(in super::super) struct Served {
    pub(in super::super) server: S3Server,
    folder: TempDir,
}

impl Served {
    pub(in super::super) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let server = S3Server::start(&folder.path().join("s3"), "farm");
        keys(folder.path(), KEY, SECRET);
        Self { server, folder }
    }

    fn text(&self, endpoint: &str, cache: u64) -> String {
        let keys = self.folder.path().join("keys");
        format!(
            "s3://farm/blobs/one?endpoint={endpoint}&keys={}&cache={cache}",
            keys.display()
        )
    }

    fn at(&self, text: &str) -> Result<ObjectBlobs, BlobError> {
        let BlobPlace::Bucket(place) = text.parse().unwrap() else {
            panic!("{text}")
        };
        ObjectBlobs::open(&place, &self.folder.path().join("copies"))
    }

    /// Opens the blobs with a cache of this many bytes.
    pub(in super::super) fn open(&self, cache: u64) -> ObjectBlobs {
        self.at(&self.text(&self.server.endpoint(), cache)).unwrap()
    }

    /// Opens the blobs with a cache of this many bytes, and with addresses for workers.
    pub(super) fn open_direct(&self, cache: u64, direct: &str) -> ObjectBlobs {
        self.at(&format!(
            "{}&direct={direct}",
            self.text(&self.server.endpoint(), cache)
        ))
        .unwrap()
    }

    /// Returns the error for an invalid value of the option `direct`.
    pub(super) fn refused(&self, direct: &str) -> BlobError {
        let text = format!("{}&direct={direct}", self.text(&self.server.endpoint(), 0));
        self.at(&text).err().unwrap()
    }
}

fn keys(folder: &Path, id: &str, secret: &str) {
    let text = format!("[default]\naws_access_key_id = {id}\naws_secret_access_key = {secret}\n");
    std::fs::write(folder.join("keys"), text).unwrap();
}

/// Returns bytes without a pattern that repeats within a part.
fn noise(n: usize) -> Vec<u8> {
    let mut bytes = vec![0; n];
    blake3::Hasher::new().finalize_xof().fill(&mut bytes);
    bytes
}

fn put(blobs: &ObjectBlobs, bytes: &[u8]) -> Digest {
    let mut writer = blobs.put_stream().unwrap();
    bytes
        .chunks(1 << 20)
        .for_each(|piece| writer.append(piece).unwrap());
    writer.finish(None).unwrap()
}

fn flip(path: &Path, at: usize) {
    let mut bytes = std::fs::read(path).unwrap();
    bytes[at] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn large_blob_is_uploaded_in_parts_and_read_back() {
    let served = Served::new();
    let blobs = served.open(0);
    let bytes = noise((40 << 20) + 7);
    let digest = put(&blobs, &bytes);
    assert_eq!(blobs.len(&digest).unwrap(), Some(bytes.len() as u64));
    assert!(blobs.read(&digest).unwrap() == bytes);
    assert_eq!(served.server.open_parts(), 0);
    assert_eq!(served.server.objects("farm", &hex(&digest)).len(), 1);
    // No temporary file is left.
    assert_eq!(
        std::fs::read_dir(served.folder.path().join("copies/tmp"))
            .unwrap()
            .count(),
        0
    );
}

#[test]
fn put_replaces_damaged_object() {
    let served = Served::new();
    let blobs = served.open(0);
    let digest = blobs.put(b"walls and floors").unwrap();
    let [object] = &served.server.objects("farm", &hex(&digest))[..] else {
        panic!("one object")
    };
    flip(object, 3);
    assert!(matches!(
        blobs.read(&digest),
        Err(BlobError::Damaged { .. })
    ));
    assert!(matches!(
        blobs.open_checked(&digest),
        Err(BlobError::Damaged { .. })
    ));
    blobs.put(b"walls and floors").unwrap();
    assert_eq!(blobs.read(&digest).unwrap(), b"walls and floors");
}

#[test]
fn copies_are_read_offline_and_damaged_copies_downloaded() {
    let mut served = Served::new();
    let blobs = served.open(1 << 20);
    let digest = blobs.put(b"walls").unwrap();
    served.server.kill();
    assert_eq!(blobs.read(&digest).unwrap(), b"walls");
    served.server.start_again();
    let name = hex(&digest);
    flip(
        &served
            .folder
            .path()
            .join("copies")
            .join(&name[..2])
            .join(&name[2..4])
            .join(&name),
        0,
    );
    assert_eq!(blobs.read(&digest).unwrap(), b"walls");
    // Another coordinator has no copy, and reads the object.
    drop(blobs);
    std::fs::remove_dir_all(served.folder.path().join("copies")).unwrap();
    assert_eq!(served.open(1 << 20).read(&digest).unwrap(), b"walls");
}

#[test]
fn requests_wait_for_restarting_store() {
    let mut served = Served::new();
    let blobs = served.open(0);
    let digest = blobs.put(b"walls").unwrap();
    served.server.kill();
    thread::scope(|scope| {
        let read = scope.spawn(|| blobs.read(&digest));
        let written = scope.spawn(|| blobs.put(b"doors"));
        thread::sleep(std::time::Duration::from_millis(300));
        served.server.start_again();
        assert_eq!(read.join().unwrap().unwrap(), b"walls");
        let digest = written.join().unwrap().unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), b"doors");
    });
}

/// Forwards connections to a server, and breaks the first `breaks` of them after `after` bytes of answers.
fn breaking(to: SocketAddr, breaks: usize, after: u64) -> (SocketAddr, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, broken) = (
        listener.local_addr().unwrap(),
        Arc::new(AtomicUsize::new(0)),
    );
    let count = Arc::clone(&broken);
    thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            let Ok(server) = TcpStream::connect(to) else {
                return;
            };
            let (mut up, mut down) = (client.try_clone().unwrap(), server.try_clone().unwrap());
            thread::spawn(move || io::copy(&mut up, &mut { server }));
            let count = Arc::clone(&count);
            thread::spawn(move || {
                let mut client = client;
                let room = if count.load(Ordering::Relaxed) < breaks {
                    after
                } else {
                    u64::MAX
                };
                let sent = io::copy(&mut (&mut down).take(room), &mut client);
                if sent.is_ok_and(|sent| sent == room) {
                    count.fetch_add(1, Ordering::Relaxed);
                }
                let _ = client.flush();
                let _ = client.shutdown(std::net::Shutdown::Both);
                let _ = down.shutdown(std::net::Shutdown::Both);
            });
        }
    });
    (address, broken)
}

#[test]
fn interrupted_download_continues_at_its_position() {
    let served = Served::new();
    let bytes = noise(8 << 20);
    let digest = put(&served.open(0), &bytes);
    let (address, broken) = breaking(served.server.address(), 2, 3 << 20);
    let blobs = served
        .at(&served.text(&format!("http://{address}"), 0))
        .unwrap();
    assert!(blobs.read(&digest).unwrap() == bytes);
    assert_eq!(broken.load(Ordering::Relaxed), 2, "it broke off twice");
}

#[test]
fn start_reports_faulty_places_and_never_shows_keys() {
    let served = Served::new();
    let endpoint = served.server.endpoint();
    let said = |text: &str| {
        let e = served.at(text).err().unwrap();
        assert!(!format!("{e} {e:?}").contains(SECRET), "{e}");
        e
    };
    let text = served.text(&endpoint, 0);
    let e = said(&text.replace("//farm", "//other"));
    assert!(
        matches!(&e, BlobError::NoBucket { place } if place.contains("s3://other/blobs/one")),
        "{e}"
    );
    let e = said(&text.replace(&endpoint, "http://127.0.0.1:9"));
    assert!(matches!(&e, BlobError::Unreachable { .. }), "{e}");
    let e = said(&text.replace(&endpoint, "http://192.0.2.1"));
    assert!(
        matches!(&e, BlobError::Unusable { .. }) && e.to_string().contains("not encrypted"),
        "{e}"
    );
    keys(served.folder.path(), KEY, "another-secret");
    let e = said(&text);
    assert!(matches!(&e, BlobError::Refused { .. }), "{e}");
    assert!(!format!("{e} {e:?}").contains("another-secret"), "{e}");
    std::fs::remove_file(served.folder.path().join("keys")).unwrap();
    let e = said(&text);
    assert!(
        matches!(&e, BlobError::Unusable { .. }) && e.to_string().contains("keys"),
        "{e}"
    );
}

#[test]
fn failed_upload_leaves_no_parts() {
    let served = Served::new();
    let blobs = served.open(0);
    let key = object_store::path::Path::from("blobs/one/short");
    // The file is shorter than the announced length.
    let mut file: &[u8] = &noise(20 << 20);
    let e = blobs
        .0
        .bucket
        .put_file(&key, &mut file, 40 << 20)
        .unwrap_err();
    assert!(matches!(e, BlobError::Io { .. }), "{e}");
    assert_eq!(
        (
            served.server.open_parts(),
            blobs.0.bucket.len(&key).unwrap()
        ),
        (0, None)
    );
}
