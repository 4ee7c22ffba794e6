//! The server of `sightline view`: the page, and exact answers about what is clicked in it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Router;
use axum::body::Bytes;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, post};
use serde::Deserialize;
use serde_json::json;
use sightline::{NamedResult, explain_as_message};
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use tokio::sync::Mutex;

/// The path of exact answers.
pub const PATH: &str = "/why";

/// What the answers are about.
struct Served {
    page: String,
    result: PathBuf,
    pvs: Pvs,
    scene: Option<Arc<Scene>>,
    /// One question at a time: each takes a core and the memory of the prepared scene.
    turn: Arc<Mutex<()>>,
}

/// What the page asks.
#[derive(Clone, Copy, Debug, Deserialize)]
struct PageQuestion {
    cell: u32,
    triangle: u32,
}

/// The routes of the server.
pub fn pages(page: String, result: &Path, pvs: Pvs, scene: Option<Arc<Scene>>) -> Router {
    let served = Served {
        page,
        result: result.to_owned(),
        pvs,
        scene,
        turn: Arc::default(),
    };
    Router::new()
        .route("/", get(html))
        .route(PATH, post(why))
        .layer(middleware::from_fn(only_by_this_machine))
        .with_state(Arc::new(served))
}

/// Refuses the pages of other sites, which could reach this address under a name of their own.
async fn only_by_this_machine(headers: HeaderMap, request: Request, next: Next) -> Response {
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok())
        .unwrap_or("");
    let name = host
        .split(':')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    let is_own = headers
        .get(header::ORIGIN)
        .is_none_or(|origin| origin.as_bytes() == own(host).as_bytes());
    if !["127.0.0.1", "localhost"].contains(&name.as_str()) || !is_own {
        return (StatusCode::FORBIDDEN, "ask for 127.0.0.1\n").into_response();
    }
    next.run(request).await
}

/// The origin of this server's own page.
fn own(host: &str) -> String {
    format!("http://{host}")
}

async fn html(State(served): State<Arc<Served>>) -> Response {
    let kind = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    (kind, served.page.clone()).into_response()
}

async fn why(State(served): State<Arc<Served>>, headers: HeaderMap, body: Bytes) -> Response {
    let json = |status, text: String| {
        (status, [(header::CONTENT_TYPE, "application/json")], text).into_response()
    };
    let refuse = |message: &str| {
        json(
            StatusCode::BAD_REQUEST,
            json!({"message": message}).to_string(),
        )
    };
    // A form of another site cannot name this type.
    if headers
        .get(header::CONTENT_TYPE)
        .is_none_or(|kind| kind.as_bytes() != b"application/json")
    {
        return refuse("ask with content-type: application/json");
    }
    let asked: PageQuestion = match serde_json::from_slice(&body) {
        Ok(asked) => asked,
        Err(e) => return refuse(&format!("ask as {{\"cell\":0,\"triangle\":0}}: {e}")),
    };
    // The turn goes with the query, which runs on when the browser does not wait for it.
    let turn = Arc::clone(&served.turn).lock_owned().await;
    let query = move || {
        let _turn = turn;
        answer(&served, asked)
    };
    let answer = tokio::task::spawn_blocking(query).await;
    match answer.unwrap_or_else(|e| Err(e.to_string())) {
        Ok(answer) => json(StatusCode::OK, answer),
        Err(message) => refuse(&message),
    }
}

fn answer(
    served: &Served,
    PageQuestion { cell, triangle }: PageQuestion,
) -> Result<String, String> {
    let Served {
        pvs, scene, result, ..
    } = served;
    let scene = scene.as_ref().ok_or("the page has no scene")?;
    if cell >= pvs.cells() || triangle >= pvs.triangle_count() {
        return Err(format!("there is no cell {cell} or no triangle {triangle}"));
    }
    let result = NamedResult::new(pvs, result);
    let answer = explain_as_message(result, scene, (cell, triangle), &|| false);
    let answer = answer.map_err(|e| e.to_string())?;
    serde_json::to_string(&answer).map_err(|e| e.to_string())
}
