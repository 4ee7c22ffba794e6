//! Calls in a time, and calls at a time.
//!
//! The crate `governor` does not replace this file: its limiters have one rate for all keys, fixed when they
//! are made, and do not count open calls. Here each user has a quota, and a reload changes it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::{LimitExceeded, Quota};

/// Calls of everybody at a time: what a watcher costs, times this, must fit into memory.
const MOST_CALLS: u32 = 16_384;
/// A user may save up the calls of this many seconds.
const SAVED: f64 = 5.0;
/// Users who are kept in mind; without calls they are forgotten beyond it.
const MOST_USERS: usize = 4096;

/// Who calls how often.
#[derive(Debug, Default)]
pub(crate) struct RateLimiter(Arc<Mutex<Calls>>);

#[derive(Debug, Default)]
struct Calls {
    all: u32,
    of: BTreeMap<String, Account>,
}

#[derive(Debug)]
struct Account {
    /// Calls and streams that are open.
    open: u32,
    /// Calls that may be made now, at the time of the last one.
    left: f64,
    at: Instant,
}

/// An open call, until it is dropped.
#[derive(Debug)]
pub(crate) struct Permit {
    of: Arc<Mutex<Calls>>,
    /// The user, who has a quota.
    user: Option<String>,
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut calls = self.of.lock().unwrap_or_else(PoisonError::into_inner);
        calls.all -= 1;
        if let Some(account) = self.user.as_ref().and_then(|user| calls.of.get_mut(user)) {
            account.open -= 1;
        }
    }
}

impl RateLimiter {
    /// Begins a call of a user, or of an anonymous caller if the name is empty. Only users have quotas.
    ///
    /// # Errors
    /// [`LimitExceeded`] when there are too many.
    pub(crate) fn begin(
        &self,
        user: &str,
        quota: Option<&Quota>,
        now: Instant,
    ) -> Result<Permit, LimitExceeded> {
        let mut calls = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if calls.all >= MOST_CALLS {
            return Err(LimitExceeded::Calls {
                who: "all together".to_owned(),
                most: MOST_CALLS,
            });
        }
        if let Some(quota) = quota {
            calls.count(user, quota, now)?;
        }
        calls.all += 1;
        // Without a quota nothing is kept of the user.
        let user = quota.map(|_| user.to_owned());
        Ok(Permit {
            of: Arc::clone(&self.0),
            user,
        })
    }
}

impl Calls {
    fn count(&mut self, user: &str, quota: &Quota, now: Instant) -> Result<(), LimitExceeded> {
        if self.of.len() >= MOST_USERS && !self.of.contains_key(user) {
            self.of.retain(|_, account| account.open > 0);
        }
        let most = f64::from(quota.requests.unwrap_or(0)) * SAVED;
        let account = self.of.entry(user.to_owned()).or_insert(Account {
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
    fn a_user_who_calls_too_often_waits_and_others_do_not() {
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
    fn open_calls_are_counted_until_they_end() {
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
    fn a_million_watchers_are_refused_before_they_cost_anything() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        let open: Vec<_> = (0..1_000_000)
            .map_while(|_| pace.begin("", None, now).ok())
            .collect();
        assert_eq!(open.len(), MOST_CALLS as usize);
        drop(open);
        assert!(pace.begin("", None, now).is_ok());
    }

    #[test]
    fn those_without_a_quota_are_not_counted_among_those_without_a_name() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        drop(pace.begin("", Some(&Quota::default()), now).unwrap());
        drop(pace.begin("", None, now).unwrap());
        assert_eq!(pace.0.lock().unwrap().of[""].open, 0);
    }

    #[test]
    fn users_without_calls_are_forgotten_in_the_end() {
        let (pace, now) = (RateLimiter::default(), Instant::now());
        for n in 0..3 * MOST_USERS {
            drop(
                pace.begin(&format!("user {n}"), Some(&Quota::default()), now)
                    .unwrap(),
            );
        }
        assert!(pace.0.lock().unwrap().of.len() <= MOST_USERS);
    }
}
