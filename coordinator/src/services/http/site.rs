//! The state that the HTTP routes share, and helpers for answers.

use std::sync::Arc;

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use tonic::{Code, Status};

use super::super::farm::FarmService;
use super::super::jobs::JobsService;
use super::super::results::ResultsService;
use super::logins::Logins;
use super::snapshot::Snapshots;
use crate::coordinator::Coordinator;

/// The state that the HTTP routes share.
pub(super) struct Site {
    pub(super) coordinator: Arc<Coordinator>,
    pub(super) jobs: JobsService,
    pub(super) farm: FarmService,
    pub(super) results: ResultsService,
    pub(super) snapshots: Arc<Snapshots>,
    /// True if only this machine can reach the address.
    pub(super) is_local: bool,
    /// True if connections are encrypted.
    pub(super) is_encrypted: bool,
    /// The port of the address.
    pub(super) port: u16,
    /// The sessions of browsers.
    pub(super) logins: Logins,
}

/// Returns true if the request's content type is JSON.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    let kind = headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .unwrap_or_default();
    kind.split(';')
        .next()
        .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
}

/// Returns an answer with a JSON body.
pub(super) fn json(text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, "application/json"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    (headers, text).into_response()
}

/// Converts a status into an answer, with the codes of the Connect protocol.
pub(super) fn failure(status: &Status) -> Response {
    let (code, name) = match status.code() {
        Code::InvalidArgument => (StatusCode::BAD_REQUEST, "invalid_argument"),
        Code::FailedPrecondition => (StatusCode::BAD_REQUEST, "failed_precondition"),
        Code::NotFound => (StatusCode::NOT_FOUND, "not_found"),
        Code::AlreadyExists => (StatusCode::CONFLICT, "already_exists"),
        Code::Aborted => (StatusCode::CONFLICT, "aborted"),
        Code::Unauthenticated => (StatusCode::UNAUTHORIZED, "unauthenticated"),
        Code::PermissionDenied => (StatusCode::FORBIDDEN, "permission_denied"),
        Code::ResourceExhausted => (StatusCode::TOO_MANY_REQUESTS, "resource_exhausted"),
        Code::Unavailable => (StatusCode::SERVICE_UNAVAILABLE, "unavailable"),
        Code::Unimplemented => (StatusCode::NOT_IMPLEMENTED, "unimplemented"),
        Code::DataLoss => (StatusCode::INTERNAL_SERVER_ERROR, "data_loss"),
        _ => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
    };
    let body = serde_json::json!({"code": name, "message": status.message()});
    (code, json(body.to_string())).into_response()
}
