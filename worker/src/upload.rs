//! A tile's output on its way to the coordinator: a large one is written to the store of the blobs where the
//! coordinator gives an address, and named; others go in chunks.

use std::time::{Duration, Instant};

use bytes::Bytes;
use sightline_bake::Watcher as _;
use sightline_proto::chunks::{count, piece};
use sightline_proto::v1;
use tonic::Code;

use crate::counters::{Direction, Way};
use crate::direct::{self, Miss};
use crate::leased_tile::LeasedTile;
use crate::status::describe;
use crate::tile_runner::{Failure, TileRunner};

/// The waits after the first failure of an upload and after late ones; they double in between. An output is
/// offered again for as long as its lease lives, whatever the disk or the network does.
const UPLOAD_WAIT: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(10)];
/// How often a wait looks whether the lease still lives.
const LOOK: Duration = Duration::from_millis(250);
/// Smaller outputs are sent in chunks: writing them to the store takes four requests there. A tile of the
/// usual size has half a megabyte.
const LEAST_STAGED: usize = 256 << 10;
/// How often an output is written to the store before it is sent.
const TRIES: u32 = 2;

impl TileRunner {
    /// Commits an output. `attempts` counts the calls that it takes.
    pub async fn upload(
        &self,
        mut header: v1::ResultHeader,
        bytes: Bytes,
        held: &LeasedTile,
        attempts: &mut u32,
    ) -> Result<(), Failure> {
        let mut way = Way::Coordinator;
        match self.stage(&header, &bytes, held).await {
            Ok(Some(sha256)) => (way, header.staged) = (Way::Direct, sha256),
            Ok(None) => {}
            Err(Miss::Cancelled) => return Err(Failure::Cancelled),
            // It was said there.
            Err(_) => (way, header.fell_back) = (Way::Fallback, true),
        }
        let mut wait = UPLOAD_WAIT[0];
        loop {
            if held.cancelled() {
                return Err(Failure::Cancelled);
            }
            *attempts += 1;
            let first = v1::ResultPart {
                part: Some(v1::result_part::Part::Header(header.clone())),
            };
            let body = bytes.clone();
            let chunks = if header.staged.is_empty() {
                count(&body)
            } else {
                0
            };
            // The chunks are made lazily, so only one is in memory at a time.
            let chunks = (0..chunks).map(move |i| v1::ResultPart {
                part: Some(v1::result_part::Part::Chunk(piece(&body, i))),
            });
            let parts = tokio_stream::iter(std::iter::once(first).chain(chunks));
            match self.client.clone().put_result(parts).await {
                Ok(_) => {
                    self.config.counters.moved(Direction::Out, way, bytes.len());
                    return Ok(());
                }
                Err(s) => match s.code() {
                    Code::Aborted | Code::InvalidArgument | Code::OutOfRange => {
                        return Err(Failure::Tile(describe(&s)));
                    }
                    // The job was deleted or has ended, so the tile is not needed any more.
                    Code::NotFound | Code::FailedPrecondition => {
                        return Err(Failure::Cancelled);
                    }
                    Code::DataLoss if !header.staged.is_empty() => {
                        tracing::warn!(
                            "the output of tile {} goes through the coordinator: {}",
                            held.lease.tile,
                            describe(&s)
                        );
                        header.staged.clear();
                        (way, header.fell_back) = (Way::Fallback, true);
                        continue;
                    }
                    _ => tracing::warn!(
                        "the output of tile {} is offered again in {wait:?}: {}",
                        held.lease.tile,
                        describe(&s)
                    ),
                },
            }
            // It is counted once.
            header.fell_back = false;
            // Not the same time on every worker, so that they do not all come back together.
            let end = Instant::now() + wait.mul_f64(jitter(held.lease.lease, wait));
            while Instant::now() < end && !held.cancelled() {
                tokio::time::sleep(LOOK.min(end.saturating_duration_since(Instant::now()))).await;
            }
            wait = (wait * 2).min(UPLOAD_WAIT[1]);
        }
    }

    /// Writes an output to the store of the blobs; gives its SHA-256, by which it is committed. `None` where
    /// it goes in chunks.
    async fn stage(
        &self,
        header: &v1::ResultHeader,
        bytes: &Bytes,
        held: &LeasedTile,
    ) -> Result<Option<Vec<u8>>, Miss> {
        let Some(client) = self.direct.client().filter(|_| bytes.len() >= LEAST_STAGED) else {
            return Ok(None);
        };
        let body = bytes.clone();
        let hash = move || {
            ring::digest::digest(&ring::digest::SHA256, &body)
                .as_ref()
                .to_vec()
        };
        let Ok(sha256) = tokio::task::spawn_blocking(hash).await else {
            return Ok(None);
        };
        let ask = async || {
            let request = v1::StageResultRequest {
                lease: header.lease,
                sha256: sha256.clone(),
                bytes: header.bytes,
            };
            match self.client.clone().stage_result(request).await {
                Ok(answer) => answer.into_inner().address,
                Err(s) => {
                    tracing::warn!(
                        "the output of tile {} is sent: {}",
                        held.lease.tile,
                        describe(&s)
                    );
                    None
                }
            }
        };
        let Some(mut address) = ask().await else {
            return Ok(None);
        };
        let mut tries = 1;
        let miss = loop {
            match direct::upload(&client, &address, bytes.clone(), held).await {
                Ok(()) => return Ok(Some(sha256)),
                Err(Miss::Broken(reason)) if tries < TRIES => {
                    tracing::info!(
                        "the output of tile {} is written again: {reason}",
                        held.lease.tile
                    );
                    tries += 1;
                    // The first one may not be accepted any more.
                    let Some(another) = ask().await else {
                        return Ok(None);
                    };
                    address = another;
                }
                Err(miss) => break miss,
            }
        };
        self.fall_back(
            &miss,
            &format!("the output of tile {}", held.lease.tile),
            &address,
        );
        Err(miss)
    }
}

/// A factor between 0.75 and 1.25 that differs from lease to lease and from wait to wait.
fn jitter(lease: u64, wait: Duration) -> f64 {
    let names = [lease.to_le_bytes(), (wait.as_millis() as u64).to_le_bytes()].concat();
    let [byte, ..] = *blake3::hash(&names).as_bytes();
    0.75 + f64::from(byte) / 512.0
}
