//! The text form of quotas: `bytes=100G,jobs=1000`, or for one user `ada:bytes=1T`.

use std::collections::BTreeMap;

/// The default maximum number of calls of a user per second.
const CALLS_A_SECOND: u32 = 200;
/// The default maximum number of simultaneous calls and streams of a user.
const CALLS_AT_ONCE: u32 = 256;

/// The limits of a user. `None` means no limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Maximum size of the user's scenes, receivers and results, and of chunks that are not yet part of
    /// these, in bytes.
    pub bytes: Option<u64>,
    /// Maximum number of scenes that the user has uploaded.
    pub scenes: Option<u64>,
    /// Maximum number of jobs of the user, open and ended ones.
    pub jobs: Option<u64>,
    /// Maximum number of tiles of these jobs together.
    pub tiles: Option<u64>,
    /// Maximum mean number of calls per second. Up to five times as many calls may arrive at once.
    pub requests: Option<u32>,
    /// Maximum number of simultaneous calls and streams.
    pub calls: Option<u32>,
}

impl Default for Quota {
    fn default() -> Self {
        let (requests, calls) = (Some(CALLS_A_SECOND), Some(CALLS_AT_ONCE));
        Self {
            bytes: None,
            scenes: None,
            jobs: None,
            tiles: None,
            requests,
            calls,
        }
    }
}

/// The error of a text that is not a quota.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{part:?} is not a quota; give NAME=N,… with the names bytes (100G, 1T), scenes, jobs, tiles, \
     requests (per second) and calls (at the same time); N can be `none`; USER: in front restricts \
     the quota to this user"
)]
pub struct QuotaError {
    /// The invalid part of the text.
    pub part: String,
}

/// The quotas of all users.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    everybody: Quota,
    by_user: BTreeMap<String, Quota>,
}

impl Quotas {
    /// Parses quotas. The quota of a named user starts from the quota of all users.
    ///
    /// # Errors
    /// [`QuotaError`] with the first invalid part.
    pub fn parse(texts: &[String]) -> Result<Self, QuotaError> {
        let mut quotas = Self::default();
        let split = |text: &String| match text.split_once(':') {
            Some((user, rest)) => (Some(user.to_owned()), rest.to_owned()),
            None => (None, text.clone()),
        };
        let (own, all): (Vec<_>, Vec<_>) = texts
            .iter()
            .map(split)
            .partition(|(user, _)| user.is_some());
        for (_, text) in all {
            quotas.everybody = changed(quotas.everybody, &text)?;
        }
        for (user, text) in own {
            let user = user.unwrap_or_default();
            if user.is_empty() {
                return Err(QuotaError {
                    part: format!(":{text}"),
                });
            }
            let quota = quotas.for_user(&user);
            quotas.by_user.insert(user, changed(quota, &text)?);
        }
        Ok(quotas)
    }

    /// Returns the quota of a user.
    pub fn for_user(&self, user: &str) -> Quota {
        self.by_user.get(user).copied().unwrap_or(self.everybody)
    }
}

/// Returns `quota` with the changes that `text` lists.
fn changed(mut quota: Quota, text: &str) -> Result<Quota, QuotaError> {
    for part in text.split(',') {
        let wrong = || QuotaError {
            part: part.to_owned(),
        };
        let (name, value) = part.split_once('=').ok_or_else(wrong)?;
        let number = match value {
            "none" => None,
            value => Some(number(value, name == "bytes").ok_or_else(wrong)?),
        };
        let small = || number.map(u32::try_from).transpose().map_err(|_| wrong());
        match name {
            "bytes" => quota.bytes = number,
            "scenes" => quota.scenes = number,
            "jobs" => quota.jobs = number,
            "tiles" => quota.tiles = number,
            "requests" => quota.requests = small()?,
            "calls" => quota.calls = small()?,
            _ => return Err(wrong()),
        }
    }
    Ok(quota)
}

/// Parses a number of bytes. The suffixes K, M, G and T mean powers of 1024.
///
/// # Errors
/// A sentence, if the text is not a number of bytes.
pub fn bytes(text: &str) -> Result<u64, String> {
    number(text, true).ok_or_else(|| "give a number of bytes, such as 500G".to_owned())
}

/// Parses a number. If `bytes` is true, the suffixes K, M, G and T mean powers of 1024.
fn number(text: &str, bytes: bool) -> Option<u64> {
    let shift = |letter| {
        ["K", "M", "G", "T"]
            .iter()
            .position(|l| *l == letter)
            .map(|at| 10 * (at as u32 + 1))
    };
    let cut = text.char_indices().last().map(|(at, _)| text.split_at(at));
    match cut
        .and_then(|(digits, letter)| Some((digits, shift(letter)?)))
        .filter(|_| bytes)
    {
        Some((digits, shift)) => digits.parse::<u64>().ok()?.checked_mul(1 << shift),
        None => text.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(texts: &[&str]) -> Result<Quotas, QuotaError> {
        Quotas::parse(
            &texts
                .iter()
                .map(|text| (*text).to_owned())
                .collect::<Vec<_>>(),
        )
    }

    #[test]
    fn user_quota_overrides_common_quota() {
        let quotas = parse(&["ada:bytes=1T", "bytes=3G,jobs=7", "requests=none"]).unwrap();
        let (bob, ada) = (quotas.for_user("bob"), quotas.for_user("ada"));
        assert_eq!(
            (bob.bytes, bob.jobs, bob.requests),
            (Some(3 << 30), Some(7), None)
        );
        assert_eq!(
            (ada.bytes, ada.jobs, ada.calls),
            (Some(1 << 40), Some(7), Some(CALLS_AT_ONCE))
        );
        assert_eq!(Quotas::default().for_user("eve"), Quota::default());
    }

    #[test]
    fn invalid_quotas_are_rejected() {
        for bad in [
            "", "bytes", "bytes=", "bytes=-1", "bytes=1X", "jobs=1K", "jobs=1,", ":jobs=1",
            "bytes=é", "beer=1",
        ] {
            assert!(parse(&[bad]).is_err(), "{bad:?}");
        }
        assert!(parse(&["bytes=99999999999T"]).is_err());
        assert!(parse(&["requests=4294967296"]).is_err());
    }
}
