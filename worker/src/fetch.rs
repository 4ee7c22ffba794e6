//! Downloads of scenes, packs and receivers. If the coordinator gives an address, the worker reads from the
//! blob store, otherwise from the coordinator. The digest is always checked.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_http::Client;
use sightline_model::receivers::Receivers;
use sightline_proto::chunks::Assembler;
use sightline_proto::v1;
use tonic::{Code, Status, Streaming};

use crate::counters::{BlobRoute, Direction};
use crate::direct::{self, Download, TransferError, UploadBody};
use crate::status::describe;
use crate::tile_runner::TileRunner;
use crate::traced_scenes::TracedScene;

/// Maximum size of a scene or pack that a worker accepts, in bytes.
const MAX_FETCH: u64 = 64 << 30;
/// Maximum number of times that an interrupted download without progress is continued.
const TRIES: u32 = 3;
/// The wait before an interrupted download is continued.
const WAIT: Duration = Duration::from_millis(300);

/// The type of a downloaded blob.
#[derive(Clone, Copy)]
enum FetchKind {
    Scene,
    Pack,
    Receivers,
}

impl FetchKind {
    fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Pack => "pack",
            Self::Receivers => "list of receivers",
        }
    }
}

/// An error of a download.
enum FetchError {
    /// The coordinator rejected the request.
    Refused(Status),
    /// The bytes do not have the requested digest.
    Damaged,
    /// The bytes did not arrive, or arrived in a wrong form.
    Broken(String),
}

impl FetchError {
    fn describe(&self, kind: FetchKind) -> String {
        match self {
            Self::Refused(s) => describe(s),
            Self::Damaged => format!(
                "the received {} does not have the requested digest",
                kind.name()
            ),
            Self::Broken(reason) => reason.clone(),
        }
    }
}

impl TileRunner {
    /// Returns a scene from the cache, the blob store or the coordinator.
    pub async fn scene(&self, digest: [u8; 32]) -> Result<Arc<TracedScene>, String> {
        let fetch = async {
            self.fetch(FetchKind::Scene, digest)
                .await
                .map_err(|e| e.describe(FetchKind::Scene))
        };
        let decode = |bytes: Vec<u8>| TracedScene::decode(&bytes);
        self.config.scenes.get(digest, fetch, decode).await
    }

    /// Returns a pack, or `None` if the coordinator has lost the pack or the bytes are damaged.
    pub async fn pack(&self, digest: [u8; 32]) -> Result<Option<bytes::Bytes>, String> {
        if let Some(pack) = self.packs.get(&digest) {
            return Ok(Some(pack));
        }
        match self.fetch(FetchKind::Pack, digest).await {
            Ok(bytes) => {
                let bytes = bytes::Bytes::from(bytes);
                self.packs.put(digest, bytes.clone());
                Ok(Some(bytes))
            }
            Err(FetchError::Damaged) => Ok(None),
            Err(FetchError::Refused(s)) if matches!(s.code(), Code::NotFound | Code::DataLoss) => {
                Ok(None)
            }
            Err(e) => Err(e.describe(FetchKind::Pack)),
        }
    }

    /// Returns the receivers of a scene with `triangles` triangles, from the cache, the blob store or the
    /// coordinator.
    pub async fn receivers(
        &self,
        digest: [u8; 32],
        triangles: u32,
    ) -> Result<Arc<Receivers>, String> {
        let kind = FetchKind::Receivers;
        let fetch = async { self.fetch(kind, digest).await.map_err(|e| e.describe(kind)) };
        let decode =
            move |bytes: Vec<u8>| Receivers::decode(&bytes, triangles).map_err(|e| e.to_string());
        let key = (digest, triangles);
        self.config.receivers.get(key, fetch, decode).await
    }

    /// Downloads a blob and checks its digest.
    async fn fetch(&self, kind: FetchKind, digest: [u8; 32]) -> Result<Vec<u8>, FetchError> {
        let client = self.direct.client();
        let (first, stream) = self.ask(kind, digest, client.is_some(), false).await?;
        let counters = &self.config.counters;
        let Some((client, address)) = client.zip(first.address.as_ref()) else {
            let bytes = assemble(first, stream, digest).await?;
            counters.transferred(Direction::In, BlobRoute::Coordinator, bytes.len());
            return Ok(bytes);
        };
        let error = match self.read(kind, digest, &client, &first).await {
            Ok(bytes) => {
                counters.transferred(Direction::In, BlobRoute::Direct, bytes.len());
                return Ok(bytes);
            }
            Err(error) => error,
        };
        self.fall_back(
            &error,
            &format!("{} {}", kind.name(), blake3::Hash::from(digest)),
            address,
        );
        let (first, stream) = self.ask(kind, digest, false, true).await?;
        let bytes = assemble(first, stream, digest).await?;
        counters.transferred(Direction::In, BlobRoute::Fallback, bytes.len());
        Ok(bytes)
    }

    /// Requests a blob from the coordinator. Returns the first chunk of the answer.
    async fn ask(
        &self,
        kind: FetchKind,
        digest: [u8; 32],
        direct: bool,
        fell_back: bool,
    ) -> Result<(v1::Chunk, Streaming<v1::Chunk>), FetchError> {
        let (mut client, digest) = (self.client.clone(), digest.to_vec());
        let answer = match kind {
            FetchKind::Scene => {
                client
                    .fetch_scene(v1::FetchSceneRequest {
                        digest,
                        direct,
                        fell_back,
                    })
                    .await
            }
            FetchKind::Pack | FetchKind::Receivers => {
                client
                    .fetch_pack(v1::FetchPackRequest {
                        digest,
                        direct,
                        fell_back,
                    })
                    .await
            }
        };
        let mut stream = answer.map_err(FetchError::Refused)?.into_inner();
        match stream.next().await {
            Some(Ok(first)) => Ok((first, stream)),
            Some(Err(s)) => Err(FetchError::Refused(s)),
            None => Err(FetchError::Broken(
                "the coordinator sent no data; the request is sent again".to_owned(),
            )),
        }
    }

    /// Reads a blob from the blob store. `first` contains its address and its length.
    async fn read(
        &self,
        kind: FetchKind,
        digest: [u8; 32],
        client: &Client<UploadBody>,
        first: &v1::Chunk,
    ) -> Result<Vec<u8>, TransferError> {
        if first.total > MAX_FETCH {
            return Err(TransferError::Blob(format!(
                "the blob has {} bytes; at most {MAX_FETCH} are accepted",
                first.total
            )));
        }
        let mut address = first.address.clone().unwrap_or_default();
        let (mut download, mut asked, mut tries) = (Download::new(first.total), Instant::now(), 0);
        loop {
            let before = download.length();
            let reason = match download.continue_download(client, &address).await {
                Ok(()) => return download.finish(&digest),
                Err(TransferError::Broken(reason)) => reason,
                Err(error) => return Err(error),
            };
            tries = if download.length() > before {
                1
            } else {
                tries + 1
            };
            if tries > TRIES {
                return Err(TransferError::Store(reason));
            }
            tracing::info!(
                "the transfer of the {} stopped after {} of {} bytes ({reason}), and continues \
                 from there",
                kind.name(),
                download.length(),
                first.total
            );
            tokio::time::sleep(WAIT * tries).await;
            if asked.elapsed() > Duration::from_secs(u64::from(address.seconds)) / 2 {
                // The address may have expired.
                let (again, _) = self
                    .ask(kind, digest, true, false)
                    .await
                    .map_err(|e| TransferError::Blob(e.describe(kind)))?;
                let none =
                    || TransferError::Store("the coordinator returned no new address".to_owned());
                (address, asked) = (again.address.ok_or_else(none)?, Instant::now());
            }
        }
    }

    /// Logs that a transfer uses the coordinator instead, and pauses an unreachable store.
    pub fn fall_back(&self, error: &TransferError, what: &str, address: &v1::Address) {
        let (reason, more) = match error {
            TransferError::Store(reason) | TransferError::Broken(reason) => {
                self.direct.pause();
                (
                    reason.as_str(),
                    ", as do all blobs for the next ten minutes",
                )
            }
            TransferError::Blob(reason) => (reason.as_str(), ""),
            TransferError::Cancelled => return,
        };
        tracing::warn!(
            "{what}: the object store at {} is unusable ({reason}); the transfer goes through the \
             coordinator{more}",
            direct::host(address)
        );
    }
}

/// Assembles a blob from the coordinator's chunks and checks its digest.
async fn assemble(
    first: v1::Chunk,
    mut stream: Streaming<v1::Chunk>,
    digest: [u8; 32],
) -> Result<Vec<u8>, FetchError> {
    let broken = |e: &dyn std::fmt::Display| FetchError::Broken(e.to_string());
    let mut whole = Assembler::new(MAX_FETCH);
    whole.push(&first).map_err(|e| broken(&e))?;
    while let Some(chunk) = stream.next().await {
        whole
            .push(&chunk.map_err(FetchError::Refused)?)
            .map_err(|e| broken(&e))?;
    }
    let bytes = whole.finish().map_err(|e| broken(&e))?;
    let checked = tokio::task::spawn_blocking(move || {
        let is_it = *blake3::hash(&bytes).as_bytes() == digest;
        is_it.then_some(bytes)
    });
    checked
        .await
        .map_err(|e| broken(&e))?
        .ok_or(FetchError::Damaged)
}
