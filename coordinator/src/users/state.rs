//! The state of users: credentials, rates of calls, and usage.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Instant;

use crate::access::Access;
use crate::quota::{Intake, RateLimiter, Usage};

/// The state of users.
#[derive(Default)]
pub(crate) struct UserState {
    /// The credentials that callers need. Unset if callers need none.
    pub(crate) access: OnceLock<Arc<Access>>,
    /// The memory of requests that were not handled yet.
    pub(crate) intake: Arc<Intake>,
    /// The rates of calls.
    pub(crate) rate_limiter: RateLimiter,
    /// The usage of users at the last count.
    pub(crate) counted: Mutex<BTreeMap<String, (Instant, Usage)>>,
    /// The lock of additions to the usage of a user: [`super::quota_check::QuotaReservation`].
    pub(crate) quota: Mutex<()>,
}
