//! How much two coordinators on one database carry: simulated workers, half of them at the one that leads and
//! half at the one that stands by, that take tiles and send outputs as fast as they can.
//!
//! ```text
//! cargo test --workspace --test replica_load -- --ignored --nocapture
//! ```
//! The whole way is in the figure: gRPC, the passing on, the outputs' checks and files, and the database with
//! its disk. `SIGHTLINE_WORKERS` changes the number of workers (32).

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a measurement")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use sightline_model::{CellSet, CellSets, Node, TileOutput, codec};
use sightline_proto::chunks::cut;
use sightline_proto::v1;
use sightline_proto::v1::coordinator_message::Message as Heard;
use sightline_proto::v1::worker_message::Message as Said;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_tests::{Coordinator, Postgres, Sandbox, wait_for};
use tokio_stream::StreamExt as _;

const JOB: &str = "rooms.glb --cells 64x64x1 --block-cells 1 --backend cpu";
const TILES: u64 = 4096;
/// The last tiles are computed twice, which would count twice.
const ENOUGH: u64 = TILES * 9 / 10;

fn replica<'a>(sandbox: &'a Sandbox, name: &str) -> Coordinator<'a> {
    for folder in ["shared", name] {
        std::fs::create_dir_all(sandbox.path(folder)).unwrap();
    }
    std::os::unix::fs::symlink(sandbox.path("shared"), sandbox.path(name).join("blobs")).unwrap();
    sandbox.serve(name, "--listen 127.0.0.1:0")
}

/// The output of a tile of one cell, another one for each tile.
fn output(tile: u32) -> Vec<u8> {
    let cell = CellSet { samples: tile, ..CellSet::default() };
    let sets = CellSets { nodes: vec![Node::Cell], cells: vec![cell], ..CellSets::default() };
    codec::encode(&TileOutput::Cells(sets)).unwrap()
}

/// Takes and commits tiles until enough are done.
async fn work(url: String, name: String, done: Arc<AtomicU64>) {
    let channel = tonic::transport::Channel::from_shared(url).unwrap().connect().await.unwrap();
    let mut client = WorkersClient::new(channel);
    let (say, said) = tokio::sync::mpsc::channel(16);
    let send = async |message| say.send(v1::WorkerMessage { message: Some(message) }).await.unwrap();
    send(Said::Hello(v1::Hello {
        name,
        profiles: vec!["cpu/load".to_owned()],
        algorithm: sightline_model::ALGORITHM_VERSION,
        ..Default::default()
    }))
    .await;
    let said = tokio_stream::wrappers::ReceiverStream::new(said);
    let mut heard = client.work(said).await.unwrap().into_inner();
    while done.load(Ordering::Relaxed) < ENOUGH {
        match heard.next().await.unwrap().unwrap().message.unwrap() {
            Heard::Welcome(_) => {}
            Heard::Grant(grant) => {
                let lease = grant.lease.unwrap();
                let bytes = output(lease.tile);
                let header = v1::ResultHeader {
                    lease: Some(lease),
                    digest: blake3::hash(&bytes).as_bytes().to_vec(),
                    bytes: bytes.len() as u64,
                    ..Default::default()
                };
                let parts: Vec<_> = std::iter::once(v1::result_part::Part::Header(header))
                    .chain(cut(&bytes).map(v1::result_part::Part::Chunk))
                    .map(|part| v1::ResultPart { part: Some(part) })
                    .collect();
                client.put_result(tokio_stream::iter(parts)).await.unwrap();
                done.fetch_add(1, Ordering::Relaxed);
            }
            _ => continue,
        }
        send(Said::Want(v1::Want { tiles: 1 })).await;
    }
}

#[test]
#[ignore = "a measurement"]
fn leases_and_commits_a_second_at_two_coordinators() {
    let Some(server) = Postgres::start_with("") else { return };
    let mut sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox.set("SIGHTLINE_STORE", server.url());
    let first = replica(&sandbox, "a");
    wait_for("a leader", || first.process.err().contains("this coordinator leads").then_some(()));
    let second = replica(&sandbox, "b");
    let job = second.submit(JOB);
    let workers = std::env::var("SIGHTLINE_WORKERS").map_or(32, |n| n.parse().unwrap());
    let done = Arc::new(AtomicU64::new(0));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let begun = Instant::now();
    runtime.block_on(async {
        let urls = [&first.url, &second.url];
        let working: Vec<_> = (0..workers)
            .map(|w| tokio::spawn(work(urls[w % 2].clone(), format!("w{w}"), Arc::clone(&done))))
            .collect();
        for one in working {
            // The job may be over before the last worker has heard of it.
            if tokio::time::timeout(sightline_tests::LIMIT, one).await.is_err() {
                panic!("a worker hangs");
            }
            if done.load(Ordering::Relaxed) >= ENOUGH {
                break;
            }
        }
    });
    let (took, done) = (begun.elapsed().as_secs_f64(), done.load(Ordering::Relaxed));
    println!("{workers} workers, {done} leases and commits: {:.0} a second", done as f64 / took);
    assert!(second.count(job, "tiles_done") >= ENOUGH);
    drop(runtime);
    // The end of the leader, and the first answer of the one after it.
    let ended = Instant::now();
    first.process.kill();
    wait_for("an answer", || {
        sandbox.run(&format!("jobs --coordinator {}", second.url)).succeeded().then_some(())
    });
    println!("from the leader's end to an answer: {:.1} s", ended.elapsed().as_secs_f64());
}
