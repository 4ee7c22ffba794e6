//! The token file. It contains a digest of each secret, so a reader of the file cannot use the tokens.
//!
//! A token is `slt_ID_SECRET`. The ID is eight hexadecimal digits and names the token in lists and in the
//! log. The secret has 256 random bits, so its plain digest cannot be inverted by guessing.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sightline_files::{Access, NewFile};
use sightline_records::MAX_OWNER_BYTES;

use super::caller::{Scope, Scopes};

/// Maximum length of a user's name, in bytes.
pub const MAX_USER_BYTES: usize = MAX_OWNER_BYTES;
/// Maximum number of tokens in a file.
const MAX_TOKENS: usize = 100_000;
/// Maximum size of a token file, in bytes.
pub(super) const MAX_BYTES: u64 = 64 << 20;
/// The context string of the digests of secrets.
const CONTEXT: &str = "sightline 2026-11 token";

/// A token file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The file cannot be read.
    #[error("{} cannot be read: {reason}; create it with `sightline token new --tokens`", path.display())]
    Read {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        reason: String,
    },
    /// The file is not a token file.
    #[error("{} is not a file of tokens: {reason}", path.display())]
    Form {
        /// The path of the file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{} cannot be written: {reason}", path.display())]
    Write {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        reason: String,
    },
    /// No token can be created from the given user and scopes.
    #[error("{0}")]
    Refused(String),
}

/// A token without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token {
    /// The token's name in lists.
    pub id: String,
    /// The user whose jobs and scenes the token opens.
    pub user: String,
    /// The scopes that the token grants.
    pub scopes: Scopes,
    /// The time of creation, in milliseconds since 1970.
    pub made_at_ms: u64,
    /// The digest of the token's secret, in base 16.
    pub digest: String,
}

/// The digest of a token's secret, which identifies the token in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TokenDigest(String);

impl TokenDigest {
    /// Computes the digest of the secret in a token's text. The token need not exist.
    pub(crate) fn of_text(text: &str) -> Self {
        Self(digest_of(text.rsplit('_').next().unwrap_or_default()))
    }
}

/// The contents of a token file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TokenFile {
    /// The tokens, in order of creation.
    pub tokens: Vec<Token>,
}

impl TokenFile {
    /// Reads a token file.
    ///
    /// # Errors
    /// [`TokenError::Read`] if the file cannot be read, and [`TokenError::Form`] if it is not a token file.
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let unread = |reason: String| TokenError::Read {
            path: path.to_owned(),
            reason,
        };
        let form = |reason: String| TokenError::Form {
            path: path.to_owned(),
            reason,
        };
        let size = std::fs::metadata(path)
            .map_err(|e| unread(e.to_string()))?
            .len();
        if size > MAX_BYTES {
            return Err(form(format!(
                "the file has {size} bytes, but at most {MAX_BYTES} are allowed"
            )));
        }
        let text = std::fs::read(path).map_err(|e| unread(e.to_string()))?;
        let file: Self = serde_json::from_slice(&text).map_err(|e| form(e.to_string()))?;
        for token in &file.tokens {
            check_user(&token.user).map_err(&form)?;
            if !is_hex(&token.id, 8) || !is_hex(&token.digest, 64) {
                return Err(form(format!(
                    "the token of {} has an invalid id or digest",
                    token.user
                )));
            }
        }
        Ok(file)
    }

    /// Writes the token file. The file keeps its previous owner; a new file is readable by its owner only. A
    /// concurrent reader sees the previous file or the new one.
    ///
    /// # Errors
    /// [`TokenError::Write`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), TokenError> {
        let write = || {
            let mut file = NewFile::begin(path, Access::Private)?;
            serde_json::to_writer_pretty(&mut file, self)?;
            file.write_all(b"\n")?;
            file.commit()
        };
        write().map_err(|e: std::io::Error| TokenError::Write {
            path: path.to_owned(),
            reason: e.to_string(),
        })
    }

    /// Adds a token with these random bytes, and returns its text. The text is not stored anywhere.
    ///
    /// # Errors
    /// [`TokenError::Refused`] if the user is invalid, `scopes` is empty, or the file is full.
    pub fn add(
        &mut self,
        user: &str,
        scopes: &[Scope],
        made_at_ms: u64,
        random: [u8; 36],
    ) -> Result<String, TokenError> {
        check_user(user).map_err(TokenError::Refused)?;
        if scopes.is_empty() {
            return Err(TokenError::Refused(
                "a token needs a scope: read, submit, worker or admin".to_owned(),
            ));
        }
        if self.tokens.len() >= MAX_TOKENS {
            return Err(TokenError::Refused(format!(
                "the file has {MAX_TOKENS} tokens; revoke some first"
            )));
        }
        let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
        let (id, secret) = (hex(&random[..4]), hex(&random[4..]));
        if self.tokens.iter().any(|token| token.id == id) {
            return Err(TokenError::Refused(
                "the random id is already in use; try again".to_owned(),
            ));
        }
        let text = format!("slt_{id}_{secret}");
        let (user, scopes, digest) = (user.to_owned(), Scopes::new(scopes), digest_of(&secret));
        self.tokens.push(Token {
            id,
            user,
            scopes,
            made_at_ms,
            digest,
        });
        Ok(text)
    }

    /// Removes the token with this id. Returns true if the token existed.
    pub fn revoke(&mut self, id: &str) -> bool {
        let before = self.tokens.len();
        self.tokens.retain(|token| token.id != id);
        self.tokens.len() < before
    }

    /// Returns the token with this text, or `None` if the file does not contain the token.
    pub fn find(&self, text: &str) -> Option<&Token> {
        let (id, secret) = text.strip_prefix("slt_")?.split_once('_')?;
        let token = self.tokens.iter().find(|token| token.id == id)?;
        // The comparison of digests takes constant time, so that it does not reveal the first difference.
        let expected = blake3::Hash::from_hex(&token.digest).ok()?;
        let given = blake3::Hash::from_hex(digest_of(secret)).ok()?;
        (expected == given).then_some(token)
    }
}

impl TokenFile {
    /// Returns the token whose secret has this digest.
    pub(super) fn with_digest(&self, digest: &TokenDigest) -> Option<&Token> {
        self.tokens.iter().find(|token| token.digest == digest.0)
    }
}

/// A lock on a token file, which prevents other processes from changing the file until the lock is dropped.
pub struct TokenLock(#[allow(dead_code, reason = "it unlocks when it is dropped")] std::fs::File);

impl TokenLock {
    /// Waits until no other process changes the file, and locks it.
    ///
    /// # Errors
    /// [`TokenError::Write`] if the lock file next to the token file cannot be created.
    pub fn take(path: &Path) -> Result<Self, TokenError> {
        let failed = |e: std::io::Error| TokenError::Write {
            path: path.to_owned(),
            reason: e.to_string(),
        };
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".lock");
        let mut options = std::fs::OpenOptions::new();
        let file = options
            .create(true)
            .truncate(false)
            .write(true)
            .open(path.with_file_name(name));
        let file = file.map_err(failed)?;
        file.lock().map_err(failed)?;
        Ok(Self(file))
    }
}

fn digest_of(secret: &str) -> String {
    let digest = blake3::derive_key(CONTEXT, secret.as_bytes());
    blake3::Hash::from_bytes(digest).to_hex().to_string()
}

fn is_hex(text: &str, length: usize) -> bool {
    text.len() == length && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

fn check_user(user: &str) -> Result<(), String> {
    let fine = |c: char| !c.is_control() && c != '"' && c != '\\';
    if user.is_empty() || user.len() > MAX_USER_BYTES || !user.chars().all(fine) {
        return Err(format!(
            "a user's name has 1 to {MAX_USER_BYTES} bytes and no quotes or control characters"
        ));
    }
    Ok(())
}
