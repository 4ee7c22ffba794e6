//! Errors of the object store as errors of blobs: what was done where, and what to do now. Of a store's
//! answer they have its code alone, for the rest may have what was signed and by which key.

use std::error::Error as StdError;

use object_store::Error;
use object_store::client::{HttpError, HttpErrorKind};

use super::super::error::BlobError;

/// The error for `e`, met while `doing` something to what is at `place`.
pub(super) fn of(doing: &'static str, place: &str, e: &Error) -> BlobError {
    let (doing, place) = (doing, place.to_owned());
    let text = e.to_string();
    let code = between(&text, "<Code>", "</Code>");
    match (e, code) {
        (_, Some("NoSuchBucket")) => BlobError::NoBucket { place },
        (Error::NotFound { .. }, _) => BlobError::Missing { path: place.into() },
        (Error::PermissionDenied { .. } | Error::Unauthenticated { .. }, code) => {
            BlobError::Refused {
                doing,
                place,
                reason: code.unwrap_or("no reason given").to_owned(),
            }
        }
        (
            _,
            Some(
                code @ ("InvalidAccessKeyId"
                | "ExpiredToken"
                | "InvalidToken"
                | "SignatureDoesNotMatch"),
            ),
        ) => BlobError::Refused {
            doing,
            place,
            reason: code.to_owned(),
        },
        (Error::Generic { .. }, code) => match (http(e), code, status(&text)) {
            (Some(reason), _, _) => BlobError::Unreachable {
                doing,
                place,
                reason,
            },
            // The store's own troubles pass.
            (None, code, Some(status @ ("429" | "500" | "502" | "503" | "504"))) => {
                let reason = code.map_or_else(|| format!("status {status}"), str::to_owned);
                BlobError::Unreachable {
                    doing,
                    place,
                    reason,
                }
            }
            (None, Some(code), _) => BlobError::Object {
                doing,
                place,
                reason: code.to_owned(),
            },
            (None, None, Some(status)) => BlobError::Object {
                doing,
                place,
                reason: format!("status {status}"),
            },
            (None, None, None) => BlobError::Object {
                doing,
                place,
                reason: "no answer of S3".to_owned(),
            },
        },
        (_, code) => BlobError::Object {
            doing,
            place,
            reason: code.unwrap_or("no answer of S3").to_owned(),
        },
    }
}

/// What kept a request from being answered: the innermost error, which has no address.
fn http(e: &Error) -> Option<String> {
    let mut source: Option<&(dyn StdError + 'static)> = e.source();
    while let Some(e) = source {
        if let Some(http) = e.downcast_ref::<HttpError>() {
            let mut inner: &dyn StdError = http;
            while let Some(deeper) = inner.source() {
                inner = deeper;
            }
            let during = match http.kind() {
                HttpErrorKind::Connect => "no connection",
                HttpErrorKind::Timeout => "too late",
                _ => "the connection broke",
            };
            return Some(format!("{during}: {inner}"));
        }
        source = e.source();
    }
    None
}

/// The status in the text of an error, as object_store writes it.
fn status(text: &str) -> Option<&str> {
    let (_, rest) = text.split_once("status code: ")?;
    rest.get(..3)
        .filter(|status| status.bytes().all(|b| b.is_ascii_digit()))
}

/// A code of S3 between two marks.
fn between<'a>(text: &'a str, from: &str, to: &str) -> Option<&'a str> {
    let code = text.split_once(from)?.1.split_once(to)?.0;
    (code.len() <= 64 && code.bytes().all(|b| b.is_ascii_alphanumeric())).then_some(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn generic(text: &str) -> Error {
        Error::Generic {
            store: "S3",
            source: text.into(),
        }
    }

    #[test]
    fn an_answer_gives_its_code_and_nothing_else() {
        let body = "Server returned non-2xx status code: 400 Bad Request: <Error><Code>KeyTooLong</Code>\
                    <StringToSign>hush</StringToSign></Error>";
        let e = of("write", "s3://farm", &generic(body));
        assert!(
            matches!(&e, BlobError::Object { reason, .. } if reason == "KeyTooLong"),
            "{e}"
        );
        assert!(!format!("{e} {e:?}").contains("hush"));
        let e = of(
            "write",
            "s3://farm",
            &generic("status code: 503 Service Unavailable: hush"),
        );
        assert!(
            matches!(&e, BlobError::Unreachable { reason, .. } if reason == "status 503"),
            "{e}"
        );
        let e = of(
            "write",
            "s3://farm",
            &generic("<Code>InvalidAccessKeyId</Code>"),
        );
        assert!(matches!(e, BlobError::Refused { .. }), "{e}");
        let e = of(
            "write",
            "s3://farm",
            &generic("<Code>not a code: hush</Code>"),
        );
        assert!(!format!("{e} {e:?}").contains("hush"));
    }
}
