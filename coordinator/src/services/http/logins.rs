//! Sessions of browsers: random ids that represent a token. A session ends after twelve hours, at a logout,
//! or when the token is revoked.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::access::TokenDigest;

/// The duration of a session.
pub(super) const LIFE: Duration = Duration::from_secs(12 * 3600);
/// Maximum number of sessions at a time. A further login ends the oldest session.
const MAX_SESSIONS: usize = 4096;

/// The sessions of a coordinator's pages.
#[derive(Debug, Default)]
pub(super) struct Logins(Mutex<BTreeMap<SessionKey, Session>>);

/// The digest of a session's id. The process does not keep the ids in memory.
type SessionKey = [u8; 32];

/// A session.
#[derive(Clone, Debug)]
struct Session {
    token: TokenDigest,
    end: Instant,
}

impl Logins {
    /// Starts a session for a token, and returns the id of the session.
    ///
    /// # Errors
    /// [`getrandom::Error`] if the system has no random numbers.
    pub(super) fn begin(
        &self,
        token: TokenDigest,
        now: Instant,
    ) -> Result<String, getrandom::Error> {
        let mut random = [0; 32];
        getrandom::fill(&mut random)?;
        let id = blake3::Hash::from_bytes(random).to_hex().to_string();
        let mut all = self.all();
        all.retain(|_, session| session.end > now);
        if all.len() >= MAX_SESSIONS
            && let Some((&oldest, _)) = all.iter().min_by_key(|(_, session)| session.end)
        {
            all.remove(&oldest);
        }
        all.insert(
            key(&id),
            Session {
                token,
                end: now + LIFE,
            },
        );
        Ok(id)
    }

    /// Returns the token of a session that has not ended.
    pub(super) fn token(&self, id: &str, now: Instant) -> Option<TokenDigest> {
        self.all()
            .get(&key(id))
            .filter(|session| session.end > now)
            .map(|session| session.token.clone())
    }

    /// Ends a session.
    pub(super) fn end(&self, id: &str) {
        self.all().remove(&key(id));
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<SessionKey, Session>> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn key(id: &str) -> SessionKey {
    *blake3::hash(id.as_bytes()).as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn token(n: usize) -> TokenDigest {
        TokenDigest::of_text(&n.to_string())
    }

    #[test]
    fn session_ends_after_its_life_or_at_logout() {
        let (logins, now) = (Logins::default(), Instant::now());
        let [first, second] = [1, 2].map(|n| logins.begin(token(n), now).unwrap());
        assert!(first != second && first.len() == 64);
        let almost = now + LIFE - Duration::from_secs(1);
        assert_eq!(logins.token(&first, almost), Some(token(1)));
        assert_eq!(logins.token(&first, now + LIFE), None);
        assert_eq!(logins.token("", now), None);
        logins.end(&first);
        assert_eq!(
            (logins.token(&first, now), logins.token(&second, now)),
            (None, Some(token(2)))
        );
        // A new session removes the sessions that have ended.
        logins.begin(token(3), now + LIFE).unwrap();
        assert_eq!(logins.all().len(), 1);
    }

    #[test]
    fn number_of_sessions_is_bounded() {
        let (logins, now) = (Logins::default(), Instant::now());
        let first = logins.begin(token(0), now).unwrap();
        for n in 0..MAX_SESSIONS {
            logins
                .begin(token(n), now + Duration::from_secs(1))
                .unwrap();
        }
        assert_eq!(logins.token(&first, now), None);
        assert_eq!(logins.all().len(), MAX_SESSIONS);
    }
}
