//! Simulated workers, which do not compute: they lease tiles and send outputs of random sets as fast as they
//! can.

#![allow(
    clippy::unwrap_used,
    dead_code,
    reason = "helpers of tests, each of which uses a part"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use sightline_model::{CellSet, CellSets, SubtreeNode, TileOutput, codec};
use sightline_proto::chunks::cut;
use sightline_proto::v1;
use sightline_proto::v1::coordinator_message::Message as Heard;
use sightline_proto::v1::worker_message::Message as Said;
use sightline_proto::v1::workers_client::WorkersClient;
use tokio_stream::StreamExt as _;

/// The state that all workers share.
#[derive(Default)]
pub struct Work {
    /// The number of triangles of the scene. Each cell sees a random half of them. 0 for empty sets.
    pub triangles: u32,
    /// The number of accepted outputs.
    pub done: AtomicU64,
    /// The size of the accepted outputs in bytes.
    pub bytes: AtomicU64,
    /// True if the workers should end.
    pub over: AtomicBool,
}

/// Encodes the output of a tile of one cell. The output differs for each tile of each job.
fn output(work: &Work, lease: &v1::Lease) -> Vec<u8> {
    let mut state = lease.job << 32 | u64::from(lease.tile) | 1 << 63;
    let mut bits = 0;
    let visible = (0..work.triangles).filter(|id| {
        if id.is_multiple_of(64) {
            // The generator of Marsaglia 2003, "Xorshift RNGs".
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            bits = state;
        }
        bits >> (id % 64) & 1 == 1
    });
    let cell = CellSet {
        visible: visible.collect(),
        samples: lease.tile,
        ..CellSet::default()
    };
    let sets = CellSets {
        nodes: vec![SubtreeNode::Cell],
        cells: vec![cell],
        ..CellSets::default()
    };
    codec::encode(&TileOutput::Cells(sets)).unwrap()
}

/// Leases and commits tiles of one cell until the work is over, or the coordinator ends the stream. A job may
/// be cancelled or deleted while a worker has its tile; any other rejection is a failure.
pub async fn work(url: &str, name: &str, work: &Work) {
    work_with(url, name, 0, work, &|_| ()).await;
}

/// Runs [`work`] as a worker with an instance number. `before` runs before each tile, with the tile's number.
pub async fn work_with(
    url: &str,
    name: &str,
    instance: u64,
    work: &Work,
    before: &(dyn Fn(u32) + Sync),
) {
    let channel = tonic::transport::Channel::from_shared(url.to_owned())
        .unwrap()
        .connect()
        .await
        .unwrap();
    let mut client = WorkersClient::new(channel);
    let (say, said) = tokio::sync::mpsc::channel(16);
    let send = async |message| {
        say.send(v1::WorkerMessage {
            message: Some(message),
        })
        .await
    };
    let hello = v1::Hello {
        name: name.to_owned(),
        profiles: vec!["cpu/load".to_owned()],
        algorithm: sightline_model::ALGORITHM_VERSION,
        protocol: sightline_proto::PROTOCOL,
        instance,
        ..Default::default()
    };
    send(Said::Hello(hello)).await.unwrap();
    let said = tokio_stream::wrappers::ReceiverStream::new(said);
    let mut heard = client.work(said).await.unwrap().into_inner();
    while !work.over.load(Ordering::Relaxed) {
        let Some(message) = heard.next().await else {
            return;
        };
        match message.unwrap().message.unwrap() {
            Heard::Welcome(_) => {}
            Heard::Grant(grant) => {
                let lease = grant.lease.unwrap();
                before(lease.tile);
                let bytes = output(work, &lease);
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
                match client.put_result(tokio_stream::iter(parts)).await {
                    Ok(_) => {
                        work.done.fetch_add(1, Ordering::Relaxed);
                        work.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
                    }
                    Err(refused) => {
                        let gone = [tonic::Code::NotFound, tonic::Code::FailedPrecondition];
                        assert!(gone.contains(&refused.code()), "{refused}");
                    }
                }
            }
            _ => continue,
        }
        if send(Said::Want(v1::Want { tiles: 1 })).await.is_err() {
            return;
        }
    }
}

/// Starts the given number of workers, and distributes them over the addresses.
pub fn start(
    runtime: &tokio::runtime::Runtime,
    urls: &[&str],
    workers: usize,
    shared: &Arc<Work>,
) -> Vec<tokio::task::JoinHandle<()>> {
    let one = |w: usize| {
        let (url, shared) = (urls[w % urls.len()].to_owned(), Arc::clone(shared));
        runtime.spawn(async move { work(&url, &format!("w{w}"), &shared).await })
    };
    (0..workers).map(one).collect()
}
