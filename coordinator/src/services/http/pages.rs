//! The pages: the dashboard, a result in the viewer, and downloads of results.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures::StreamExt as _;
use serde::Deserialize;
use sightline_pvs::Pvs;
use sightline_records::JobPhase;
use sightline_records::ids::JobId;
use sightline_view::{View, ViewRequest, dashboard as dashboard_page, page};
use tonic::Status;

use super::super::blocking::{blocking, in_turn};
use super::super::jobs::{begin_file, file_name, so_far, take_file};
use super::super::status;
use super::site::{Site, failure, json};
use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::results::partial;
use crate::results::queries;
use crate::uploads::spool::Spool;

/// The random word that permits a page's own style and script.
#[derive(Clone, Debug)]
pub(super) struct Nonce(String);

impl Nonce {
    /// Draws a random word.
    ///
    /// # Errors
    /// INTERNAL if the system has no random numbers.
    pub(super) fn random() -> Result<Self, Status> {
        let mut random = [0; 16];
        let failed = |e| {
            Status::internal(format!(
                "the page cannot be created without random numbers: {e}"
            ))
        };
        getrandom::fill(&mut random).map_err(failed)?;
        Ok(Self(STANDARD.encode(random)))
    }

    /// Returns the attribute for the page's style and script, with a leading space.
    pub(super) fn attribute(&self) -> String {
        format!(" nonce=\"{}\"", self.0)
    }
}

/// Returns a page as an answer. The content policy permits only styles and scripts with the nonce, and no
/// content from elsewhere.
pub(super) fn html(Nonce(nonce): &Nonce, text: String) -> Response {
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src data:; \
         connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    );
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
        (header::CACHE_CONTROL, "no-store".to_owned()),
        (header::CONTENT_SECURITY_POLICY, policy),
    ];
    (headers, text).into_response()
}

/// Returns the dashboard. If callers need tokens, it has a button that ends the session.
pub(super) async fn dashboard(State(site): State<Arc<Site>>) -> Response {
    let has_sessions = site
        .coordinator
        .users
        .access
        .get()
        .is_some_and(|access| access.has_tokens());
    let made =
        Nonce::random().map(|nonce| html(&nonce, dashboard_page(&nonce.attribute(), has_sessions)));
    made.unwrap_or_else(|status| failure(&status))
}

/// Returns the result of a job as a file, or the partial result of an open job. The file `7.pvs` is the
/// result of job 7.
pub(super) async fn result(
    State(site): State<Arc<Site>>,
    Path(file): Path<String>,
    caller: Option<Extension<Caller>>,
) -> Response {
    let Some(job) = file
        .strip_suffix(".pvs")
        .and_then(|number| number.parse().ok())
    else {
        return failure(&Status::not_found(
            "the path names no result; results are at /results/JOB.pvs",
        ));
    };
    let caller = caller.map_or(Caller::Nobody, |Extension(caller)| caller);
    match so_far(&site.coordinator, caller.owner(), JobId(job)).await {
        Ok(stream) => {
            let body = Body::from_stream(stream.map(|chunk| chunk.map(|chunk| chunk.data)));
            ([(header::CONTENT_TYPE, "application/octet-stream")], body).into_response()
        }
        Err(s) => failure(&s),
    }
}

/// The name of an uploaded file.
#[derive(Deserialize)]
pub(super) struct Named {
    name: String,
}

/// Reads a scene from a file in the body of the request.
pub(super) async fn put_scene(
    State(site): State<Arc<Site>>,
    Query(Named { name }): Query<Named>,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    // A form of another site can send other content types without the user's consent.
    if headers
        .get(header::CONTENT_TYPE)
        .is_none_or(|kind| kind != "application/octet-stream")
    {
        return failure(&Status::invalid_argument(
            "send the file with content-type: application/octet-stream",
        ));
    }
    let caller = caller.map_or(Caller::Nobody, |Extension(caller)| caller);
    let c = &site.coordinator;
    let taken = async {
        let name = file_name(name)?;
        let length = headers
            .get(header::CONTENT_LENGTH)
            .and_then(|value| value.to_str().ok()?.parse().ok());
        let length = length.ok_or_else(|| {
            Status::invalid_argument(
                "the length of the file is missing; send the header content-length",
            )
        })?;
        let spool = spooled(c, begin_file(c, &caller, length).await?, body).await?;
        take_file(c, caller, name, Vec::new(), spool).await
    };
    match taken.await.map(|info| serde_json::to_string(&info)) {
        Ok(Ok(text)) => json(text),
        Ok(Err(e)) => failure(&Status::internal(e.to_string())),
        Err(s) => failure(&s),
    }
}

/// Appends the parts of a body to a spool.
async fn spooled(c: &Arc<Coordinator>, mut spool: Spool, body: Body) -> Result<Spool, Status> {
    let mut parts = body.into_data_stream();
    while let Some(part) = parts.next().await {
        let part = part.map_err(|e| Status::from_error(e.into()))?;
        // Writing may block on the disk.
        spool = blocking(c, move |c| {
            spool
                .append(&*c.blobs, &part)
                .map_err(|e| status::of_spool(&e))?;
            Ok(spool)
        })
        .await?;
    }
    spool.digest().map_err(|e| status::of_spool(&e))?;
    Ok(spool)
}

/// Returns a page with the result of a job, or the partial result of an open job, in the viewer.
pub(super) async fn view(
    State(site): State<Arc<Site>>,
    Path(job): Path<u64>,
    caller: Option<Extension<Caller>>,
) -> Response {
    let c = &site.coordinator;
    let nonce = match Nonce::random() {
        Ok(nonce) => nonce,
        Err(status) => return failure(&status),
    };
    let attribute = nonce.attribute();
    let caller = caller.map_or(Caller::Nobody, |Extension(caller)| caller);
    let made = move |c: &Arc<Coordinator>, is_gone: &(dyn Fn() -> bool + Sync)| {
        page_of(c, JobId(job), attribute, is_gone)
    };
    match in_turn(c, &c.results.questions, caller.owner(), made).await {
        Ok(text) => html(&nonce, text),
        Err(s) => {
            let mut answer = failure(&s);
            // A browser shows this text in its own window.
            let text = HeaderValue::from_static("text/plain; charset=utf-8");
            answer.headers_mut().insert(header::CONTENT_TYPE, text);
            *answer.body_mut() = Body::from(s.message().to_owned());
            answer
        }
    }
}

fn page_of(
    c: &Coordinator,
    id: JobId,
    nonce: String,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<String, Status> {
    let broken = |e: &dyn std::fmt::Display| status::internal(&e.to_string());
    let (record, scene) =
        queries::scene(&c.records, &*c.blobs, id).map_err(|e| status::of_ask(&e))?;
    queries::has_sets(&record).map_err(|e| status::of_ask(&e))?;
    let bytes = partial::so_far(c, id, is_gone).map_err(|e| status::of_partial(&e))?;
    let pvs = Pvs::from_bytes(bytes).map_err(|e| broken(&e))?;
    let mut view = View::new(&pvs, Some(&scene)).map_err(|e| broken(&e))?;
    view.nonce = nonce;
    view.title = format!("job {id}: {}", record.name);
    let is_over = record.state.phase().ended();
    view.about = match is_over {
        true => format!("the result of job {id}"),
        false => format!("job {id} so far: cells that are not done show everything, as undecided"),
    };
    if record.state.phase() == JobPhase::Done {
        view.ask = ViewRequest::about(&scene, "/sightline.v1.Results/Why", Some(id.0));
    }
    page(&view).map_err(|e| broken(&e))
}
