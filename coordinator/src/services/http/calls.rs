//! The unary calls of the services as JSON over HTTP.

use std::sync::Arc;

use axum::Extension;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sightline_proto::v1::farm_server::Farm as _;
use sightline_proto::v1::jobs_server::Jobs as _;
use sightline_proto::v1::results_server::Results as _;
use tonic::{Request, Status};

use super::site::{Site, failure, is_json, json};
use crate::access::Caller;

/// Calls the listed method with this name.
macro_rules! call_by_name {
    ($service:expr, $caller:expr, $method:expr, $body:expr, { $($name:literal => $call:ident,)* }) => {
        match $method {
            $($name => answer($body, $caller, async |request| $service.$call(request).await).await,)*
            _ => Err(unknown()),
        }
    };
}

/// Handles a call over HTTP.
pub(super) async fn call(
    State(site): State<Arc<Site>>,
    Path((service, method)): Path<(String, String)>,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    let caller = caller.map(|Extension(caller)| caller);
    if !is_json(&headers) {
        return failure(&Status::invalid_argument(
            "send the request with content-type: application/json",
        ));
    }
    let (method, body) = (method.as_str(), &body[..]);
    let answered = match service.as_str() {
        "sightline.v1.Jobs" => call_by_name!(site.jobs, caller, method, body, {
            "MissingChunks" => missing_chunks,
            "PutScene" => put_scene,
            "PutReceivers" => put_receivers,
            "Submit" => submit,
            "Estimate" => estimate,
            "List" => list,
            "Show" => show,
            "Cancel" => cancel,
            "Pause" => pause,
            "Resume" => resume,
            "Prioritize" => prioritize,
            "Retry" => retry,
            "Delete" => delete,
        }),
        "sightline.v1.Farm" => call_by_name!(site.farm, caller, method, body, {
            "ListWorkers" => list_workers,
            "ListTiles" => list_tiles,
            "Invalidate" => invalidate,
            "ReleaseWorker" => release_worker,
        }),
        "sightline.v1.Results" => call_by_name!(site.results, caller, method, body, {
            "Query" => query,
            "Why" => why,
            "Measure" => measure,
        }),
        _ => Err(unknown()),
    };
    answered.map_or_else(|status| failure(&status), json)
}

fn unknown() -> Status {
    Status::unimplemented(
        "the call does not exist; use POST /sightline.v1.Jobs/List, for example; streams are \
         available only through gRPC",
    )
}

/// Decodes a request, calls the service, and encodes the answer.
async fn answer<Q: DeserializeOwned, A: Serialize>(
    body: &[u8],
    caller: Option<Caller>,
    call: impl AsyncFnOnce(Request<Q>) -> Result<tonic::Response<A>, Status>,
) -> Result<String, Status> {
    let body = if body.is_empty() { b"{}" } else { body };
    let request: Q = serde_json::from_slice(body).map_err(|e| {
        Status::invalid_argument(format!("the request is not a valid message as JSON: {e}"))
    })?;
    let mut request = Request::new(request);
    if let Some(caller) = caller {
        request.extensions_mut().insert(caller);
    }
    let answered = call(request).await?.into_inner();
    serde_json::to_string(&answered).map_err(|e| Status::internal(e.to_string()))
}
