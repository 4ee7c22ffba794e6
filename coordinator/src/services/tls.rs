//! TLS of connections: certificate and key of the coordinator, and the authority of workers' certificates.
//! The files can be read again while the coordinator serves.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};

/// The paths of certificates and keys, in PEM format.
#[derive(Clone, Debug)]
pub struct TlsFiles {
    /// The certificate of the coordinator, with the intermediate certificates of its authority.
    pub certificate: PathBuf,
    /// The private key of the coordinator.
    pub key: PathBuf,
    /// The authority that signs the certificates of workers. `None` if workers have no certificates.
    pub client_ca: Option<PathBuf>,
}

/// An error of certificates or keys.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or does not contain the expected item.
    #[error("{}: {reason}; give {what} as PEM", path.display())]
    File {
        /// The path of the file.
        path: PathBuf,
        /// The expected item of the file.
        what: &'static str,
        /// The reason.
        reason: String,
    },
    /// The certificate and the key do not match.
    #[error("{} and {} cannot be used together: {reason}", certificate.display(), key.display())]
    Unfit {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
        /// The reason.
        reason: String,
    },
}

/// The TLS configuration of a coordinator.
pub struct Tls {
    files: TlsFiles,
    config: RwLock<ServerConfig>,
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError`] if a file cannot be read, or the files do not match.
    pub fn open(files: TlsFiles) -> Result<Self, TlsError> {
        let config = RwLock::new(read(&files)?);
        Ok(Self { files, config })
    }

    /// Reads the files again, for new connections. If they cannot be used, the previous configuration stays.
    ///
    /// # Errors
    /// [`TlsError`] if a file cannot be read, or the files do not match.
    pub fn reload(&self) -> Result<(), TlsError> {
        let config = read(&self.files)?;
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }

    /// Returns true if the coordinator checks certificates of workers.
    pub fn checks_workers(&self) -> bool {
        self.files.client_ca.is_some()
    }

    /// Returns an acceptor of encrypted connections. `protocol` is the name of the protocol in ALPN.
    pub(super) fn acceptor(&self, protocol: &[u8]) -> TlsAcceptor {
        let mut config = self
            .config
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        config.alpn_protocols = vec![protocol.to_vec()];
        TlsAcceptor::from(Arc::new(config))
    }
}

fn certificates(path: &Path, what: &'static str) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let bad = |reason: String| TlsError::File {
        path: path.to_owned(),
        what,
        reason,
    };
    let all: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path)
        .map_err(|e| bad(e.to_string()))?
        .collect();
    let all = all.map_err(|e| bad(e.to_string()))?;
    if all.is_empty() {
        Err(bad("the file contains no certificate".to_owned()))
    } else {
        Ok(all)
    }
}

fn read(files: &TlsFiles) -> Result<ServerConfig, TlsError> {
    let chain = certificates(
        &files.certificate,
        "the coordinator's certificate (--tls-cert)",
    )?;
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
            let bad = |reason: String| TlsError::File {
                path: path.clone(),
                what,
                reason,
            };
            let mut roots = RootCertStore::empty();
            for certificate in certificates(path, what)? {
                roots.add(certificate).map_err(|e| bad(e.to_string()))?;
            }
            // Clients with tokens have no certificate. A client that shows a certificate must have a valid
            // one.
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider)
                .allow_unauthenticated()
                .build();
            config.with_client_cert_verifier(verifier.map_err(|e| bad(e.to_string()))?)
        }
    };
    config
        .with_single_cert(chain, key)
        .map_err(|e| unfit(e.to_string()))
}
