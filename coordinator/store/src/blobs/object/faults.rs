//! Conversion of object store errors into blob errors, with the operation, the object and a remedy. Only the
//! error code of the store's answer is kept, because the rest may contain the signed text and the key id.

use std::error::Error as StdError;

use object_store::Error;
use object_store::client::{HttpError, HttpErrorKind};

use super::super::error::BlobError;

/// Returns the blob error for `e`, which occurred during an operation (`doing`) on the object at `place`.
pub(super) fn blob_error(doing: &'static str, place: &str, e: &Error) -> BlobError {
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
            // Internal faults of the store are transient.
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
                reason: "without an S3 error code".to_owned(),
            },
        },
        (_, code) => BlobError::Object {
            doing,
            place,
            reason: code.unwrap_or("without an S3 error code").to_owned(),
        },
    }
}

/// Returns the reason why a request got no answer: the innermost error, which contains no address.
fn http(e: &Error) -> Option<String> {
    let mut source: Option<&(dyn StdError + 'static)> = e.source();
    while let Some(e) = source {
        if let Some(http) = e.downcast_ref::<HttpError>() {
            let mut inner: &dyn StdError = http;
            while let Some(deeper) = inner.source() {
                inner = deeper;
            }
            let stage = match http.kind() {
                HttpErrorKind::Connect => "no connection",
                HttpErrorKind::Timeout => "no answer in time",
                _ => "the connection broke",
            };
            return Some(format!("{stage}: {inner}"));
        }
        source = e.source();
    }
    None
}

/// Returns the status from the text of an error, as object_store formats it.
fn status(text: &str) -> Option<&str> {
    let (_, rest) = text.split_once("status code: ")?;
    rest.get(..3)
        .filter(|status| status.bytes().all(|b| b.is_ascii_digit()))
}

/// Returns the S3 error code between two tags of an answer.
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
    fn error_contains_only_code_of_answer() {
        let body = "Server returned non-2xx status code: 400 Bad Request: <Error><Code>KeyTooLong</Code>\
                    <StringToSign>hush</StringToSign></Error>";
        let e = blob_error("write", "s3://farm", &generic(body));
        assert!(
            matches!(&e, BlobError::Object { reason, .. } if reason == "KeyTooLong"),
            "{e}"
        );
        assert!(!format!("{e} {e:?}").contains("hush"));
        let e = blob_error(
            "write",
            "s3://farm",
            &generic("status code: 503 Service Unavailable: hush"),
        );
        assert!(
            matches!(&e, BlobError::Unreachable { reason, .. } if reason == "status 503"),
            "{e}"
        );
        let e = blob_error(
            "write",
            "s3://farm",
            &generic("<Code>InvalidAccessKeyId</Code>"),
        );
        assert!(matches!(e, BlobError::Refused { .. }), "{e}");
        let e = blob_error(
            "write",
            "s3://farm",
            &generic("<Code>not a code: hush</Code>"),
        );
        assert!(!format!("{e} {e:?}").contains("hush"));
    }
}
