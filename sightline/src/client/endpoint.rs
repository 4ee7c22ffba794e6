//! The address of a coordinator, and the credentials with which clients reach it.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sightline_proto::connecting::{Bearer, Connection, Credentials};

use crate::error::Error;

/// The environment variable that may hold the token.
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
    /// Formats the address. Credentials are never shown.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Endpoint")
            .field("url", &self.url)
            .finish_non_exhaustive()
    }
}

impl Endpoint {
    /// Creates the endpoint of an address, which a client reaches without credentials. An address with
    /// `https://` needs a coordinator with a certificate that the system trusts.
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

    /// Connects.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] for text that is not an address, [`crate::ErrorKind::Coordinator`] if no
    /// trusted coordinator answers.
    pub async fn connect(&self) -> Result<Connection, Error> {
        let url = &self.url;
        let endpoint = self.credentials.endpoint(url).map_err(|e| {
            Error::usage(format!(
                "{url} cannot be the coordinator's address: {e}; give one such as http://127.0.0.1:7600"
            ))
            .about("coordinator")
        })?;
        let channel = endpoint.connect().await.map_err(|e| {
            let reason = causes(&e);
            if reason.contains("certificate") {
                return Error::coordinator(format!(
                    "{url} is not trusted ({reason}); --ca names the authority that signed the coordinator's \
                     certificate, and the address must be one that the certificate names"
                ));
            }
            Error::coordinator(format!(
                "no coordinator answers at {url} ({reason}); start one with `sightline coordinator`, or name \
                 another with --coordinator"
            ))
        })?;
        Ok(self.credentials.over(channel))
    }
}

/// Returns the causes of an error, outermost first, or the error itself where it has no cause.
fn causes(error: &dyn std::error::Error) -> String {
    let all = std::iter::successors(error.source(), |cause| cause.source());
    let texts: Vec<String> = all.map(ToString::to_string).collect();
    if texts.is_empty() {
        error.to_string()
    } else {
        texts.join(": ")
    }
}

/// Files with the credentials of a client.
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
    /// The certificate, as PEM, of the authority that signed the coordinator's. Default: the
    /// authorities of the system.
    pub ca: Option<PathBuf>,
    /// The client's own certificate, as PEM. Needs `key`.
    pub cert: Option<PathBuf>,
    /// The key of `cert`, as PEM.
    pub key: Option<PathBuf>,
    /// The file with the token, as `sightline token new` prints it. Default: the text in the environment
    /// variable SIGHTLINE_TOKEN, if it is set.
    pub token_file: Option<PathBuf>,
}

impl CredentialFiles {
    /// Reads the files.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] for a file that cannot be read, [`crate::ErrorKind::Usage`] for text that
    /// is not a token, and for a certificate without its key.
    pub fn read(&self) -> Result<Credentials, Error> {
        let read = |path: &PathBuf| std::fs::read(path).map_err(|e| Error::reading(path, &e));
        let ca = self.ca.as_ref().map(read).transpose()?;
        let identity = match (&self.cert, &self.key) {
            (Some(cert), Some(key)) => Some((read(cert)?, read(key)?)),
            (None, None) => None,
            (Some(_), None) => return Err(Error::usage("--cert needs --key").about("cert")),
            (None, Some(_)) => return Err(Error::usage("--key needs --cert").about("key")),
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
            Bearer::of(&text).map_err(|e| {
                Error::usage(format!("{from}: {e}; `sightline token new` prints one"))
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
