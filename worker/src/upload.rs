//! The upload of a tile's output. A large output is written directly to the blob store if the coordinator
//! gives an address; other outputs are sent in chunks.

use std::time::{Duration, Instant};

use bytes::Bytes;
use sightline_bake::Watcher as _;
use sightline_proto::chunks::{count, piece};
use sightline_proto::v1;
use tonic::Code;

use crate::counters::{BlobRoute, Direction};
use crate::direct::{self, TransferError};
use crate::leased_tile::LeasedTile;
use crate::status::describe;
use crate::tile_runner::{Failure, TileRunner};

/// The minimum and the maximum wait after a failed upload. The wait doubles after each failure. The worker
/// offers an output for as long as the lease is valid, after any fault of the disk or the network.
const UPLOAD_WAIT: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(10)];
/// The interval at which a wait checks that the lease is still valid.
const LOOK: Duration = Duration::from_millis(250);
/// Minimum size of an output that is written to the blob store, in bytes. Smaller outputs are sent in chunks,
/// because writing to the store requires four requests. A tile of the usual size has 0.5 MB.
const LEAST_STAGED: usize = 256 << 10;
/// Maximum number of attempts to write an output to the blob store before it is sent in chunks.
const TRIES: u32 = 2;

impl TileRunner {
    /// Commits an output. Increments `attempts` for each call of PutResult.
    pub async fn upload(
        &self,
        mut header: v1::ResultHeader,
        bytes: Bytes,
        leased: &LeasedTile,
        attempts: &mut u32,
    ) -> Result<(), Failure> {
        let mut route = BlobRoute::Coordinator;
        match self.stage(&header, &bytes, leased).await {
            Ok(Some(sha256)) => (route, header.staged) = (BlobRoute::Direct, sha256),
            Ok(None) => {}
            Err(TransferError::Cancelled) => return Err(Failure::Cancelled),
            // `stage` has logged the reason.
            Err(_) => (route, header.fell_back) = (BlobRoute::Fallback, true),
        }
        let mut wait = UPLOAD_WAIT[0];
        loop {
            if leased.cancelled() {
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
                    self.config
                        .counters
                        .transferred(Direction::Out, route, bytes.len());
                    return Ok(());
                }
                Err(s) => match s.code() {
                    Code::Aborted | Code::InvalidArgument | Code::OutOfRange => {
                        return Err(Failure::Tile(describe(&s)));
                    }
                    // The job was deleted or has ended, so the tile is no longer needed.
                    Code::NotFound | Code::FailedPrecondition => {
                        return Err(Failure::Cancelled);
                    }
                    Code::DataLoss if !header.staged.is_empty() => {
                        tracing::warn!(
                            "the output of tile {} goes through the coordinator: {}",
                            leased.lease.tile,
                            describe(&s)
                        );
                        header.staged.clear();
                        (route, header.fell_back) = (BlobRoute::Fallback, true);
                        continue;
                    }
                    _ => tracing::warn!(
                        "the output of tile {} is sent again in {wait:?}: {}",
                        leased.lease.tile,
                        describe(&s)
                    ),
                },
            }
            // The fallback is counted once.
            header.fell_back = false;
            // The wait differs between workers, so that they do not all retry at once.
            let end = Instant::now() + wait.mul_f64(jitter(leased.lease.lease, wait));
            while Instant::now() < end && !leased.cancelled() {
                tokio::time::sleep(LOOK.min(end.saturating_duration_since(Instant::now()))).await;
            }
            wait = (wait * 2).min(UPLOAD_WAIT[1]);
        }
    }

    /// Writes an output to the blob store, and returns the SHA-256 by which it is committed. Returns `None`
    /// if the output must be sent in chunks.
    async fn stage(
        &self,
        header: &v1::ResultHeader,
        bytes: &Bytes,
        leased: &LeasedTile,
    ) -> Result<Option<Vec<u8>>, TransferError> {
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
                        "the output of tile {} is sent in chunks: {}",
                        leased.lease.tile,
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
        let error = loop {
            match direct::upload(&client, &address, bytes.clone(), leased).await {
                Ok(()) => return Ok(Some(sha256)),
                Err(TransferError::Broken(reason)) if tries < TRIES => {
                    tracing::info!(
                        "the output of tile {} is written again: {reason}",
                        leased.lease.tile
                    );
                    tries += 1;
                    // The first address may have expired.
                    let Some(another) = ask().await else {
                        return Ok(None);
                    };
                    address = another;
                }
                Err(error) => break error,
            }
        };
        self.fall_back(
            &error,
            &format!("the output of tile {}", leased.lease.tile),
            &address,
        );
        Err(error)
    }
}

/// Returns a factor between 0.75 and 1.25 that differs between leases and between waits.
fn jitter(lease: u64, wait: Duration) -> f64 {
    let names = [lease.to_le_bytes(), (wait.as_millis() as u64).to_le_bytes()].concat();
    let [byte, ..] = *blake3::hash(&names).as_bytes();
    0.75 + f64::from(byte) / 512.0
}
