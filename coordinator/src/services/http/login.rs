//! Login of browsers with a token.
//!
//! A page accepts a token. The browser stores the id of a session in a cookie, which it sends only to this
//! site and hides from scripts.

use std::sync::Arc;

use axum::Form;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use serde::Deserialize;
use tonic::Status;

use super::super::authorize;
use super::logins::LIFE;
use super::pages::{Nonce, html};
use super::site::{Site, failure};
use crate::access::{Access, Caller, TokenDigest};

/// Maximum size of the form, in bytes.
pub(super) const MAX_FORM: usize = 4096;
/// The login page. A stylesheet of one line replaces attributes that the content policy forbids.
const PAGE: &str = "<!doctype html><html lang=en><meta charset=utf-8><title>Sightline</title>\
    <style{{nonce}}>body{font:16px system-ui;max-width:32em;margin:4em auto}</style><h1>Sightline</h1>\
    <form method=post action=/login><p><label>A token with the scope admin<br>\
    <input name=token type=password autocomplete=off size=48 autofocus></label>\
    <p><button>Continue</button></form>\
    <p>The dashboard shows the jobs of all users. \
    `sightline token new --user NAME --scope admin` makes a token.";

/// The fields of the form.
#[derive(Deserialize)]
pub(super) struct LoginForm {
    token: String,
}

/// Returns the login page, which requests a token.
pub(super) async fn page() -> Response {
    let made =
        Nonce::random().map(|nonce| html(&nonce, PAGE.replace("{{nonce}}", &nonce.attribute())));
    made.unwrap_or_else(|status| failure(&status))
}

/// Returns the login page as the answer to a request without a valid token.
pub(super) async fn ask() -> Response {
    (StatusCode::UNAUTHORIZED, page().await).into_response()
}

/// Checks the submitted token and sets the login cookie.
pub(super) async fn login(State(site): State<Arc<Site>>, Form(sent): Form<LoginForm>) -> Response {
    // Without tokens, sessions do not exist.
    let Some(access) = site
        .coordinator
        .users
        .access
        .get()
        .filter(|access| access.has_tokens())
    else {
        return (StatusCode::SEE_OTHER, [(header::LOCATION, "/")]).into_response();
    };
    let token = sent.token.trim();
    if let Err(status) = authorize::admitted_with(access, Some(token), None, "/") {
        return failure(&status);
    }
    match site
        .logins
        .begin(TokenDigest::of_text(token), site.coordinator.now().at)
    {
        Ok(id) => {
            let cookie = cookie(site.port, site.is_encrypted, &id, LIFE.as_secs());
            let headers = [
                (header::SET_COOKIE, cookie),
                (header::LOCATION, "/".to_owned()),
            ];
            (StatusCode::SEE_OTHER, headers).into_response()
        }
        Err(e) => failure(&Status::internal(format!(
            "the session cannot be created without random numbers: {e}"
        ))),
    }
}

/// Ends the session of the browser.
pub(super) async fn logout(State(site): State<Arc<Site>>, headers: HeaderMap) -> Response {
    if let Some(id) = session(&site, &headers) {
        site.logins.end(id);
    }
    let cookie = cookie(site.port, site.is_encrypted, "", 0);
    let headers = [
        (header::SET_COOKIE, cookie),
        (header::LOCATION, "/login".to_owned()),
    ];
    (StatusCode::SEE_OTHER, headers).into_response()
}

/// Authenticates the caller of a request by its header or its session, and checks that the caller may make
/// the request.
pub(super) fn admitted(
    site: &Site,
    access: &Access,
    headers: &HeaderMap,
    path: &str,
) -> Result<Caller, Status> {
    let Some(id) = session(site, headers).filter(|_| !headers.contains_key(header::AUTHORIZATION))
    else {
        return authorize::admitted(access, headers, None, path);
    };
    let ended = || Status::unauthenticated("the session has ended; log in again at /login");
    let token = site
        .logins
        .token(id, site.coordinator.now().at)
        .ok_or_else(ended)?;
    authorize::admitted_by(access, path, |access| {
        access
            .identify_digest(&token)
            .inspect_err(|_| site.logins.end(id))
    })
}

/// Returns the id of the session in the cookie of this port.
fn session<'a>(site: &Site, headers: &'a HeaderMap) -> Option<&'a str> {
    let name = name(site.port);
    let cookies = headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok());
    let mut own = cookies
        .flat_map(|text| text.split(';'))
        .filter_map(|pair| pair.trim().split_once('='));
    own.find(|(found, _)| *found == name).map(|(_, id)| id)
}

/// Returns the name of the cookie. Browsers send the cookies of a host to all its ports, so the name contains
/// the port.
fn name(port: u16) -> String {
    format!("sightline-session-{port}")
}

/// Returns the cookie with a session's id, which expires after the given number of seconds.
fn cookie(port: u16, is_encrypted: bool, id: &str, seconds: u64) -> String {
    let secure = if is_encrypted { "; Secure" } else { "" };
    format!(
        "{}={id}; Path=/; HttpOnly; SameSite=Strict; Max-Age={seconds}{secure}",
        name(port)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cookie_is_hidden_from_scripts_other_sites_and_other_ports() {
        let parts = |is_encrypted| -> Vec<String> {
            cookie(7601, is_encrypted, "id", LIFE.as_secs())
                .split("; ")
                .map(str::to_owned)
                .collect()
        };
        let plain = [
            "sightline-session-7601=id",
            "Path=/",
            "HttpOnly",
            "SameSite=Strict",
            "Max-Age=43200",
        ];
        assert_eq!(parts(false), plain);
        assert_eq!(parts(true), [&plain[..], &["Secure"]].concat());
        assert!(cookie(7601, true, "", 0).contains("Max-Age=0"));
    }
}
