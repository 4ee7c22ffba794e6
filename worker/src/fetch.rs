//! Scenes, packs and receivers on their way here: from the store of the blobs where the coordinator gives an
//! address, else from the coordinator. Either way their digest is checked.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_http::Client;
use sightline_model::receivers::Receivers;
use sightline_proto::chunks::Assembler;
use sightline_proto::v1;
use tonic::{Code, Status, Streaming};

use crate::counters::{Direction, Way};
use crate::direct::{self, Download, Miss, Sending};
use crate::status::describe;
use crate::tile_runner::TileRunner;
use crate::traced_scenes::TracedScene;

/// Largest scene or pack accepted from a coordinator, in bytes.
const MAX_FETCH: u64 = 64 << 30;
/// How often a download that breaks off is taken up again without having come further.
const TRIES: u32 = 3;
/// The wait before that.
const WAIT: Duration = Duration::from_millis(300);

/// What is fetched.
#[derive(Clone, Copy)]
enum Kind {
    Scene,
    Pack,
    Receivers,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Pack => "pack",
            Self::Receivers => "list of receivers",
        }
    }
}

/// Something that was not fetched.
enum Unfetched {
    /// The coordinator says why.
    Refused(Status),
    /// The bytes are others.
    Damaged,
    /// They did not come, or not as they should.
    Broken(String),
}

impl Unfetched {
    fn describe(&self, kind: Kind) -> String {
        match self {
            Self::Refused(s) => describe(s),
            Self::Damaged => format!("the {} that arrived is not the one asked for", kind.name()),
            Self::Broken(reason) => reason.clone(),
        }
    }
}

impl TileRunner {
    /// A scene, from the cache, the store or the coordinator.
    pub async fn scene(&self, digest: [u8; 32]) -> Result<Arc<TracedScene>, String> {
        let fetch = async {
            self.fetch(Kind::Scene, digest)
                .await
                .map_err(|e| e.describe(Kind::Scene))
        };
        let decode = |bytes: Vec<u8>| TracedScene::decode(&bytes);
        self.config.scenes.get(digest, fetch, decode).await
    }

    /// A pack; `None` when the coordinator has lost it or its bytes are damaged.
    pub async fn pack(&self, digest: [u8; 32]) -> Result<Option<bytes::Bytes>, String> {
        if let Some(pack) = self.packs.get(&digest) {
            return Ok(Some(pack));
        }
        match self.fetch(Kind::Pack, digest).await {
            Ok(bytes) => {
                let bytes = bytes::Bytes::from(bytes);
                self.packs.put(digest, bytes.clone());
                Ok(Some(bytes))
            }
            Err(Unfetched::Damaged) => Ok(None),
            Err(Unfetched::Refused(s)) if matches!(s.code(), Code::NotFound | Code::DataLoss) => {
                Ok(None)
            }
            Err(e) => Err(e.describe(Kind::Pack)),
        }
    }

    /// Receivers on a scene of so many triangles, from the cache, the store or the coordinator.
    pub async fn receivers(
        &self,
        digest: [u8; 32],
        triangles: u32,
    ) -> Result<Arc<Receivers>, String> {
        let kind = Kind::Receivers;
        let fetch = async { self.fetch(kind, digest).await.map_err(|e| e.describe(kind)) };
        let decode =
            move |bytes: Vec<u8>| Receivers::decode(&bytes, triangles).map_err(|e| e.to_string());
        let key = (digest, triangles);
        self.config.receivers.get(key, fetch, decode).await
    }

    /// A blob whose digest is checked.
    async fn fetch(&self, kind: Kind, digest: [u8; 32]) -> Result<Vec<u8>, Unfetched> {
        let client = self.direct.client();
        let (first, stream) = self.ask(kind, digest, client.is_some(), false).await?;
        let counters = &self.config.counters;
        let Some((client, address)) = client.zip(first.address.as_ref()) else {
            let bytes = assemble(first, stream, digest).await?;
            counters.moved(Direction::In, Way::Coordinator, bytes.len());
            return Ok(bytes);
        };
        let miss = match self.read(kind, digest, &client, &first).await {
            Ok(bytes) => {
                counters.moved(Direction::In, Way::Direct, bytes.len());
                return Ok(bytes);
            }
            Err(miss) => miss,
        };
        self.fall_back(
            &miss,
            &format!("{} {}", kind.name(), blake3::Hash::from(digest)),
            address,
        );
        let (first, stream) = self.ask(kind, digest, false, true).await?;
        let bytes = assemble(first, stream, digest).await?;
        counters.moved(Direction::In, Way::Fallback, bytes.len());
        Ok(bytes)
    }

    /// Asks the coordinator for a blob; gives the first chunk of its answer.
    async fn ask(
        &self,
        kind: Kind,
        digest: [u8; 32],
        direct: bool,
        fell_back: bool,
    ) -> Result<(v1::Chunk, Streaming<v1::Chunk>), Unfetched> {
        let (mut client, digest) = (self.client.clone(), digest.to_vec());
        let answer = match kind {
            Kind::Scene => {
                client
                    .fetch_scene(v1::FetchSceneRequest {
                        digest,
                        direct,
                        fell_back,
                    })
                    .await
            }
            Kind::Pack | Kind::Receivers => {
                client
                    .fetch_pack(v1::FetchPackRequest {
                        digest,
                        direct,
                        fell_back,
                    })
                    .await
            }
        };
        let mut stream = answer.map_err(Unfetched::Refused)?.into_inner();
        match stream.next().await {
            Some(Ok(first)) => Ok((first, stream)),
            Some(Err(s)) => Err(Unfetched::Refused(s)),
            None => Err(Unfetched::Broken(
                "the coordinator sent nothing; it is asked again".to_owned(),
            )),
        }
    }

    /// Reads a blob from the store. `first` has its address and its length.
    async fn read(
        &self,
        kind: Kind,
        digest: [u8; 32],
        client: &Client<Sending>,
        first: &v1::Chunk,
    ) -> Result<Vec<u8>, Miss> {
        if first.total > MAX_FETCH {
            return Err(Miss::Blob(format!(
                "it has {} bytes; at most {MAX_FETCH} are accepted",
                first.total
            )));
        }
        let mut address = first.address.clone().unwrap_or_default();
        let (mut download, mut asked, mut tries) = (Download::new(first.total), Instant::now(), 0);
        loop {
            let before = download.length();
            let reason = match download.go_on(client, &address).await {
                Ok(()) => return download.finish(&digest),
                Err(Miss::Broken(reason)) => reason,
                Err(miss) => return Err(miss),
            };
            tries = if download.length() > before {
                1
            } else {
                tries + 1
            };
            if tries > TRIES {
                return Err(Miss::Store(reason));
            }
            tracing::info!(
                "the {} breaks off after {} of {} bytes ({reason}); it goes on from there",
                kind.name(),
                download.length(),
                first.total
            );
            tokio::time::sleep(WAIT * tries).await;
            if asked.elapsed() > Duration::from_secs(u64::from(address.seconds)) / 2 {
                // It may not be accepted any more.
                let (again, _) = self
                    .ask(kind, digest, true, false)
                    .await
                    .map_err(|e| Miss::Blob(e.describe(kind)))?;
                let none = || Miss::Store("the coordinator gives no further address".to_owned());
                (address, asked) = (again.address.ok_or_else(none)?, Instant::now());
            }
        }
    }

    /// Says that something goes through the coordinator after all, and leaves a store alone that cannot be
    /// reached.
    pub fn fall_back(&self, miss: &Miss, what: &str, address: &v1::Address) {
        let (reason, more) = match miss {
            Miss::Store(reason) | Miss::Broken(reason) => {
                self.direct.pause();
                (reason.as_str(), ", and so does everything for ten minutes")
            }
            Miss::Blob(reason) => (reason.as_str(), ""),
            Miss::Cancelled => return,
        };
        tracing::warn!(
            "{what}: the object store at {} does not do ({reason}); it goes through the coordinator{more}",
            direct::host(address)
        );
    }
}

/// A blob from the coordinator, whose digest is checked.
async fn assemble(
    first: v1::Chunk,
    mut stream: Streaming<v1::Chunk>,
    digest: [u8; 32],
) -> Result<Vec<u8>, Unfetched> {
    let broken = |e: &dyn std::fmt::Display| Unfetched::Broken(e.to_string());
    let mut whole = Assembler::new(MAX_FETCH);
    whole.push(&first).map_err(|e| broken(&e))?;
    while let Some(chunk) = stream.next().await {
        whole
            .push(&chunk.map_err(Unfetched::Refused)?)
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
        .ok_or(Unfetched::Damaged)
}
