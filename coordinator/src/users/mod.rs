//! Users: what each of them may store.

pub(crate) mod quota_check;
