//! Access control: tokens with scopes, certificates of workers, and the owners of jobs and scenes.
//!
//! A coordinator without tokens and without certificates of workers does not authenticate callers, and all
//! data has the empty owner. With either, each call requires a scope ([`needed`]). A client then sees only
//! the jobs and scenes of the token's user, and a caller with the scope `admin` sees all. For data of another
//! owner the coordinator answers as if the data did not exist.

mod caller;
mod tokens;

pub use caller::{Caller, Need, Scope, Scopes, needed};
pub(crate) use tokens::TokenDigest;
pub use tokens::{MAX_USER_BYTES, Token, TokenError, TokenFile, TokenLock};

use std::path::PathBuf;
use std::sync::{PoisonError, RwLock};
use std::time::SystemTime;

/// The credentials that a coordinator accepts from its callers.
pub struct Access {
    /// The path of the token file. `None` if clients need no tokens.
    path: Option<PathBuf>,
    known: RwLock<LoadedTokens>,
    /// True if workers need a certificate that the given authority has signed, or a token.
    certified: bool,
}

struct LoadedTokens {
    tokens: TokenFile,
    /// The modification time and the length of the file when it was read last.
    as_of: Option<(SystemTime, u64)>,
    /// The reason why the last attempt to read the file again failed.
    failure: Option<String>,
}

impl Access {
    /// Creates the access control from a token file, if `path` names one. `certified` states that the
    /// transport checks the certificates of workers.
    ///
    /// # Errors
    /// [`TokenError`] if the file cannot be used.
    pub fn new(path: Option<PathBuf>, certified: bool) -> Result<Self, TokenError> {
        let known = match &path {
            Some(path) => LoadedTokens {
                as_of: stamp(path),
                tokens: TokenFile::read(path)?,
                failure: None,
            },
            None => LoadedTokens {
                as_of: None,
                tokens: TokenFile::default(),
                failure: None,
            },
        };
        Ok(Self {
            path,
            known: RwLock::new(known),
            certified,
        })
    }

    /// Identifies a caller by the token and the certificate of the call. The transport has checked the
    /// certificate.
    ///
    /// # Errors
    /// A sentence for the caller, if the token file does not contain the token.
    pub fn identify(
        &self,
        token: Option<&str>,
        certificate: Option<&[u8]>,
    ) -> Result<Caller, &'static str> {
        match (token, certificate) {
            (Some(token), _) if self.path.is_some() => {
                let known = self.known.read().unwrap_or_else(PoisonError::into_inner);
                let token = known.tokens.find(token).ok_or(
                    "the token is unknown or revoked; create a token with `sightline token new`",
                )?;
                Ok(Caller::User {
                    name: token.user.clone(),
                    scopes: token.scopes,
                })
            }
            (_, Some(certificate)) if self.certified => {
                let name = format!("certificate {}", &blake3::hash(certificate).to_hex()[..16]);
                Ok(Caller::User {
                    name,
                    scopes: Scopes::new(&[Scope::Worker]),
                })
            }
            _ => Ok(Caller::Nobody),
        }
    }

    /// Returns the user of the token whose secret has this digest.
    ///
    /// # Errors
    /// A sentence for the caller, if the token was revoked.
    pub(crate) fn identify_digest(&self, digest: &TokenDigest) -> Result<Caller, &'static str> {
        let known = self.known.read().unwrap_or_else(PoisonError::into_inner);
        let token = known.tokens.with_digest(digest);
        let token = token
            .ok_or("the token of the session was revoked; log in with another token at /login")?;
        Ok(Caller::User {
            name: token.user.clone(),
            scopes: token.scopes,
        })
    }

    /// Checks that the caller may make a call that requires this permission.
    ///
    /// # Errors
    /// [`Refusal::Unknown`] if the caller has not authenticated, and [`Refusal::Scope`] if the token lacks
    /// the scope.
    pub fn permit(&self, caller: &Caller, need: Need) -> Result<(), Refusal> {
        let Need::Scope(scope) = need else {
            return Ok(());
        };
        let asked = match scope {
            Scope::Worker => self.certified || self.path.is_some(),
            _ => self.path.is_some(),
        };
        match caller {
            _ if !asked => Ok(()),
            Caller::User { scopes, .. } if scopes.include(scope) => Ok(()),
            Caller::User { name, .. } => Err(Refusal::Scope(format!(
                "this call needs the scope {scope}, which {name} does not have; `sightline token new --scope \
                 {scope}` makes a token that has it"
            ))),
            _ => Err(Refusal::Unknown(match scope {
                Scope::Worker => {
                    "a worker needs a certificate of this coordinator's authority (--cert, --key) \
                                  or a token with the scope worker (--token-file)"
                }
                _ => "this coordinator needs a token; give --token-file, or set SIGHTLINE_TOKEN",
            })),
        }
    }

    /// Returns true if clients need tokens.
    pub fn has_tokens(&self) -> bool {
        self.path.is_some()
    }

    /// Reads the tokens again if their file has changed. If the file cannot be read, the previous tokens stay
    /// valid and the log reports the failure.
    pub fn refresh(&self) {
        let Some(path) = &self.path else { return };
        let now = stamp(path);
        if now.is_some()
            && self
                .known
                .read()
                .unwrap_or_else(PoisonError::into_inner)
                .as_of
                == now
        {
            return;
        }
        match TokenFile::read(path) {
            Ok(tokens) => {
                tracing::info!("read the tokens again: {}", tokens.tokens.len());
                *self.known.write().unwrap_or_else(PoisonError::into_inner) = LoadedTokens {
                    tokens,
                    as_of: now,
                    failure: None,
                };
            }
            Err(e) => {
                let mut known = self.known.write().unwrap_or_else(PoisonError::into_inner);
                // The read is repeated at each call, but each failure is logged only once.
                let failure = e.to_string();
                if known.failure.as_ref() != Some(&failure) {
                    tracing::error!("{failure}; the previous tokens stay valid");
                }
                (known.failure, known.as_of) = (Some(failure), None);
            }
        }
    }
}

/// The reason why a call is rejected.
#[derive(Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The caller has not authenticated.
    Unknown(&'static str),
    /// The caller's token does not have the required scope.
    Scope(String),
}

fn stamp(path: &std::path::Path) -> Option<(SystemTime, u64)> {
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

#[cfg(test)]
mod tests;
