//! A bucket: objects in and out, by calls that block, on a runtime of their own. Faults that pass are tried
//! again with growing waits, for a while.

use std::io::Read;
use std::path::Path as FilePath;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::StreamExt as _;
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey as Key, Checksum};
use object_store::path::Path;
use object_store::signer::{Method, SignedUrlOptions, Signer as _};
use object_store::{
    BackoffConfig, Error, MultipartUpload, ObjectStore as _, ObjectStoreExt as _, PutPayload,
    RetryConfig,
};
use tokio::runtime::Runtime;
use tokio::task::JoinSet;

use super::super::api::Carried;
use super::super::error::{BlobError, fault};
use super::faults;
use super::http::{Http, authorities};
use super::keys::Keys;
use super::place::{BucketPlace, Ways};

/// Blobs up to this are one request; larger ones go up in parts.
const WHOLE: u64 = 16 << 20;
/// Least bytes of a part.
const PART: u64 = 16 << 20;
/// Most parts of an upload. S3 takes 10 000.
const PARTS: u64 = 9_000;
/// Parts that are under way at a time.
const AT_ONCE: usize = 4;
/// Tries of a request, and for how long: a store that starts again is awaited.
const RETRY: (usize, Duration) = (12, Duration::from_secs(45));
/// The same when the coordinator starts, so that whoever starts it sees what is wrong.
const FIRST: (usize, Duration) = (3, Duration::from_secs(5));
/// The name of the object that is written, read and deleted at the start.
const PROBE: &str = "probe";

/// A bucket and a client of it.
pub(super) struct Bucket {
    store: AmazonS3,
    /// Signs addresses for workers, if they may have some.
    signer: Option<AmazonS3>,
    /// The authorities of `ca=`, as PEM.
    authorities: Vec<u8>,
    name: String,
    prefix: String,
    read: AtomicU64,
    written: AtomicU64,
    // Gone only when the bucket is dropped.
    runtime: Option<Runtime>,
}

impl Bucket {
    /// Sets up a client, lists what is there, and writes, reads and deletes a small object.
    ///
    /// # Errors
    /// What is wrong with the settings, or with the store.
    pub(super) fn open(place: &BucketPlace) -> Result<Self, BlobError> {
        let name = place.name();
        let unusable = |reason: String| BlobError::Unusable {
            place: place.name(),
            reason,
        };
        let builder = settings(place)?;
        let authorities = place
            .ca
            .as_deref()
            .map(authorities)
            .transpose()
            .map_err(unusable)?;
        let roots = sightline_http::roots(authorities.as_deref()).map_err(unusable)?;
        let client = Http::new(roots).map_err(unusable)?;
        let make = |builder: &AmazonS3Builder, retry| {
            let builder = builder
                .clone()
                .with_http_connector(client.clone())
                .with_retry(growing(retry));
            builder.build().map_err(|e| faults::of("set up", &name, &e))
        };
        let signer = match &place.direct {
            Ways::Coordinator => None,
            Ways::Endpoint => Some(make(&builder, FIRST)?),
            Ways::Address(address) => {
                place
                    .check(address)
                    .map_err(|e| unusable(format!("direct=: {e}")))?;
                let there = builder
                    .clone()
                    .with_endpoint(address)
                    .with_config(Key::S3Endpoint, address);
                Some(make(&there, FIRST)?)
            }
        };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("object-store")
            .enable_all()
            .build()
            .map_err(fault("start threads for", FilePath::new(&name)))?;
        let mut bucket = Self {
            store: make(&builder, FIRST)?,
            signer,
            authorities: authorities.unwrap_or_default(),
            name: name.clone(),
            prefix: place.prefix.clone(),
            read: AtomicU64::new(0),
            written: AtomicU64::new(0),
            runtime: Some(runtime),
        };
        bucket.probe()?;
        bucket.store = make(&builder, RETRY)?;
        Ok(bucket)
    }

    fn probe(&self) -> Result<(), BlobError> {
        // Who may not list is told of absent objects that they are forbidden.
        let prefix = Path::from(self.prefix.as_str());
        self.run(
            "list",
            &prefix,
            self.store.list_with_delimiter(Some(&prefix)),
        )
        .map_err(|e| match e {
            BlobError::Missing { .. } | BlobError::NoBucket { .. } => BlobError::NoBucket {
                place: self.name.clone(),
            },
            e => e,
        })?;
        // Each process has its own, since several may start at a time, in containers with the same number.
        let own = getrandom::u64().map_err(|e| {
            let reason = format!("no random number for a probe: {e}");
            let place = self.name.clone();
            BlobError::Unusable { place, reason }
        })?;
        let key = self.key(&format!("{PROBE}-{own:016x}"));
        let bytes = Bytes::from_static(b"sightline");
        self.put(&key, bytes.clone())?;
        let mut read = Vec::new();
        self.get(&key, |piece| {
            read.extend_from_slice(piece);
            Ok(())
        })?;
        if read != bytes {
            let (doing, reason) = (
                "read back what was written to",
                "other bytes came back".to_owned(),
            );
            return Err(BlobError::Object {
                doing,
                place: self.at(&key),
                reason,
            });
        }
        self.delete(&key)
    }

    /// The key of something in this place.
    pub(super) fn key(&self, name: &str) -> Path {
        // Both are made of characters that a key may have.
        Path::from(format!("{}/{name}", self.prefix))
    }

    /// What is at a key, for messages.
    pub(super) fn at(&self, key: &Path) -> String {
        let bucket = self
            .name
            .strip_suffix(&self.prefix)
            .unwrap_or(&self.name)
            .trim_end_matches('/');
        format!("{bucket}/{key}")
    }

    /// Runs on the threads of the bucket until it is done.
    fn wait<T>(&self, future: impl Future<Output = Result<T, BlobError>>) -> Result<T, BlobError> {
        let (doing, reason) = ("reach", "the coordinator is stopping".to_owned());
        let gone = || BlobError::Unreachable {
            doing,
            place: self.name.clone(),
            reason,
        };
        self.runtime.as_ref().ok_or_else(gone)?.block_on(future)
    }

    fn run<T>(
        &self,
        doing: &'static str,
        key: &Path,
        future: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, BlobError> {
        self.wait(async {
            future
                .await
                .map_err(|e| faults::of(doing, &self.at(key), &e))
        })
    }

    /// The size of an object; `None` when there is none.
    pub(super) fn len(&self, key: &Path) -> Result<Option<u64>, BlobError> {
        match self.run("look at", key, self.store.head(key)) {
            Ok(meta) => Ok(Some(meta.size)),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// When an object was written, by the clock of the store; `None` when there is none.
    pub(super) fn written(&self, key: &Path) -> Result<Option<SystemTime>, BlobError> {
        match self.run("look at", key, self.store.head(key)) {
            Ok(meta) => Ok(Some(meta.last_modified.into())),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// Calls `visit` for the objects below the prefix, or a folder of it, with the key, the size and the
    /// time when each was written. Ends when it returns false.
    pub(super) fn list(
        &self,
        folder: Option<&str>,
        mut visit: impl FnMut(&Path, u64, SystemTime) -> bool,
    ) -> Result<(), BlobError> {
        let prefix = folder.map_or_else(
            || Path::from(self.prefix.as_str()),
            |folder| self.key(folder),
        );
        let fault = |e: Error| faults::of("list", &self.at(&prefix), &e);
        self.wait(async {
            let mut objects = self.store.list(Some(&prefix));
            while let Some(meta) = objects.next().await {
                let meta = meta.map_err(fault)?;
                if !visit(&meta.location, meta.size, meta.last_modified.into()) {
                    break;
                }
            }
            Ok(())
        })
    }

    /// Reads an object piece by piece. A download that breaks off goes on where it was.
    pub(super) fn get(
        &self,
        key: &Path,
        mut take: impl FnMut(&[u8]) -> Result<(), BlobError>,
    ) -> Result<(), BlobError> {
        let fault = |e: Error| faults::of("read", &self.at(key), &e);
        self.wait(async {
            let mut pieces = self.store.get(key).await.map_err(fault)?.into_stream();
            while let Some(piece) = pieces.next().await {
                let piece = piece.map_err(fault)?;
                self.read.fetch_add(piece.len() as u64, Ordering::Relaxed);
                take(&piece)?;
            }
            Ok(())
        })
    }

    /// Writes a small object.
    pub(super) fn put(&self, key: &Path, bytes: Bytes) -> Result<(), BlobError> {
        self.written
            .fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.run(
            "write",
            key,
            self.store.put(key, PutPayload::from_bytes(bytes)),
        )
        .map(drop)
    }

    /// Has the store copy an object, of at most 5 GiB, over whatever is there.
    pub(super) fn copy(&self, from: &Path, to: &Path) -> Result<(), BlobError> {
        self.run("copy", from, self.store.copy(from, to))
    }

    /// Whether workers may have addresses.
    pub(super) fn signs(&self) -> bool {
        self.signer.is_some()
    }

    /// The authorities that are trusted beside the system's, as PEM.
    pub(super) fn authorities(&self) -> &[u8] {
        &self.authorities
    }

    /// An address for one kind of request about an object.
    pub(super) fn sign(
        &self,
        method: Method,
        key: &Path,
        lives: Duration,
        options: &SignedUrlOptions,
    ) -> Result<String, BlobError> {
        let signer = self.signer.as_ref().ok_or_else(|| BlobError::Unusable {
            place: self.name.clone(),
            reason: "workers have no addresses here".to_owned(),
        })?;
        self.run(
            "sign an address of",
            key,
            signer.signed_url_opts(method, key, lives, options),
        )
        .map(String::from)
    }

    /// The bytes of blobs that were read and written.
    pub(super) fn carried(&self) -> Carried {
        let [read, written] = [&self.read, &self.written].map(|n| n.load(Ordering::Relaxed));
        Carried { read, written }
    }

    /// Writes an object from a file of this length. It is there as a whole or not at all.
    pub(super) fn put_file(
        &self,
        key: &Path,
        file: &mut impl Read,
        length: u64,
    ) -> Result<(), BlobError> {
        let broken = fault("read", FilePath::new("a blob that is uploaded"));
        let mut piece = |bytes: u64| {
            let mut piece = Vec::with_capacity(bytes as usize);
            file.take(bytes).read_to_end(&mut piece).map_err(&broken)?;
            let short = || broken(std::io::ErrorKind::UnexpectedEof.into());
            if piece.len() as u64 == bytes {
                Ok(Bytes::from(piece))
            } else {
                Err(short())
            }
        };
        if length <= WHOLE {
            return self.put(key, piece(length)?);
        }
        let part = PART.max(length.div_ceil(PARTS));
        let mut upload = self.run("begin", key, self.store.put_multipart(key))?;
        let sent = self.send(key, &mut *upload, length, part, &mut piece);
        let done = sent.and_then(|()| self.run("complete", key, upload.complete()).map(drop));
        if done.is_err()
            && let Err(e) = self.run("abort the upload of", key, upload.abort())
        {
            tracing::warn!(
                "{e}; its parts take space until the bucket's rule for unfinished uploads removes them"
            );
        }
        done
    }

    fn send(
        &self,
        key: &Path,
        upload: &mut dyn MultipartUpload,
        length: u64,
        part: u64,
        piece: &mut dyn FnMut(u64) -> Result<Bytes, BlobError>,
    ) -> Result<(), BlobError> {
        let fault = |e: Error| faults::of("write", &self.at(key), &e);
        self.wait(async {
            let (mut at, mut open) = (0, JoinSet::new());
            while at < length || !open.is_empty() {
                if at < length && open.len() < AT_ONCE {
                    let bytes = part.min(length - at);
                    self.written.fetch_add(bytes, Ordering::Relaxed);
                    open.spawn(upload.put_part(piece(bytes)?.into()));
                    at += bytes;
                } else if let Some(ended) = open.join_next().await {
                    // Those that are still under way end with the set.
                    ended.map_err(|e| fault(e.into()))?.map_err(fault)?;
                }
            }
            Ok(())
        })
    }

    /// Deletes an object, whether it is there or not.
    pub(super) fn delete(&self, key: &Path) -> Result<(), BlobError> {
        match self.run("delete", key, self.store.delete(key)) {
            Err(BlobError::Missing { .. }) => Ok(()),
            other => other,
        }
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        // Not by itself: that would wait, which async threads may not.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn growing((max_retries, retry_timeout): (usize, Duration)) -> RetryConfig {
    let (init_backoff, max_backoff) = (Duration::from_millis(100), Duration::from_secs(8));
    RetryConfig {
        backoff: BackoffConfig {
            init_backoff,
            max_backoff,
            base: 2.0,
        },
        max_retries,
        retry_timeout,
    }
}

/// The settings of the environment, and those of the place over them.
fn settings(place: &BucketPlace) -> Result<AmazonS3Builder, BlobError> {
    let unusable = |reason: String| BlobError::Unusable {
        place: place.name(),
        reason,
    };
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(&place.bucket)
        .with_checksum_algorithm(Checksum::SHA256)
        // Not every store has requests that delete many objects; none is needed here.
        .with_disable_bulk_delete(true);
    if let Some(region) = &place.region {
        builder = builder.with_region(region);
    }
    if let Some(endpoint) = &place.endpoint {
        builder = builder
            .with_endpoint(endpoint)
            .with_config(Key::S3Endpoint, endpoint);
    }
    if let Some(path) = &place.keys {
        let Keys { id, secret, token } = Keys::read(path).map_err(|e| unusable(e.to_string()))?;
        builder = builder
            .with_access_key_id(id)
            .with_secret_access_key(secret);
        if let Some(token) = token {
            builder = builder.with_token(token);
        }
    }
    // The one for S3 alone counts where both are there.
    let endpoint = [Key::S3Endpoint, Key::Endpoint]
        .iter()
        .find_map(|key| builder.get_config_value(key));
    if let Some(endpoint) = &endpoint {
        place.check(endpoint).map_err(|e| unusable(e.to_string()))?;
    }
    let has = |key: &Key| builder.get_config_value(key).is_some();
    let [id, secret] = [Key::AccessKeyId, Key::SecretAccessKey].map(|key| has(&key));
    let roles = [
        Key::WebIdentityTokenFile,
        Key::ContainerCredentialsFullUri,
        Key::ContainerCredentialsRelativeUri,
    ];
    // Amazon's own machines have roles; elsewhere nobody would answer for them.
    if id != secret || !id && endpoint.is_some() && !roles.iter().any(has) {
        let missing = if id {
            "AWS_SECRET_ACCESS_KEY"
        } else {
            "AWS_ACCESS_KEY_ID"
        };
        return Err(unusable(format!("there are no keys: {missing} is not set")));
    }
    Ok(builder)
}
