//! Tokens of people: a page that takes a token and keeps it in a cookie, which the browser sends to this
//! site alone and shows to no program.

use std::sync::Arc;

use axum::Form;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use serde::Deserialize;
use tonic::Status;

use super::super::guard;
use super::pages::html;
use super::site::{Site, failure};
use crate::access::{Access, Caller};

/// The name of the cookie.
const COOKIE: &str = "sightline-token";
/// The page.
const PAGE: &str = "<!doctype html><html lang=en><meta charset=utf-8><title>Sightline</title>\
    <body style=\"font:16px system-ui;max-width:32em;margin:4em auto\"><h1>Sightline</h1>\
    <form method=post action=/login><p><label>A token with the scope admin<br>\
    <input name=token type=password autocomplete=off size=48 autofocus></label>\
    <p><button>Continue</button></form>\
    <p>The dashboard shows the jobs of all users. \
    `sightline token new --user NAME --scope admin` makes a token.";

/// What the form sends.
#[derive(Deserialize)]
pub(super) struct Sent {
    token: String,
}

/// The page that asks for a token.
pub(super) async fn page() -> Response {
    html(PAGE.to_owned())
}

/// The page that asks for a token, as the answer to a page that needs one.
pub(super) fn ask() -> Response {
    (StatusCode::UNAUTHORIZED, html(PAGE.to_owned())).into_response()
}

/// Takes a token that opens the pages.
pub(super) async fn login(State(site): State<Arc<Site>>, Form(sent): Form<Sent>) -> Response {
    let token = sent.token.trim();
    let known =
        site.coordinator.access.get().map(|access| guard::admitted_with(access, Some(token), None, "/"));
    match known {
        None => {}
        Some(Ok(_)) if token.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_') => {}
        Some(Ok(_)) => return failure(&Status::unauthenticated("the token has characters that none has")),
        Some(Err(status)) => return failure(&status),
    }
    let secure = if site.is_encrypted { "; Secure" } else { "" };
    let cookie = format!("{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict{secure}");
    (StatusCode::SEE_OTHER, [(header::SET_COOKIE, cookie), (header::LOCATION, "/".to_owned())])
        .into_response()
}

/// The caller of a request, by its header or its cookie, if it may make it.
pub(super) fn admitted(access: &Access, headers: &HeaderMap, path: &str) -> Result<Caller, Status> {
    if headers.contains_key(header::AUTHORIZATION) {
        return guard::admitted(access, headers, None, path);
    }
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut own = cookies.flat_map(|text| text.split(';')).filter_map(|pair| pair.trim().split_once('='));
    let token = own.find(|(name, _)| *name == COOKIE).map(|(_, token)| token);
    guard::admitted_with(access, token, None, path)
}
