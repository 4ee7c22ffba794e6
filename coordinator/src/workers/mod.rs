//! Workers: their identities, sessions, leases and crews, and their quarantine.

pub(crate) mod crews;
pub(crate) mod identity;
pub(crate) mod late_outcomes;
pub(crate) mod lease_tags;
pub(crate) mod quarantine;
pub(crate) mod sessions;
pub(crate) mod state;
