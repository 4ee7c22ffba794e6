//! Users and their quotas.

pub(crate) mod quota_check;
pub(crate) mod state;
