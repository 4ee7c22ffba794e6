//! The keys of an object store in a file, in the format of Amazon's tools. The file has a line `[default]`,
//! then a name and a value on each line. Messages and logs never contain the keys.

use std::fmt;
use std::path::{Path, PathBuf};

/// Maximum length of a key file, in bytes.
const MOST: u64 = 64 << 10;

/// The access keys of an object store.
#[derive(PartialEq, Eq)]
pub(super) struct Keys {
    pub(super) id: String,
    pub(super) secret: String,
    pub(super) token: Option<String>,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Keys(…)")
    }
}

/// An error of a key file.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}: {reason}; keys= must name a file with aws_access_key_id = … and aws_secret_access_key = …",
    path.display()
)]
pub(super) struct KeysError {
    path: PathBuf,
    reason: String,
}

impl Keys {
    /// Reads the keys of the section `[default]`, or of a file without sections.
    ///
    /// # Errors
    /// An error if the file contains no keys.
    pub(super) fn read(path: &Path) -> Result<Self, KeysError> {
        let bad = |reason: String| KeysError {
            path: path.to_owned(),
            reason,
        };
        let length = std::fs::metadata(path)
            .map_err(|e| bad(e.to_string()))?
            .len();
        if length > MOST {
            return Err(bad(format!("the file has more than {MOST} bytes")));
        }
        let text = std::fs::read_to_string(path).map_err(|e| bad(e.to_string()))?;
        Self::parse(&text).map_err(|reason| bad(reason.to_owned()))
    }

    fn parse(text: &str) -> Result<Self, &'static str> {
        let (mut id, mut secret, mut token) = (None, None, None);
        let mut is_ours = true;
        for line in text.lines().map(str::trim) {
            if line.starts_with('[') {
                is_ours = line == "[default]";
            }
            let Some((name, value)) = line.split_once('=').filter(|_| is_ours) else {
                continue;
            };
            let slot = match name.trim() {
                "aws_access_key_id" => &mut id,
                "aws_secret_access_key" => &mut secret,
                "aws_session_token" => &mut token,
                _ => continue,
            };
            *slot = Some(value.trim().to_owned()).filter(|value| !value.is_empty());
        }
        let id = id.ok_or("the file has no aws_access_key_id")?;
        let secret = secret.ok_or("the file has no aws_secret_access_key")?;
        Ok(Self { id, secret, token })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_read_and_hidden_in_debug_output() {
        let text = "[other]\naws_access_key_id=x\n[default]\naws_access_key_id = ada \n\
                    aws_secret_access_key=hush=\n# nothing\n";
        let keys = Keys::parse(text).unwrap();
        assert_eq!(
            (keys.id.as_str(), keys.secret.as_str(), &keys.token),
            ("ada", "hush=", &None)
        );
        assert!(!format!("{keys:?}").contains("hush"));
        let token =
            Keys::parse("aws_access_key_id=a\naws_secret_access_key=b\naws_session_token=c")
                .unwrap();
        assert_eq!(token.token.as_deref(), Some("c"));
        assert_eq!(
            Keys::parse("[other]\naws_access_key_id=x"),
            Err("the file has no aws_access_key_id")
        );
        assert_eq!(
            Keys::parse("aws_access_key_id=x\n"),
            Err("the file has no aws_secret_access_key")
        );
        let missing = Keys::read(Path::new("/nowhere/keys")).unwrap_err();
        assert!(missing.to_string().contains("/nowhere/keys"), "{missing}");
    }
}
