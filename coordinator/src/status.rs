//! The coordinator's errors as gRPC statuses.

use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt as _};

use crate::store::{BlobError, JournalError, StoreError};

/// When to try again what a full disk refused.
const AGAIN: Duration = Duration::from_secs(10);

/// What a client should know of a store error.
pub(crate) fn of_store(e: &StoreError) -> Status {
    let text = e.to_string();
    match e {
        StoreError::UnknownJob { .. } | StoreError::UnknownScene { .. } => Status::not_found(text),
        StoreError::UnknownTile { .. }
        | StoreError::TooLong { .. }
        | StoreError::BadCharacter { .. }
        | StoreError::RequestIdReused { .. } => Status::invalid_argument(text),
        StoreError::IllegalTransition { .. }
        | StoreError::TileNotOpen { .. }
        | StoreError::TilesOpen { .. }
        | StoreError::PlanDiffers { .. } => Status::failed_precondition(text),
        StoreError::Journal(JournalError::NoSpace { .. }) => full(&text),
        _ => internal(&text),
    }
}

/// What a client should know of a blob error.
pub(crate) fn of_blob(e: &BlobError) -> Status {
    match e {
        BlobError::NoSpace { .. } => full(&e.to_string()),
        _ => internal(&e.to_string()),
    }
}

/// The disk is full: worth trying again.
fn full(text: &str) -> Status {
    tracing::error!("{text}: until then tiles wait and are tried again");
    Status::with_error_details(
        Code::ResourceExhausted,
        format!("{text}; try again in {} s", AGAIN.as_secs()),
        ErrorDetails::with_retry_info(Some(AGAIN)),
    )
}

/// Something only the log explains.
pub(crate) fn internal(text: &str) -> Status {
    tracing::error!("{text}");
    Status::internal(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_says_when_to_try_again_in_words_and_as_retry_info() {
        let status = full("there is no space left");
        assert_eq!(status.code(), Code::ResourceExhausted);
        assert!(status.message().ends_with("try again in 10 s"), "{status}");
        assert_eq!(status.get_details_retry_info().unwrap().retry_delay, Some(AGAIN));
    }
}
