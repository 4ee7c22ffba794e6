//! Encrypted connections: certificate and key of the coordinator, the authority of workers' certificates, and
//! handshakes, which take no turn of the server. The files can be read again while it serves.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};
use tokio_rustls::server::TlsStream;

/// How long a handshake may take.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Handshakes at a time; further connections wait.
const HANDSHAKES: usize = 1024;
/// Handshakes at a time with one address; further connections from there are closed.
const HANDSHAKES_OF_ADDRESS: usize = 64;
/// Connections whose handshake is over and that wait for the server.
const WAITING: usize = 16;
/// How long to wait when the system has no room for another connection.
const NO_ROOM: Duration = Duration::from_millis(100);

/// Where certificates and keys are, as PEM.
#[derive(Clone, Debug)]
pub struct TlsFiles {
    /// The certificate of the coordinator, and those between it and its authority.
    pub certificate: PathBuf,
    /// Its key.
    pub key: PathBuf,
    /// The authority that signs the certificates of workers; `None` when workers have none.
    pub client_ca: Option<PathBuf>,
}

/// Certificates or keys that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or holds nothing of the kind.
    #[error("{}: {reason}; give {what} as PEM", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wanted of it.
        what: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The parts do not fit together.
    #[error("{} and {} cannot be used together: {reason}", certificate.display(), key.display())]
    Unfit {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// The encryption of a coordinator.
pub struct Tls {
    files: TlsFiles,
    config: RwLock<ServerConfig>,
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn open(files: TlsFiles) -> Result<Self, TlsError> {
        let config = RwLock::new(read(&files)?);
        Ok(Self { files, config })
    }

    /// Reads the files again, for connections from now on. If they cannot be used, nothing changes.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn reload(&self) -> Result<(), TlsError> {
        let config = read(&self.files)?;
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }

    /// Whether certificates of workers are checked.
    pub fn checks_workers(&self) -> bool {
        self.files.client_ca.is_some()
    }

    fn acceptor(&self, protocol: &[u8]) -> TlsAcceptor {
        let mut config = self.config.read().unwrap_or_else(PoisonError::into_inner).clone();
        config.alpn_protocols = vec![protocol.to_vec()];
        TlsAcceptor::from(Arc::new(config))
    }
}

fn certificates(path: &Path, what: &'static str) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let bad = |reason: String| TlsError::File { path: path.to_owned(), what, reason };
    let all: Result<Vec<_>, _> =
        CertificateDer::pem_file_iter(path).map_err(|e| bad(e.to_string()))?.collect();
    let all = all.map_err(|e| bad(e.to_string()))?;
    if all.is_empty() { Err(bad("it holds no certificate".to_owned())) } else { Ok(all) }
}

fn read(files: &TlsFiles) -> Result<ServerConfig, TlsError> {
    let chain = certificates(&files.certificate, "the coordinator's certificate (--tls-cert)")?;
    let key = PrivateKeyDer::from_pem_file(&files.key).map_err(|e| TlsError::File {
        path: files.key.clone(),
        what: "the key of the certificate (--tls-key)",
        reason: e.to_string(),
    })?;
    let unfit = |reason: String| TlsError::Unfit {
        certificate: files.certificate.clone(),
        key: files.key.clone(),
        reason,
    };
    let provider = Arc::new(ring::default_provider());
    let config = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_safe_default_protocol_versions()
        .map_err(|e| unfit(e.to_string()))?;
    let config = match &files.client_ca {
        None => config.with_no_client_auth(),
        Some(path) => {
            let what = "the authority of the workers' certificates (--client-ca)";
            let bad = |reason: String| TlsError::File { path: path.clone(), what, reason };
            let mut roots = RootCertStore::empty();
            for certificate in certificates(path, what)? {
                roots.add(certificate).map_err(|e| bad(e.to_string()))?;
            }
            // Clients with tokens have no certificate; whoever shows one must have a good one.
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider)
                .allow_unauthenticated()
                .build();
            config.with_client_cert_verifier(verifier.map_err(|e| bad(e.to_string()))?)
        }
    };
    config.with_single_cert(chain, key).map_err(|e| unfit(e.to_string()))
}

/// The encrypted connections of a listener, for a protocol. They end when nobody takes them any more.
pub(super) fn connections(
    listener: TcpListener,
    tls: Arc<Tls>,
    protocol: &'static [u8],
) -> mpsc::Receiver<io::Result<TlsStream<TcpStream>>> {
    let (out, stream) = mpsc::channel(WAITING);
    tokio::spawn(async move {
        let shaking = Arc::new(Semaphore::new(HANDSHAKES));
        let from_each: Arc<Mutex<BTreeMap<IpAddr, usize>>> = Arc::default();
        loop {
            let Ok(turn) = Arc::clone(&shaking).acquire_owned().await else { return };
            let accepted = tokio::select! {
                accepted = listener.accept() => accepted,
                () = out.closed() => return,
            };
            let (stream, from) = match accepted {
                Ok(accepted) => accepted,
                Err(e) => {
                    tracing::warn!("a connection was not accepted: {e}");
                    // Not for one that was given up in between.
                    if e.kind() != io::ErrorKind::ConnectionAborted {
                        tokio::time::sleep(NO_ROOM).await;
                    }
                    continue;
                }
            };
            let Some(own) = OneOf::take(&from_each, from.ip()) else { continue };
            let (acceptor, out) = (tls.acceptor(protocol), out.clone());
            tokio::spawn(async move {
                match tokio::time::timeout(HANDSHAKE, shake(&acceptor, stream)).await {
                    // The send fails when the server has ended.
                    Ok(Ok(stream)) => drop(out.send(Ok(stream)).await),
                    Ok(Err(e)) => tracing::debug!("{from} made no encrypted connection: {e}"),
                    Err(_) => tracing::debug!("{from} did not finish its handshake within {HANDSHAKE:?}"),
                }
                drop((turn, own));
            });
        }
    });
    stream
}

/// A handshake among those of its address.
struct OneOf(Arc<Mutex<BTreeMap<IpAddr, usize>>>, IpAddr);

impl OneOf {
    fn take(all: &Arc<Mutex<BTreeMap<IpAddr, usize>>>, from: IpAddr) -> Option<Self> {
        let mut counts = all.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(from).or_default();
        (*count < HANDSHAKES_OF_ADDRESS).then(|| {
            *count += 1;
            Self(Arc::clone(all), from)
        })
    }
}

impl Drop for OneOf {
    fn drop(&mut self) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.1) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.1);
            }
        }
    }
}

async fn shake(acceptor: &TlsAcceptor, stream: TcpStream) -> io::Result<TlsStream<TcpStream>> {
    stream.set_nodelay(true)?;
    acceptor.accept(stream).await
}

/// Encrypted connections for pages.
pub(super) struct Pages {
    pub(super) connections: mpsc::Receiver<io::Result<TlsStream<TcpStream>>>,
    pub(super) address: SocketAddr,
}

impl axum::serve::Listener for Pages {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            match self.connections.recv().await {
                Some(Ok(stream)) => {
                    let from = stream.get_ref().0.peer_addr().unwrap_or(self.address);
                    return (stream, from);
                }
                Some(Err(e)) => tracing::debug!("{e}"),
                // Whoever makes connections has ended with its runtime.
                None => std::future::pending().await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<Self::Addr> {
        Ok(self.address)
    }
}
