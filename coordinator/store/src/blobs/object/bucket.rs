//! A bucket of an object store, with blocking calls on a separate runtime. Transient faults are retried with
//! growing waits, for a limited time.

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

/// Maximum length of a blob that is written in one request, in bytes. Larger blobs are uploaded in parts.
const WHOLE: u64 = 16 << 20;
/// Minimum length of a part, in bytes.
const PART: u64 = 16 << 20;
/// Maximum number of parts of an upload. The limit of S3 is 10,000.
const PARTS: u64 = 9_000;
/// The number of parts that are sent at the same time.
const AT_ONCE: usize = 4;
/// The maximum number and duration of retries of a request. They cover a restart of the store.
const RETRY: (usize, Duration) = (12, Duration::from_secs(45));
/// The maximum number and duration of retries while the bucket is opened. They are low, so that the operator
/// sees a fault soon.
const FIRST: (usize, Duration) = (3, Duration::from_secs(5));
/// The name prefix of the test object that is written, read and deleted when the bucket is opened.
const PROBE: &str = "probe";

/// A bucket with its client.
pub(super) struct Bucket {
    store: AmazonS3,
    /// The signer of addresses for workers; `None` if workers may not have addresses.
    signer: Option<AmazonS3>,
    /// The certificate authorities from the option `ca=`, as PEM.
    authorities: Vec<u8>,
    name: String,
    prefix: String,
    read: AtomicU64,
    written: AtomicU64,
    // The runtime is `None` only during the drop.
    runtime: Option<Runtime>,
}

impl Bucket {
    /// Creates a client, lists the objects, and writes, reads and deletes a small object.
    ///
    /// # Errors
    /// An error that describes the fault of the settings or of the store.
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
        let make = |builder: &AmazonS3Builder, retry: (usize, Duration)| {
            let builder = builder
                .clone()
                .with_http_connector(client.clone())
                .with_retry(growing_retries(retry.0, retry.1));
            builder
                .build()
                .map_err(|e| faults::blob_error("set up", &name, &e))
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
        // A client without permission to list gets "forbidden" for absent objects.
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
        // Each process uses its own name, because several may start at once, in containers with the same
        // process id.
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
            let (doing, reason) = ("read back", "with other bytes than were written".to_owned());
            return Err(BlobError::Object {
                doing,
                place: self.at(&key),
                reason,
            });
        }
        self.delete(&key)
    }

    /// Returns the key of an object with this name below the prefix.
    pub(super) fn key(&self, name: &str) -> Path {
        // The prefix and the name contain only characters that are valid in a key.
        Path::from(format!("{}/{name}", self.prefix))
    }

    /// Returns the name of the object at a key, for messages.
    pub(super) fn at(&self, key: &Path) -> String {
        let bucket = self
            .name
            .strip_suffix(&self.prefix)
            .unwrap_or(&self.name)
            .trim_end_matches('/');
        format!("{bucket}/{key}")
    }

    /// Runs a future on the calling thread, inside the bucket's runtime, and blocks until its result.
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
                .map_err(|e| faults::blob_error(doing, &self.at(key), &e))
        })
    }

    /// Returns the size of an object in bytes, or `None` if it does not exist.
    pub(super) fn len(&self, key: &Path) -> Result<Option<u64>, BlobError> {
        match self.run("look at", key, self.store.head(key)) {
            Ok(meta) => Ok(Some(meta.size)),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// Returns the write time of an object by the store's clock, or `None` if the object does not exist.
    pub(super) fn written(&self, key: &Path) -> Result<Option<SystemTime>, BlobError> {
        match self.run("look at", key, self.store.head(key)) {
            Ok(meta) => Ok(Some(meta.last_modified.into())),
            Err(BlobError::Missing { .. }) => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// Calls `visit` for the objects below the prefix, or below a folder of it.
    ///
    /// `visit` receives the key, the size in bytes and the write time of an object. The listing ends when
    /// `visit` returns false.
    pub(super) fn list(
        &self,
        folder: Option<&str>,
        mut visit: impl FnMut(&Path, u64, SystemTime) -> bool,
    ) -> Result<(), BlobError> {
        let prefix = folder.map_or_else(
            || Path::from(self.prefix.as_str()),
            |folder| self.key(folder),
        );
        let fault = |e: Error| faults::blob_error("list", &self.at(&prefix), &e);
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

    /// Reads an object piece by piece. An interrupted download continues at its position.
    pub(super) fn get(
        &self,
        key: &Path,
        mut take: impl FnMut(&[u8]) -> Result<(), BlobError>,
    ) -> Result<(), BlobError> {
        let fault = |e: Error| faults::blob_error("read", &self.at(key), &e);
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

    /// Copies an object of at most 5 GiB inside the store. Replaces an existing object.
    pub(super) fn copy(&self, from: &Path, to: &Path) -> Result<(), BlobError> {
        self.run("copy", from, self.store.copy(from, to))
    }

    /// Returns true if workers may have addresses.
    pub(super) fn signs(&self) -> bool {
        self.signer.is_some()
    }

    /// Returns the certificate authorities that are trusted in addition to the system's, as PEM.
    pub(super) fn authorities(&self) -> &[u8] {
        &self.authorities
    }

    /// Returns a signed address for requests of one HTTP method for an object, which is valid for the
    /// duration `lives`.
    pub(super) fn sign(
        &self,
        method: Method,
        key: &Path,
        lives: Duration,
        options: &SignedUrlOptions,
    ) -> Result<String, BlobError> {
        let signer = self.signer.as_ref().ok_or_else(|| BlobError::Unusable {
            place: self.name.clone(),
            reason: "workers may not access this bucket directly (direct=no)".to_owned(),
        })?;
        self.run(
            "sign an address of",
            key,
            signer.signed_url_opts(method, key, lives, options),
        )
        .map(String::from)
    }

    /// Returns the number of bytes of blobs that were read and written.
    pub(super) fn carried(&self) -> Carried {
        let [read, written] = [&self.read, &self.written].map(|n| n.load(Ordering::Relaxed));
        Carried { read, written }
    }

    /// Writes an object from a file of this length. The object appears complete or not at all.
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
                "{e}; the uploaded parts take space until the bucket's rule for unfinished \
                 uploads removes them"
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
        let fault = |e: Error| faults::blob_error("write", &self.at(key), &e);
        self.wait(async {
            let (mut at, mut open) = (0, JoinSet::new());
            while at < length || !open.is_empty() {
                if at < length && open.len() < AT_ONCE {
                    let bytes = part.min(length - at);
                    self.written.fetch_add(bytes, Ordering::Relaxed);
                    open.spawn(upload.put_part(piece(bytes)?.into()));
                    at += bytes;
                } else if let Some(ended) = open.join_next().await {
                    // The remaining uploads are aborted when the set is dropped.
                    ended.map_err(|e| fault(e.into()))?.map_err(fault)?;
                }
            }
            Ok(())
        })
    }

    /// Deletes an object, if it exists.
    pub(super) fn delete(&self, key: &Path) -> Result<(), BlobError> {
        match self.run("delete", key, self.store.delete(key)) {
            Err(BlobError::Missing { .. }) => Ok(()),
            other => other,
        }
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        // The default drop of the runtime would block, which is not allowed on async threads.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Returns retry settings with waits that double.
fn growing_retries(max_retries: usize, retry_timeout: Duration) -> RetryConfig {
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

/// Returns the client settings from the environment, overridden by the settings of `place`.
fn settings(place: &BucketPlace) -> Result<AmazonS3Builder, BlobError> {
    let unusable = |reason: String| BlobError::Unusable {
        place: place.name(),
        reason,
    };
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(&place.bucket)
        .with_checksum_algorithm(Checksum::SHA256)
        // Some stores have no requests that delete many objects, and none is needed here.
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
    // If both variables are set, the S3-specific endpoint takes precedence.
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
    // Roles exist only on Amazon's own machines; elsewhere no service provides their keys.
    if id != secret || !id && endpoint.is_some() && !roles.iter().any(has) {
        let missing = if id {
            "AWS_SECRET_ACCESS_KEY"
        } else {
            "AWS_ACCESS_KEY_ID"
        };
        return Err(unusable(format!(
            "the access keys are incomplete: {missing} is not set"
        )));
    }
    Ok(builder)
}
