//! The coordinator's errors as gRPC statuses.

use tonic::Status;

use crate::store::{BlobError, JournalError, StoreError};

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
    Status::resource_exhausted(format!("{text}; try again in 10 s"))
}

/// Something only the log explains.
pub(crate) fn internal(text: &str) -> Status {
    tracing::error!("{text}");
    Status::internal(text.to_owned())
}
