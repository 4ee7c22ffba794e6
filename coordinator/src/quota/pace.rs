//! Limits of calls per second and of simultaneous calls.
//!
//! The crate `governor` does not replace this module: its limiters have one fixed rate for all keys, and do
//! not count open calls. Here each user has a quota, which a reload can change.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::{LimitExceeded, Quota};

/// Maximum number of simultaneous calls of all callers. This number times the memory of a watcher must fit
/// into memory.
const MOST_CALLS: u32 = 16_384;
/// The time for which a user can save up unused calls, in seconds.
const SAVED: f64 = 5.0;
/// Maximum number of remembered users. Above it, users without open calls are removed.
const MOST_USERS: usize = 4096;

/// A limiter of the calls of all users.
#[derive(Debug, Default)]
pub(crate) struct RateLimiter(Arc<Mutex<Calls>>);

#[derive(Debug, Default)]
struct Calls {
    all: u32,
    by_user: BTreeMap<String, Account>,
}

#[derive(Debug)]
struct Account {
    /// The number of open calls and streams.
    open: u32,
    /// The number of calls that the user could still make at the time `at` of the last call.
    left: f64,
    at: Instant,
}

/// The permission for an open call, until it is dropped.
#[derive(Debug)]
pub(crate) struct Permit {
    calls: Arc<Mutex<Calls>>,
    /// The user, if the user has a quota.
    user: Option<String>,
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
        calls.all -= 1;
        if let Some(account) = self
            .user
            .as_ref()
            .and_then(|user| calls.by_user.get_mut(user))
        {
            account.open -= 1;
        }
    }
}

impl RateLimiter {
    /// Starts a call of a user, or of an anonymous caller if the name is empty. Only users have quotas.
    ///
    /// # Errors
    /// [`LimitExceeded`] if the caller has too many calls.
    pub(crate) fn begin(
        &self,
        user: &str,
        quota: Option<&Quota>,
        now: Instant,
    ) -> Result<Permit, LimitExceeded> {
        let mut calls = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if calls.all >= MOST_CALLS {
            return Err(LimitExceeded::Calls {
                who: "all callers together".to_owned(),
                most: MOST_CALLS,
            });
        }
        if let Some(quota) = quota {
            calls.count(user, quota, now)?;
        }
        calls.all += 1;
        // Without a quota, the limiter does not store the user.
        let user = quota.map(|_| user.to_owned());
        Ok(Permit {
            calls: Arc::clone(&self.0),
            user,
        })
    }
}

impl Calls {
    fn count(&mut self, user: &str, quota: &Quota, now: Instant) -> Result<(), LimitExceeded> {
        if self.by_user.len() >= MOST_USERS && !self.by_user.contains_key(user) {
            self.by_user.retain(|_, account| account.open > 0);
        }
        let most = f64::from(quota.requests.unwrap_or(0)) * SAVED;
        let account = self.by_user.entry(user.to_owned()).or_insert(Account {
            open: 0,
            left: most,
            at: now,
        });
        if let Some(rate) = quota.requests {
            let saved = now.saturating_duration_since(account.at).as_secs_f64() * f64::from(rate);
            (account.left, account.at) = ((account.left + saved).min(most), now);
            if account.left < 1.0 {
                return Err(LimitExceeded::Rate {
                    user: user.to_owned(),
                    most: rate,
                });
            }
        }
        if let Some(most) = quota.calls.filter(|most| account.open >= *most) {
            return Err(LimitExceeded::Calls {
                who: user.to_owned(),
                most,
            });
        }
        account.left -= 1.0;
        account.open += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn frequent_caller_waits_and_others_do_not() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        let quota = Quota {
            requests: Some(10),
            calls: None,
            ..Quota::default()
        };
        let call = |user, at| pace.begin(user, Some(&quota), at).map(drop);
        for _ in 0..50 {
            call("ada", now).unwrap();
        }
        assert_eq!(
            call("ada", now),
            Err(LimitExceeded::Rate {
                user: "ada".to_owned(),
                most: 10
            })
        );
        call("bob", now).unwrap();
        call("ada", now + Duration::from_millis(100)).unwrap();
        assert!(call("ada", now + Duration::from_millis(100)).is_err());
    }

    #[test]
    fn open_calls_count_until_their_end() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        let quota = Quota {
            requests: None,
            calls: Some(2),
            ..Quota::default()
        };
        let one = pace.begin("ada", Some(&quota), now).unwrap();
        let _two = pace.begin("ada", Some(&quota), now).unwrap();
        assert!(pace.begin("ada", Some(&quota), now).is_err());
        drop(one);
        assert!(pace.begin("ada", Some(&quota), now).is_ok());
    }

    #[test]
    fn limits_concurrent_anonymous_calls() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        let open: Vec<_> = (0..1_000_000)
            .map_while(|_| pace.begin("", None, now).ok())
            .collect();
        assert_eq!(open.len(), MOST_CALLS as usize);
        drop(open);
        assert!(pace.begin("", None, now).is_ok());
    }

    #[test]
    fn unlimited_users_do_not_count_as_anonymous() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        drop(pace.begin("", Some(&Quota::default()), now).unwrap());
        drop(pace.begin("", None, now).unwrap());
        assert_eq!(pace.0.lock().unwrap().by_user[""].open, 0);
    }

    #[test]
    fn users_without_calls_are_removed() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        for n in 0..3 * MOST_USERS {
            drop(
                pace.begin(&format!("user {n}"), Some(&Quota::default()), now)
                    .unwrap(),
            );
        }
        assert!(pace.0.lock().unwrap().by_user.len() <= MOST_USERS);
    }
}
