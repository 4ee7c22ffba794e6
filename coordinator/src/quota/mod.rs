//! Quotas and rate limits of users, for coordinators that authenticate users.
//!
//! [`Quota`] contains the limits of a user. `usage.rs` counts the data of a user from the store, and
//! `pace.rs` counts calls. A limit that holds for all callers is defined next to the code that it limits;
//! `docs/security.md` lists all limits.

mod budget;
mod intake;
mod pace;
mod quotas;
mod turns;
mod usage;

pub(crate) use self::budget::{Budget, Reserved, Sender};
pub(crate) use self::intake::{Intake, RequestMemory};
pub(crate) use self::pace::{Permit, RateLimiter};
pub use self::quotas::{Quota, QuotaError, Quotas, bytes};
pub(crate) use self::turns::{FairQueue, QueueTurn};
pub(crate) use self::usage::{Usage, usage};

/// A limit that a caller would exceed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitExceeded {
    /// The quota of a user.
    #[error(
        "{user} may have at most {most} {what}, but would have {wanted}; delete some, or request a \
         higher quota"
    )]
    Quota {
        /// The user.
        user: String,
        /// The limited quantity.
        what: &'static str,
        /// The limit.
        most: u64,
        /// The quantity after the rejected change.
        wanted: u64,
    },
    /// The limit of the bytes of unfinished uploads.
    #[error(
        "unfinished uploads of {who} may have at most {most} bytes together, but would have \
         {wanted}; try again after other uploads have ended"
    )]
    Unfinished {
        /// The senders of the uploads.
        who: &'static str,
        /// The limit in bytes.
        most: u64,
        /// The size of all uploads after the rejected one, in bytes.
        wanted: u64,
    },
    /// The limit of calls per second.
    #[error("{user} may make at most {most} calls per second; wait a moment and try again")]
    Rate {
        /// The calling user.
        user: String,
        /// The limit in calls per second.
        most: u32,
    },
    /// The limit of waiting queries.
    #[error(
        "{user} may have at most {most} waiting queries; wait for some of the answers, and try \
         again"
    )]
    Waiting {
        /// The user.
        user: String,
        /// The limit.
        most: u32,
    },
    /// The limit of simultaneous calls.
    #[error("{who} may have at most {most} open calls and streams; end some, and try again")]
    Calls {
        /// The caller.
        who: String,
        /// The limit.
        most: u32,
    },
}

impl LimitExceeded {
    /// Returns the name of the limit in the metrics.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Quota { what, .. } => what,
            Self::Unfinished { .. } => "unfinished",
            Self::Rate { .. } => "requests",
            Self::Waiting { .. } => "questions",
            Self::Calls { .. } => "calls",
        }
    }
}
