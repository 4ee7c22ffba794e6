//! Quotas as they are written: `bytes=100G,jobs=1000`, or for one user `ada:bytes=1T`.

use std::collections::BTreeMap;

/// Calls a second of a user, and calls and streams at a time, where no quota says otherwise.
const CALLS_A_SECOND: u32 = 200;
const CALLS_AT_ONCE: u32 = 256;

/// What a user may have and do; `None` is no limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Bytes of the user's scenes, receivers and results, and of chunks that are none of these yet.
    pub bytes: Option<u64>,
    /// Scenes that the user has sent.
    pub scenes: Option<u64>,
    /// Jobs of the user, whether they have ended or not.
    pub jobs: Option<u64>,
    /// Tiles of these jobs.
    pub tiles: Option<u64>,
    /// Calls a second, in the mean; five times as many may come at once.
    pub requests: Option<u32>,
    /// Calls and streams at a time.
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

/// A text that is no quota.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{part:?} is no quota; give NAME=N with the names bytes (100G, 1T), scenes, jobs, tiles, requests (a \
     second) and calls (at a time), separated by commas; N can be `none`; USER: in front is for this user \
     alone"
)]
pub struct QuotaError {
    /// The part that is wrong.
    pub part: String,
}

/// The quotas of all users.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    everybody: Quota,
    of: BTreeMap<String, Quota>,
}

impl Quotas {
    /// The quotas of these texts; a user's own begins from that of everybody.
    ///
    /// # Errors
    /// [`QuotaError`] for the first part that is none.
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
            let quota = quotas.of(&user);
            quotas.of.insert(user, changed(quota, &text)?);
        }
        Ok(quotas)
    }

    /// The quota of a user.
    pub fn of(&self, user: &str) -> Quota {
        self.of.get(user).copied().unwrap_or(self.everybody)
    }
}

/// A quota with the changes of a text.
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

/// A number of bytes, with K, M, G or T for powers of 1024.
///
/// # Errors
/// A sentence, when it is none.
pub fn bytes(text: &str) -> Result<u64, String> {
    number(text, true).ok_or_else(|| "give a number of bytes, such as 500G".to_owned())
}

/// A number; of bytes with K, M, G or T for powers of 1024.
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
    fn quotas_are_read_and_a_user_s_own_comes_first() {
        let quotas = parse(&["ada:bytes=1T", "bytes=3G,jobs=7", "requests=none"]).unwrap();
        let (bob, ada) = (quotas.of("bob"), quotas.of("ada"));
        assert_eq!(
            (bob.bytes, bob.jobs, bob.requests),
            (Some(3 << 30), Some(7), None)
        );
        assert_eq!(
            (ada.bytes, ada.jobs, ada.calls),
            (Some(1 << 40), Some(7), Some(CALLS_AT_ONCE))
        );
        assert_eq!(Quotas::default().of("eve"), Quota::default());
    }

    #[test]
    fn what_is_no_quota_is_refused() {
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
