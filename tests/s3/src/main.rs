//! The server as a process of its own, for tests that stop it or cut it off:
//!
//! `sightline-test-s3 ADDRESS FOLDER BUCKET`
//!
//! It serves until it is killed.

#![allow(clippy::unwrap_used, reason = "a helper of tests")]

use std::io::Write as _;
use std::path::Path;

use sightline_test_s3::S3Server;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, folder, bucket] = &arguments[..] else {
        writeln!(std::io::stderr(), "usage: sightline-test-s3 ADDRESS FOLDER BUCKET").unwrap();
        std::process::exit(2);
    };
    let server = S3Server::start_at(Path::new(folder), bucket, address.parse().unwrap());
    writeln!(std::io::stdout(), "listening on {}", server.address()).unwrap();
    loop {
        std::thread::park();
    }
}
