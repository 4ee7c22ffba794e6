//! The server of `sightline view`: the page, and exact answers about the triangles that the user clicks.

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
use sightline::{CellIndex, NamedResult, TriangleId, explain_as_message};
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use tokio::sync::Mutex;

/// The URL path at which the server answers a [`PageQuestion`].
pub const PATH: &str = "/why";

/// The page and the data of its answers.
struct Served {
    page: String,
    result: PathBuf,
    pvs: Pvs,
    scene: Option<Arc<Scene>>,
    /// The lock that limits the server to one query at a time. Each query uses a core and the memory of the
    /// prepared scene.
    turn: Arc<Mutex<()>>,
}

/// A query of the page.
#[derive(Clone, Copy, Debug, Deserialize)]
struct PageQuestion {
    cell: CellIndex,
    triangle: TriangleId,
}

/// Returns the routes of the server.
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

/// Rejects requests of other sites, which could reach this address under their own host names.
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
        return (
            StatusCode::FORBIDDEN,
            "the server answers only its own page, at the host 127.0.0.1 or \
         localhost\n",
        )
            .into_response();
    }
    next.run(request).await
}

/// Returns the origin of this server's own page.
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
    // A form of another site cannot send this content type.
    if headers
        .get(header::CONTENT_TYPE)
        .is_none_or(|kind| kind.as_bytes() != b"application/json")
    {
        return refuse("send the request with content-type: application/json");
    }
    let asked: PageQuestion = match serde_json::from_slice(&body) {
        Ok(asked) => asked,
        Err(e) => {
            return refuse(&format!(
                "send a request such as {{\"cell\":0,\"triangle\":0}}: {e}"
            ));
        }
    };
    // The query owns the lock, because it continues if the browser no longer waits.
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
    if cell.0 >= pvs.cells() || triangle.0 >= pvs.triangle_count() {
        return Err(format!(
            "cell {cell} or triangle {triangle} does not exist in the result"
        ));
    }
    let result = NamedResult::new(pvs, result);
    let answer = explain_as_message(result, scene, cell, triangle, &|| false);
    let answer = answer.map_err(|e| e.to_string())?;
    serde_json::to_string(&answer).map_err(|e| e.to_string())
}
