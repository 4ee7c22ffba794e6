//! The file of tokens. It holds a digest of each secret, so who reads the file can use none of them.
//!
//! A token is `slt_ID_SECRET`: the ID, eight digits of base 16, names it in lists and in the log; the
//! secret has 256 random bits, so a plain digest of it cannot be guessed backwards.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sightline_files::{Access, NewFile};
use sightline_records::MAX_OWNER_BYTES;

use super::caller::{Scope, Scopes};

/// Most bytes of a user's name.
pub const MAX_USER_BYTES: usize = MAX_OWNER_BYTES;
/// Most tokens of a file.
const MAX_TOKENS: usize = 100_000;
/// Most bytes of a file.
const MAX_BYTES: u64 = 64 << 20;
/// What the digest of a secret is for.
const CONTEXT: &str = "sightline 2026-11 token";

/// A file of tokens that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {reason}; `sightline token new --tokens` makes it", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// The file is no file of tokens.
    #[error("{}: is not a file of tokens: {reason}", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// A token cannot be made of this.
    #[error("{0}")]
    Refused(String),
}

/// A token without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token {
    /// Its name in lists.
    pub id: String,
    /// Whose jobs and scenes it opens.
    pub user: String,
    /// What it allows.
    pub scopes: Scopes,
    /// When it was made, milliseconds since 1970.
    pub made_at_ms: u64,
    /// The digest of its secret, base 16.
    pub digest: String,
}

/// The digest of a token's secret, which names the token in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TokenDigest(String);

impl TokenDigest {
    /// Computes the digest of a token's text, whether the token exists or not.
    pub(crate) fn of_text(text: &str) -> Self {
        Self(digest_of(text.rsplit('_').next().unwrap_or_default()))
    }
}

/// All tokens of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TokenFile {
    /// The tokens, in the order in which they were made.
    pub tokens: Vec<Token>,
}

impl TokenFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`TokenError::Read`] and [`TokenError::Form`].
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
                "it has {size} bytes; at most {MAX_BYTES} are read"
            )));
        }
        let text = std::fs::read(path).map_err(|e| unread(e.to_string()))?;
        let file: Self = serde_json::from_slice(&text).map_err(|e| form(e.to_string()))?;
        for token in &file.tokens {
            check_user(&token.user).map_err(&form)?;
            if !is_hex(&token.id, 8) || !is_hex(&token.digest, 64) {
                return Err(form(format!(
                    "the token of {} has no proper id or digest",
                    token.user
                )));
            }
        }
        Ok(file)
    }

    /// Writes the file, with its previous owner, or readable by its owner only. A reader sees the
    /// previous file or the new one.
    ///
    /// # Errors
    /// [`TokenError::Write`].
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

    /// Adds a token with these random bytes, and gives its text, which is nowhere else.
    ///
    /// # Errors
    /// [`TokenError::Refused`] for a bad user, no scope, or a full file.
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
                "the random id is taken already; try again".to_owned(),
            ));
        }
        let text = format!("slt_{id}_{secret}");
        let (user, scopes, digest) = (user.to_owned(), Scopes::of(scopes), digest_of(&secret));
        self.tokens.push(Token {
            id,
            user,
            scopes,
            made_at_ms,
            digest,
        });
        Ok(text)
    }

    /// Removes the token of an id; whether there was one.
    pub fn revoke(&mut self, id: &str) -> bool {
        let before = self.tokens.len();
        self.tokens.retain(|token| token.id != id);
        self.tokens.len() < before
    }

    /// The token with this text.
    pub fn find(&self, text: &str) -> Option<&Token> {
        let (id, secret) = text.strip_prefix("slt_")?.split_once('_')?;
        let token = self.tokens.iter().find(|token| token.id == id)?;
        // In a time that does not depend on where they differ.
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

/// Holds others off from changing a file of tokens, until it is dropped.
pub struct TokenLock(#[allow(dead_code, reason = "it unlocks when it is dropped")] std::fs::File);

impl TokenLock {
    /// Waits until nobody else changes the file.
    ///
    /// # Errors
    /// [`TokenError::Write`] when the lock, a file beside it, cannot be made.
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
