//! How much a user may have and do, where users are asked who they are.
//!
//! [`Quota`] says how much; `usage.rs` counts what a user has, from the store; `pace.rs` counts calls. The
//! limits that hold for everybody stand beside what they bound; `docs/security.md` lists them all.

mod budget;
mod intake;
mod pace;
mod quotas;
mod turns;
mod usage;

pub(crate) use self::budget::{Budget, Reserved, Sender};
pub(crate) use self::intake::{Intake, Room};
pub(crate) use self::pace::{Permit, RateLimiter};
pub use self::quotas::{Quota, QuotaError, Quotas, bytes};
pub(crate) use self::turns::{Turn, Turns};
pub(crate) use self::usage::{Usage, usage};

/// Something that a user may not have or do any more.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitExceeded {
    /// A quota.
    #[error(
        "{user} may have {most} {what}, and would have {wanted}; delete some, or ask an admin for more"
    )]
    Quota {
        /// Whose it is.
        user: String,
        /// What is bounded.
        what: &'static str,
        /// The bound.
        most: u64,
        /// What there would be.
        wanted: u64,
    },
    /// Too many bytes in uploads that have not ended.
    #[error(
        "unfinished uploads of {who} may have {most} bytes together and would have {wanted}; try again when \
         others have ended"
    )]
    Unfinished {
        /// The senders.
        who: &'static str,
        /// The bound.
        most: u64,
        /// The bytes that there would be.
        wanted: u64,
    },
    /// Too many calls in a time.
    #[error("{user} may make {most} calls a second; wait a moment and try again")]
    Rate {
        /// Who calls.
        user: String,
        /// The bound.
        most: u32,
    },
    /// Too many questions that wait.
    #[error(
        "{user} may have {most} questions wait at a time; wait for some of the answers, and ask again"
    )]
    Waiting {
        /// The user.
        user: String,
        /// The bound.
        most: u32,
    },
    /// Too many calls at once.
    #[error("{who} may have {most} calls and streams open at a time; end some, and try again")]
    Calls {
        /// Who calls.
        who: String,
        /// The bound.
        most: u32,
    },
}

impl LimitExceeded {
    /// The name of the limit, as the metrics have it.
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
