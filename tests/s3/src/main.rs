//! The S3 server as a separate process, for tests that stop it or cut it off.
//!
//! `sightline-test-s3 ADDRESS FOLDER BUCKET`
//!
//! It serves until it is killed.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a helper of tests"
)]

use std::path::Path;

use sightline_test_s3::S3Server;

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, folder, bucket] = &arguments[..] else {
        return Err("usage: sightline-test-s3 ADDRESS FOLDER BUCKET".to_owned());
    };
    let server = S3Server::start_at(Path::new(folder), bucket, address.parse().unwrap());
    println!("listening on {}", server.address());
    loop {
        std::thread::park();
    }
}
