//! The pages: the dashboard, a result in the viewer, and results to download.

use std::sync::Arc;

use axum::Extension;
use axum::body::{Body, Bytes};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use futures::StreamExt as _;
use serde::Deserialize;
use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_view::{Ask, View, dashboard as dashboard_page, page};
use tonic::Status;

use super::super::blocking::blocking_one_of;
use super::super::jobs::{so_far, take_file};
use super::super::status;
use super::site::{Site, failure, json};
use crate::access::Caller;
use crate::asking;
use crate::ids::JobId;
use crate::partial;
use crate::state::Coordinator;
use crate::store::JobPhase;

/// A page as an answer. It is its own program and loads nothing from elsewhere.
pub(super) fn html(text: String) -> Response {
    let policy = "default-src 'self' 'unsafe-inline' data: blob:; frame-ancestors 'none'";
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CACHE_CONTROL, "no-store"),
        (header::CONTENT_SECURITY_POLICY, policy),
    ];
    (headers, text).into_response()
}

/// The dashboard.
pub(super) async fn dashboard() -> Response {
    html(dashboard_page())
}

/// A result of a job, or what there is of it, as a file: `7.pvs` is that of job 7.
pub(super) async fn result(State(site): State<Arc<Site>>, Path(file): Path<String>) -> Response {
    let Some(job) = file.strip_suffix(".pvs").and_then(|number| number.parse().ok()) else {
        return failure(&Status::not_found("results are at /results/JOB.pvs"));
    };
    match so_far(&site.coordinator, JobId(job)).await {
        Ok(stream) => {
            let body = Body::from_stream(stream.map(|chunk| chunk.map(|chunk| chunk.data)));
            ([(header::CONTENT_TYPE, "application/octet-stream")], body).into_response()
        }
        Err(s) => failure(&s),
    }
}

/// The name of a file that is sent.
#[derive(Deserialize)]
pub(super) struct Named {
    name: String,
}

/// Reads a scene from a file, which is the body of the request.
pub(super) async fn put_scene(
    State(site): State<Arc<Site>>,
    Query(Named { name }): Query<Named>,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    // A form of another site can send other types without asking.
    if headers.get(header::CONTENT_TYPE).is_none_or(|kind| kind != "application/octet-stream") {
        return failure(&Status::invalid_argument(
            "send the file with content-type: application/octet-stream",
        ));
    }
    let caller = caller.map_or(Caller::Nobody, |Extension(caller)| caller);
    let file = v1::SceneFileHeader { name, rules: Vec::new() };
    match take_file(&site.coordinator, caller, file, body).await.map(|info| serde_json::to_string(&info)) {
        Ok(Ok(text)) => json(text),
        Ok(Err(e)) => failure(&Status::internal(e.to_string())),
        Err(s) => failure(&s),
    }
}

/// A result of a job, or what there is of it, in the viewer.
pub(super) async fn view(State(site): State<Arc<Site>>, Path(job): Path<u64>) -> Response {
    let c = &site.coordinator;
    match blocking_one_of(c, &c.scenes_in_memory, move |c| page_of(c, JobId(job))).await {
        Ok(text) => html(text),
        Err(s) => {
            let mut answer = failure(&s);
            // People read this in a window of their own.
            let text = HeaderValue::from_static("text/plain; charset=utf-8");
            answer.headers_mut().insert(header::CONTENT_TYPE, text);
            *answer.body_mut() = Body::from(s.message().to_owned());
            answer
        }
    }
}

fn page_of(c: &Coordinator, id: JobId) -> Result<String, Status> {
    let broken = |e: &dyn std::fmt::Display| status::internal(&e.to_string());
    let (record, scene) = asking::scene(c, id).map_err(|e| status::of_ask(&e))?;
    asking::has_sets(&record).map_err(|e| status::of_ask(&e))?;
    let bytes = partial::so_far(c, id).map_err(|e| status::of_partial(&e))?;
    let pvs = Pvs::from_bytes(bytes).map_err(|e| broken(&e))?;
    let mut view = View::of(&pvs, Some(&scene)).map_err(|e| broken(&e))?;
    view.title = format!("job {id}: {}", record.name);
    let is_over = record.state.phase().ended();
    view.about = match is_over {
        true => format!("the result of job {id}"),
        false => format!("job {id} so far: cells that are not done show everything, as undecided"),
    };
    if record.state.phase() == JobPhase::Done {
        view.ask = Ask::about(&scene, "/sightline.v1.Results/Why", Some(id.0));
    }
    page(&view).map_err(|e| broken(&e))
}
