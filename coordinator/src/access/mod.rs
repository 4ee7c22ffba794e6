//! Who may do what: tokens with scopes, certificates of workers, and the owners of jobs and scenes.
//!
//! A coordinator without tokens and without certificates of workers asks nobody who they are, and everything
//! belongs to nobody. With either, each call needs a scope ([`needed`]); a client sees the jobs and scenes of
//! its own user alone, and those with the scope `admin` see all. What others own is answered as what does not
//! exist.

mod caller;
mod tokens;

pub use caller::{Caller, Need, Scope, Scopes, needed};
pub(crate) use tokens::TokenDigest;
pub use tokens::{MAX_USER_BYTES, Token, TokenError, TokenFile, TokenLock};

use std::path::PathBuf;
use std::sync::{PoisonError, RwLock};
use std::time::SystemTime;

/// What a coordinator asks of its callers.
pub struct Access {
    /// Where the tokens are; `None` when there are none, and clients need none.
    path: Option<PathBuf>,
    known: RwLock<Known>,
    /// Whether workers must have a certificate that the given authority has signed, or a token.
    certified: bool,
}

struct Known {
    tokens: TokenFile,
    /// When the file was changed last, and its length.
    as_of: Option<(SystemTime, u64)>,
    /// Why the file could not be read again.
    failure: Option<String>,
}

impl Access {
    /// Access by the tokens of a file, if there is one; `certified` says that the certificates of workers are
    /// checked.
    ///
    /// # Errors
    /// [`TokenError`] when the file cannot be used.
    pub fn new(path: Option<PathBuf>, certified: bool) -> Result<Self, TokenError> {
        let known = match &path {
            Some(path) => Known {
                as_of: stamp(path),
                tokens: TokenFile::read(path)?,
                failure: None,
            },
            None => Known {
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

    /// Who a caller is, by the token and the certificate of the call. A certificate has been checked.
    ///
    /// # Errors
    /// A sentence for the caller, when the token is none of this coordinator's.
    pub fn identify(
        &self,
        token: Option<&str>,
        certificate: Option<&[u8]>,
    ) -> Result<Caller, &'static str> {
        match (token, certificate) {
            (Some(token), _) if self.path.is_some() => {
                let known = self.known.read().unwrap_or_else(PoisonError::into_inner);
                let token = known.tokens.find(token).ok_or(
                    "the token is not known here, or was revoked; `sightline token new` makes one",
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
                    scopes: Scopes::of(&[Scope::Worker]),
                })
            }
            _ => Ok(Caller::Nobody),
        }
    }

    /// Returns the user of the token whose secret has this digest.
    ///
    /// # Errors
    /// A sentence for the caller, when the token was revoked.
    pub(crate) fn identify_digest(&self, digest: &TokenDigest) -> Result<Caller, &'static str> {
        let known = self.known.read().unwrap_or_else(PoisonError::into_inner);
        let token = known.tokens.with_digest(digest);
        let token = token
            .ok_or("the token of the session was revoked; log in with another one at /login")?;
        Ok(Caller::User {
            name: token.user.clone(),
            scopes: token.scopes,
        })
    }

    /// Whether a caller may make a call with this need; a sentence when not.
    ///
    /// # Errors
    /// That sentence, and whether telling who it is could help.
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

    /// Whether clients must have tokens.
    pub fn has_tokens(&self) -> bool {
        self.path.is_some()
    }

    /// Reads the tokens again if their file has changed. Tokens that cannot be read leave those that were
    /// read before, and the log says so.
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
                *self.known.write().unwrap_or_else(PoisonError::into_inner) = Known {
                    tokens,
                    as_of: now,
                    failure: None,
                };
            }
            Err(e) => {
                let mut known = self.known.write().unwrap_or_else(PoisonError::into_inner);
                // It is tried again each time, and said once.
                let failure = e.to_string();
                if known.failure.as_ref() != Some(&failure) {
                    tracing::error!("{failure}; the tokens that were read before stay valid");
                }
                (known.failure, known.as_of) = (Some(failure), None);
            }
        }
    }
}

/// Why a call is refused.
#[derive(Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The caller has not said who it is.
    Unknown(&'static str),
    /// The caller's token does not have the scope.
    Scope(String),
}

fn stamp(path: &std::path::Path) -> Option<(SystemTime, u64)> {
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

#[cfg(test)]
mod tests;
