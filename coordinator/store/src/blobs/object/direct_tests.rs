//! Tests of the requests that a bucket's signed address permits and rejects, against a real server.

use std::time::{Duration, SystemTime};

use object_store::signer::{Method, SignedUrlOptions};
use sightline_records::ids::{Epoch, JobId, Lease, LeaseId, TileIndex};
use sightline_test_s3::SECRET;
use sightline_tests::ask;

use super::super::direct::{Address, Direct, Staged};
use super::super::{BlobError, Blobs as _};
use super::ObjectBlobs;
use super::tests::Served;

/// Makes a request as a worker does. Returns the status and the body of the answer.
fn request(method: &str, url: &str, headers: &[(&str, String)], body: &[u8]) -> (u32, Vec<u8>) {
    let (host, path) = url
        .strip_prefix("http://")
        .unwrap()
        .split_once('/')
        .unwrap();
    let headers: String = headers
        .iter()
        .map(|(name, value)| format!("{name}: {value}\r\n"))
        .collect();
    ask(
        &format!("http://{host}"),
        &format!("{method} /{path}"),
        &headers,
        body,
    )
}

fn put(address: &Address, body: &[u8]) -> u32 {
    request("PUT", &address.url, &address.headers, body).0
}

fn staged(bytes: &[u8]) -> Staged {
    let id = LeaseId {
        epoch: Epoch(3),
        number: 4,
    };
    let sha256 = ring::digest::digest(&ring::digest::SHA256, bytes)
        .as_ref()
        .try_into()
        .unwrap();
    Staged {
        lease: Lease {
            job: JobId(1),
            tile: TileIndex(2),
            id,
        },
        sha256,
        bytes: bytes.len() as u64,
    }
}

fn direct(blobs: &ObjectBlobs) -> &dyn Direct {
    blobs.direct().unwrap()
}

#[test]
fn bucket_signs_addresses_only_if_configured() {
    let served = Served::new();
    assert!(served.open(0).direct().is_none());
    assert!(served.open_direct(0, "yes").direct().is_some());
}

#[test]
fn address_reads_only_its_blob() {
    let served = Served::new();
    let blobs = served.open_direct(0, "yes");
    let [walls, doors] =
        [&b"walls and floors"[..], b"doors"].map(|bytes| blobs.put(bytes).unwrap());
    let address = direct(&blobs).reading(&walls).unwrap();
    assert_eq!(
        request("GET", &address.url, &[], &[]),
        (200, b"walls and floors".to_vec())
    );
    let from = [("range", "bytes=10-".to_owned())];
    assert_eq!(
        request("GET", &address.url, &from, &[]),
        (206, b"floors".to_vec())
    );
    // The address permits no other request.
    let [one, other] = [walls, doors].map(|digest| sightline_records::ids::hex(&digest));
    let other = address.url.replace(
        &format!("{}/{one}", &one[..2]),
        &format!("{}/{other}", &other[..2]),
    );
    assert_ne!(other, address.url);
    assert_eq!(request("GET", &other, &[], &[]).0, 403);
    for method in ["PUT", "DELETE"] {
        assert_eq!(
            request(method, &address.url, &[], b"fakes").0,
            403,
            "{method}"
        );
    }
    assert_eq!(blobs.read(&walls).unwrap(), b"walls and floors");
    // The address does not contain the secret, and its debug output does not contain the URL.
    assert!(!address.url.contains(SECRET) && !format!("{address:?}").contains("http"));
}

#[test]
fn address_expires() {
    let served = Served::new();
    let blobs = served.open_direct(0, "yes");
    let key = blobs.key(&blobs.put(b"walls").unwrap());
    let options = SignedUrlOptions::new();
    let url = blobs
        .0
        .bucket
        .sign(Method::GET, &key, Duration::from_secs(1), &options)
        .unwrap();
    assert_eq!(request("GET", &url, &[], &[]).0, 200);
    std::thread::sleep(Duration::from_millis(2100));
    assert_eq!(request("GET", &url, &[], &[]).0, 403);
}

#[test]
fn address_uses_host_configured_for_workers() {
    let served = Served::new();
    let blobs = served.open_direct(0, "https://public.example:9000");
    let address = direct(&blobs)
        .reading(&blobs.put(b"walls").unwrap())
        .unwrap();
    assert!(
        address
            .url
            .starts_with("https://public.example:9000/farm/blobs/one/"),
        "another host"
    );
    let e = served.refused("http://192.0.2.1:9000");
    assert!(
        matches!(&e, BlobError::Unusable { .. }) && e.to_string().contains("direct="),
        "{e}"
    );
}

#[test]
fn adopted_output_becomes_blob() {
    let served = Served::new();
    let blobs = served.open_direct(0, "yes");
    let bytes = b"cells and sets";
    let (staged, digest) = (staged(bytes), *blake3::hash(bytes).as_bytes());
    let address = direct(&blobs).writing(&staged).unwrap();
    assert!(matches!(
        direct(&blobs).read_staged(&staged),
        Err(BlobError::Missing { .. })
    ));
    // The address permits only these bytes, with the checksum header.
    for other in [&b"cells and gets"[..], b"cells", b"cells and sets and more"] {
        assert!((400..500).contains(&put(&address, other)), "{other:?}");
    }
    assert!((400..500).contains(&request("PUT", &address.url, &[], bytes).0));
    // Amazon's store discards the rejected bytes. This server stores them, so the coordinator always checks.
    assert_ne!(
        direct(&blobs).read_staged(&staged).ok().as_deref(),
        Some(&bytes[..])
    );
    assert_eq!(put(&address, bytes), 200);
    assert_eq!(request("GET", &address.url, &address.headers, &[]).0, 403);
    assert!(
        !blobs.has(&digest).unwrap(),
        "it counts only when it was checked"
    );
    assert_eq!(direct(&blobs).read_staged(&staged).unwrap(), bytes);
    // The read never returns more bytes than were announced.
    let shorter = Staged { bytes: 5, ..staged };
    assert!(matches!(
        direct(&blobs).read_staged(&shorter),
        Err(BlobError::Damaged { .. })
    ));
    let before = blobs.carried().unwrap();
    direct(&blobs).adopt(&staged, &digest, bytes).unwrap();
    assert_eq!(blobs.carried().unwrap(), before, "the store copies");
    assert_eq!(blobs.read(&digest).unwrap(), bytes);
    direct(&blobs).discard(&staged).unwrap();
    direct(&blobs).discard(&staged).unwrap();
    assert!(matches!(
        direct(&blobs).read_staged(&staged),
        Err(BlobError::Missing { .. })
    ));
    assert_eq!(blobs.read(&digest).unwrap(), bytes);
}

#[test]
fn sweep_removes_uncommitted_outputs() {
    let served = Served::new();
    let blobs = served.open_direct(0, "yes");
    let blob = blobs.put(b"walls").unwrap();
    let staged = staged(b"left");
    assert_eq!(put(&direct(&blobs).writing(&staged).unwrap(), b"left"), 200);
    let mut seen = Vec::new();
    blobs
        .visit(&mut |stored| {
            seen.push(stored.digest);
            true
        })
        .unwrap();
    assert_eq!(seen, [blob], "it is no blob");
    assert_eq!(direct(&blobs).sweep(&|_| false).unwrap(), 0);
    assert!(direct(&blobs).read_staged(&staged).is_ok());
    assert_eq!(
        direct(&blobs)
            .sweep(&|written| written <= SystemTime::now())
            .unwrap(),
        1
    );
    assert!(matches!(
        direct(&blobs).read_staged(&staged),
        Err(BlobError::Missing { .. })
    ));
    assert_eq!(blobs.read(&blob).unwrap(), b"walls");
}
