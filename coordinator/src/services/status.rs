//! Conversions from the subjects' errors to gRPC statuses.

use std::time::Duration;

use sightline_assemble::OutputError;
use sightline_proto::chunks::ChunkError;
use sightline_scheduler::NameTaken;
use sightline_store::{BlobError, JournalError, StoreError};
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt as _};

use crate::jobs::control::JobError;
use crate::jobs::submit::SubmitError;
use crate::outputs::commit::ResultError;
use crate::results::partial::PartialError;
use crate::results::queries::AskError;
use crate::uploads::complete::UploadError;
use crate::uploads::receivers::StoredReceiversError;
use crate::uploads::scene_files::FileError;
use crate::uploads::scenes::{FactsError, TakeError};
use crate::uploads::spool::SpoolError;
use crate::users::quota_check::ReservationError;
use crate::workers::lease_tags::ForgedLease;

/// The delay before a client tries again after the disk was full.
const AGAIN: Duration = Duration::from_secs(10);

/// Returns the status of a store error.
pub(super) fn of_store(e: &StoreError) -> Status {
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
        | StoreError::SceneInUse { .. }
        | StoreError::NotEmpty
        | StoreError::PlanDiffers { .. } => Status::failed_precondition(text),
        StoreError::Journal(JournalError::NoSpace { .. }) => full(&text),
        // Another attempt may succeed, here or at the coordinator that leads by then.
        StoreError::Unreachable { .. } | StoreError::Fenced { .. } => {
            tracing::error!("{text}");
            Status::unavailable(text)
        }
        _ => internal(&text),
    }
}

/// Returns the status of a blob error.
pub(super) fn of_blob(e: &BlobError) -> Status {
    match e {
        BlobError::NoSpace { .. } => full(&e.to_string()),
        e if e.passes() => {
            tracing::error!("{e}");
            Status::unavailable(e.to_string())
        }
        _ => internal(&e.to_string()),
    }
}

/// Returns the status of a failed upload.
pub(super) fn of_upload(e: &UploadError) -> Status {
    match e {
        UploadError::ChunkMissing | UploadError::ChunkDamaged => {
            Status::failed_precondition(e.to_string())
        }
        UploadError::Mismatch(_) | UploadError::Scene(_) | UploadError::Receivers(_) => {
            Status::invalid_argument(e.to_string())
        }
        UploadError::TooLong { .. }
        | UploadError::LongChunk { .. }
        | UploadError::Repeated { .. } => Status::invalid_argument(e.to_string()),
        UploadError::Quota(e) => of_reservation(e),
        UploadError::Blob(e) => of_blob(e),
        UploadError::Store(e) => of_store(e),
    }
}

/// Returns the status of an upload that differs from its announcement or exceeds the available space.
pub(super) fn of_spool(e: &SpoolError) -> Status {
    match e {
        SpoolError::LimitExceeded(_) => Status::with_error_details(
            Code::ResourceExhausted,
            e.to_string(),
            ErrorDetails::with_retry_info(Some(AGAIN)),
        ),
        SpoolError::Chunk(ChunkError::TooLarge(..)) | SpoolError::Length { .. } => {
            Status::invalid_argument(e.to_string())
        }
        SpoolError::Chunk(_) => Status::data_loss(e.to_string()),
        SpoolError::Blob(e) => of_blob(e),
    }
}

/// Returns the status of a reservation that exceeds a limit.
pub(super) fn of_reservation(e: &ReservationError) -> Status {
    match e {
        ReservationError::LimitExceeded(beyond) => Status::resource_exhausted(beyond.to_string()),
        ReservationError::Store(e) => of_store(e),
    }
}

/// Returns the status of a query without an answer.
pub(super) fn of_ask(e: &AskError) -> Status {
    match e {
        AskError::Job(e) => of_job(e),
        AskError::Wrong(text) => Status::invalid_argument(text.clone()),
        AskError::Unable(text) => Status::failed_precondition(text.clone()),
        AskError::Blob(e) => of_blob(e),
        AskError::Pvs(e) => Status::data_loss(e.to_string()),
        AskError::Scene(e) => Status::data_loss(e.to_string()),
    }
}

/// Returns the status of a rejected scene file.
pub(super) fn of_file(e: &FileError) -> Status {
    match e {
        FileError::Scene(e) => Status::invalid_argument(e.to_string()),
        FileError::TooLong { .. } => Status::invalid_argument(e.to_string()),
        FileError::Spool(e) => of_spool(e),
        FileError::Take(TakeError::Blob(e)) => of_blob(e),
        FileError::Take(TakeError::Store(e)) => of_store(e),
        FileError::Take(TakeError::Quota(e)) => of_reservation(e),
        FileError::Lost => internal(&e.to_string()),
    }
}

/// Returns the status of a scene whose facts cannot be read.
pub(super) fn of_facts(e: &FactsError) -> Status {
    match e {
        FactsError::Blob(e) => of_blob(e),
        FactsError::Scene(e) => internal(&e.to_string()),
    }
}

/// Returns the status of receivers that cannot be read.
pub(super) fn of_receivers(e: &StoredReceiversError) -> Status {
    match e {
        StoredReceiversError::Unknown(_) => Status::not_found(e.to_string()),
        StoredReceiversError::Receivers(e) => Status::invalid_argument(e.to_string()),
        StoredReceiversError::Blob(e) => of_blob(e),
        StoredReceiversError::Store(e) => of_store(e),
    }
}

/// Returns the status of a failed submission.
pub(super) fn of_submit(e: &SubmitError) -> Status {
    match e {
        SubmitError::Spec(_) | SubmitError::Receiver(_) => Status::invalid_argument(e.to_string()),
        SubmitError::Schedule(text) => internal(text),
        SubmitError::Quota(e) => of_reservation(e),
        SubmitError::Facts(e) => of_facts(e),
        SubmitError::Receivers(e) => of_receivers(e),
        SubmitError::Blob(e) => of_blob(e),
        SubmitError::Store(e) => of_store(e),
    }
}

/// Returns the status of an error about a job.
pub(super) fn of_job(e: &JobError) -> Status {
    match e {
        JobError::Outdated(_) | JobError::NoResult { .. } => {
            Status::failed_precondition(e.to_string())
        }
        JobError::Store(e) => of_store(e),
    }
}

/// Returns the status of a partial result that does not exist.
pub(super) fn of_partial(e: &PartialError) -> Status {
    match e {
        PartialError::Nothing(_) | PartialError::Outdated(_) => {
            Status::failed_precondition(e.to_string())
        }
        PartialError::Changed(_) => Status::unavailable(e.to_string()),
        PartialError::Gone => Status::cancelled(e.to_string()),
        PartialError::Store(e) => of_store(e),
        PartialError::Blob(e) => of_blob(e),
        PartialError::Assemble(e) => internal(&e.to_string()),
    }
}

/// Returns the status of a tile's output that is not committed.
pub(super) fn of_result(e: &ResultError) -> Status {
    match e {
        ResultError::Digest | ResultError::Unstaged(_) => Status::data_loss(e.to_string()),
        ResultError::Spool(e) => of_spool(e),
        // The service catches this error and checks the large output again.
        ResultError::Output(OutputError::Large) => internal(&e.to_string()),
        ResultError::NoJob(_) | ResultError::NoLease(_) => {
            Status::failed_precondition(e.to_string())
        }
        ResultError::Length
        | ResultError::TooLong { .. }
        | ResultError::NoTile
        | ResultError::Output(_)
        | ResultError::Answers(_) => Status::invalid_argument(e.to_string()),
        ResultError::Conflict => Status::aborted(e.to_string()),
        ResultError::Blob(e) => of_blob(e),
        ResultError::Store(e) => of_store(e),
    }
}

/// Returns the status of a forged lease.
pub(super) fn of_forged(e: &ForgedLease) -> Status {
    Status::failed_precondition(e.to_string())
}

/// Returns the status of a worker name that is in use.
pub(super) fn of_name(e: &NameTaken) -> Status {
    Status::already_exists(e.to_string())
}

/// Returns the status of a full disk, which asks for another attempt.
fn full(text: &str) -> Status {
    tracing::error!("{text}: tiles wait and are retried until the disk has space");
    Status::with_error_details(
        Code::ResourceExhausted,
        format!("{text}; try again in {} s", AGAIN.as_secs()),
        ErrorDetails::with_retry_info(Some(AGAIN)),
    )
}

/// Logs an internal error and returns its status.
pub(super) fn internal(text: &str) -> Status {
    tracing::error!("{text}");
    Status::internal(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn job_of_other_version_is_failed_precondition() {
        let outdated = of_job(&JobError::Outdated("another version began it".to_owned()));
        assert_eq!(outdated.code(), Code::FailedPrecondition);
    }

    #[test]
    fn full_disk_status_has_retry_delay() {
        let status = full("there is no space left");
        assert_eq!(status.code(), Code::ResourceExhausted);
        assert!(status.message().ends_with("try again in 10 s"), "{status}");
        assert_eq!(
            status.get_details_retry_info().unwrap().retry_delay,
            Some(AGAIN)
        );
    }
}
