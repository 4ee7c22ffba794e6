//! The address of a coordinator, and the credentials with which clients reach it.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sightline_proto::connection::{Bearer, Connection, Credentials};

use crate::error::Error;

/// The environment variable that may contain the token.
const TOKEN: &str = "SIGHTLINE_TOKEN";

/// The address of a coordinator, and the credentials with which a client reaches it.
///
/// ```
/// use sightline::Endpoint;
///
/// let endpoint = Endpoint::new("https://farm.example.com:7600");
/// assert_eq!(endpoint.url(), "https://farm.example.com:7600");
/// ```
#[derive(Clone)]
pub struct Endpoint {
    url: String,
    credentials: Credentials,
}

impl std::fmt::Debug for Endpoint {
    /// Formats the address without the credentials.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Endpoint")
            .field("url", &self.url)
            .finish_non_exhaustive()
    }
}

impl Endpoint {
    /// Creates an endpoint without credentials. If the address starts with `https://`, the coordinator needs
    /// a certificate that the system trusts.
    pub fn new(url: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            credentials: Credentials::default(),
        }
    }

    /// Returns the endpoint with credentials.
    pub fn with_credentials(self, credentials: Credentials) -> Self {
        Self {
            credentials,
            ..self
        }
    }

    /// Returns the address.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Connects to the coordinator.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if the address is invalid, or [`crate::ErrorKind::Coordinator`] if no
    /// trusted coordinator answers.
    pub async fn connect(&self) -> Result<Connection, Error> {
        let url = &self.url;
        let endpoint = self.credentials.endpoint(url).map_err(|e| {
            Error::usage(format!(
                "{url} is not a valid address of a coordinator: {e}; give an address such as \
                 http://127.0.0.1:7600"
            ))
            .about("coordinator")
        })?;
        let channel = endpoint.connect().await.map_err(|e| {
            let reason = causes(&e);
            if reason.contains("certificate") {
                return Error::coordinator(format!(
                    "{url} is not trusted ({reason}); give --ca the authority that signed the \
                     coordinator's certificate, and use an address that the certificate contains"
                ));
            }
            Error::coordinator(format!(
                "no coordinator answers at {url} ({reason}); start one with `sightline coordinator`, or \
                 give another address with --coordinator"
            ))
        })?;
        Ok(self.credentials.over(channel))
    }
}

/// Returns the texts of the causes of an error, outermost first, or the text of the error itself if it has no
/// cause.
fn causes(error: &dyn std::error::Error) -> String {
    let all = std::iter::successors(error.source(), |cause| cause.source());
    let texts: Vec<String> = all.map(ToString::to_string).collect();
    if texts.is_empty() {
        error.to_string()
    } else {
        texts.join(": ")
    }
}

/// The files with the credentials of a client.
///
/// ```
/// use sightline::{CredentialFiles, Endpoint};
///
/// let credentials = CredentialFiles::default().read()?;
/// let endpoint = Endpoint::new("http://127.0.0.1:7600").with_credentials(credentials);
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CredentialFiles {
    /// The path of the certificate, as PEM, of the authority that signed the coordinator's certificate.
    /// Default: the authorities of the system.
    pub ca: Option<PathBuf>,
    /// The path of the client's own certificate, as PEM. Needs `key`.
    pub cert: Option<PathBuf>,
    /// The path of the private key of `cert`, as PEM.
    pub key: Option<PathBuf>,
    /// The path of the file with the token, as `sightline token new` prints it. Default: the text in the
    /// environment variable SIGHTLINE_TOKEN, if it is set.
    pub token_file: Option<PathBuf>,
}

impl CredentialFiles {
    /// Reads the files.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if a file cannot be read, or [`crate::ErrorKind::Usage`] if the text is
    /// not a token, or a certificate has no key.
    pub fn read(&self) -> Result<Credentials, Error> {
        let read = |path: &PathBuf| std::fs::read(path).map_err(|e| Error::reading(path, &e));
        let ca = self.ca.as_ref().map(read).transpose()?;
        let identity = match (&self.cert, &self.key) {
            (Some(cert), Some(key)) => Some((read(cert)?, read(key)?)),
            (None, None) => None,
            (Some(_), None) => {
                return Err(Error::usage("--cert needs --key; give both").about("cert"));
            }
            (None, Some(_)) => {
                return Err(Error::usage("--key needs --cert; give both").about("key"));
            }
        };
        let token = match &self.token_file {
            Some(path) => Some((
                String::from_utf8_lossy(&read(path)?).into_owned(),
                path.display().to_string(),
            )),
            None => std::env::var(TOKEN)
                .ok()
                .filter(|text| !text.is_empty())
                .map(|text| (text, TOKEN.to_owned())),
        };
        let token = token.map(|(text, from)| {
            Bearer::parse(&text).map_err(|e| {
                Error::usage(format!("{from}: {e}; `sightline token new` prints a token"))
                    .about("token-file")
            })
        });
        Ok(Credentials {
            ca,
            identity,
            token: token.transpose()?,
        })
    }
}
