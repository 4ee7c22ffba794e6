//! The address of a database: parsing, and display without the password.

use std::fmt;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio_postgres::Config;
use tokio_postgres::config::{Host, SslMode, TargetSessionAttrs};
use tokio_postgres_rustls::MakeRustlsConnect;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use crate::error::StoreError;

/// Timeout for making a connection.
const CONNECT: Duration = Duration::from_secs(2);
/// The duration of network silence after which a connection counts as lost.
const SILENCE: Duration = Duration::from_secs(2);

/// The address of a database and its connection settings. The text forms contain no password.
#[derive(Clone)]
pub struct DatabaseAddress {
    config: Config,
    /// The TLS settings; `None` for unencrypted connections.
    tls: Option<MakeRustlsConnect>,
    shown: String,
}

impl DatabaseAddress {
    /// Parses `postgres://USER@HOST:PORT/DATABASE`.
    ///
    /// `password` is used if the text contains none. `ca` is a PEM file with the certificate authority of the
    /// server; without the file, the system's authorities are trusted. Connections are encrypted and the
    /// certificate is checked, except on this machine and with `sslmode=disable`.
    ///
    /// # Errors
    /// [`StoreError::Address`] if the text is invalid. The error does not contain the text.
    pub fn parse(
        text: &str,
        password: Option<&str>,
        ca: Option<&Path>,
    ) -> Result<Self, StoreError> {
        let wrong = |what: String| StoreError::Address { what };
        // Every encrypted connection checks the certificate completely.
        let text = text.replace("sslmode=verify-full", "sslmode=require");
        let says_mode = text.contains("sslmode=");
        let mut config: Config = text.parse().map_err(|e: tokio_postgres::Error| {
            let reason =
                std::error::Error::source(&e).map_or_else(String::new, |s| format!(": {s}"));
            wrong(format!(
                "the address of the database cannot be read{reason}"
            ))
        })?;
        if config.get_hosts().is_empty() {
            return Err(wrong(
                "the address of the database names no host".to_owned(),
            ));
        }
        if config.get_user().unwrap_or_default().is_empty() {
            return Err(wrong(
                "the address of the database names no user".to_owned(),
            ));
        }
        if config.get_password().is_none()
            && let Some(password) = password
        {
            config.password(password);
        }
        let is_local = config.get_hosts().iter().all(is_here);
        let mode = match (says_mode, config.get_ssl_mode()) {
            (false, _) if is_local => SslMode::Disable,
            (false, _) => SslMode::Require,
            (true, mode @ (SslMode::Disable | SslMode::Require)) => mode,
            (true, _) => {
                let text = "the given sslmode permits unencrypted connections without notice: use \
                            sslmode=require or sslmode=disable";
                return Err(wrong(text.to_owned()));
            }
        };
        config
            .ssl_mode(mode)
            .application_name("sightline")
            .connect_timeout(CONNECT)
            .tcp_user_timeout(SILENCE)
            .keepalives(true)
            .keepalives_idle(SILENCE)
            .keepalives_interval(SILENCE / 2)
            .keepalives_retries(2)
            .target_session_attrs(TargetSessionAttrs::ReadWrite);
        let tls = match mode {
            SslMode::Disable => None,
            _ => Some(MakeRustlsConnect::new(trusting(ca)?)),
        };
        let shown = shown(&config);
        Ok(Self { config, tls, shown })
    }

    /// Returns the connection settings.
    pub(super) fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the TLS settings, or `None` for unencrypted connections.
    pub(super) fn tls(&self) -> Option<MakeRustlsConnect> {
        self.tls.clone()
    }
}

impl fmt::Display for DatabaseAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.shown)
    }
}

impl fmt::Debug for DatabaseAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.shown)
    }
}

fn shown(config: &Config) -> String {
    let ports = config.get_ports();
    let one = |(i, host): (usize, &Host)| {
        let name = match host {
            Host::Tcp(name) => name.clone(),
            #[cfg(unix)]
            Host::Unix(path) => path.display().to_string(),
        };
        let port = ports.get(i).or(ports.first()).copied().unwrap_or(5432);
        format!("{name}:{port}")
    };
    let hosts: Vec<String> = config.get_hosts().iter().enumerate().map(one).collect();
    let user = config.get_user().unwrap_or_default();
    format!(
        "the database postgres://{user}@{}/{}",
        hosts.join(","),
        config.get_dbname().unwrap_or(user)
    )
}

/// Returns true if traffic to a host stays on this machine.
fn is_here(host: &Host) -> bool {
    match host {
        Host::Tcp(name) => {
            name == "localhost" || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
        }
        #[cfg(unix)]
        Host::Unix(_) => true,
    }
}

/// Creates a TLS configuration that trusts the certificate authorities in the file `ca`, or the system's
/// authorities if `ca` is `None`.
fn trusting(ca: Option<&Path>) -> Result<ClientConfig, StoreError> {
    let wrong = |what: String| StoreError::Address { what };
    let mut roots = RootCertStore::empty();
    match ca {
        Some(path) => {
            let unusable =
                |reason: String| wrong(format!("{}: {reason}", PathBuf::from(path).display()));
            for certificate in
                CertificateDer::pem_file_iter(path).map_err(|e| unusable(e.to_string()))?
            {
                let certificate = certificate.map_err(|e| unusable(e.to_string()))?;
                roots
                    .add(certificate)
                    .map_err(|e| unusable(e.to_string()))?;
            }
            if roots.is_empty() {
                return Err(unusable("the file contains no certificate".to_owned()));
            }
        }
        None => {
            let found = rustls_native_certs::load_native_certs();
            let (taken, _) = roots.add_parsable_certificates(found.certs);
            if taken == 0 {
                return Err(wrong(
                    "the connection with the database must be encrypted, but the system has no \
                     authorities; give the authority of the certificate of the database with \
                     --store-ca"
                        .to_owned(),
                ));
            }
        }
    }
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| wrong(e.to_string()))?;
    Ok(config.with_root_certificates(roots).with_no_client_auth())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn password_is_never_shown() {
        let address =
            DatabaseAddress::parse("postgres://u:secret@127.0.0.1:5433/d", None, None).unwrap();
        for text in [address.to_string(), format!("{address:?}")] {
            assert_eq!(text, "the database postgres://u@127.0.0.1:5433/d");
        }
        let wrongs = [
            "postgres://u:secret@127.0.0.1:port/d",
            "postgres://u:secret@h/d?sslmode=prefer",
            "postgres://u:secret@/d",
            "postgres://:secret@h/d",
            "postgres://u:secret@h/d?sslmode=sometimes",
            "nonsense secret",
        ];
        for wrong in wrongs {
            let error = DatabaseAddress::parse(wrong, None, None)
                .unwrap_err()
                .to_string();
            assert!(
                !error.contains("secret") && error.contains("postgres://USER@HOST"),
                "{wrong}: {error}"
            );
        }
    }

    #[test]
    fn remote_connections_are_encrypted_unless_disabled() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let certified = rcgen::generate_simple_self_signed(vec!["db".to_owned()]).unwrap();
        std::fs::write(file.path(), certified.cert.pem()).unwrap();
        let encrypted = |text: &str| {
            let address = DatabaseAddress::parse(text, None, Some(file.path())).unwrap();
            assert_eq!(
                address.tls().is_some(),
                address.config().get_ssl_mode() == SslMode::Require
            );
            address.tls().is_some()
        };
        assert!(encrypted("postgres://u@db/d"));
        assert!(encrypted("postgres://u@db,127.0.0.1/d"));
        assert!(encrypted("postgres://u@127.0.0.1/d?sslmode=verify-full"));
        assert!(!encrypted("postgres://u@127.0.0.1/d"));
        assert!(!encrypted("postgres://u@%2Frun%2Fpostgresql/d"));
        assert!(!encrypted("postgres://u@db/d?sslmode=disable"));
        std::fs::write(file.path(), "no certificate").unwrap();
        let error =
            DatabaseAddress::parse("postgres://u@db/d", None, Some(file.path())).unwrap_err();
        assert!(error.to_string().contains("no certificate"), "{error}");
    }
}
