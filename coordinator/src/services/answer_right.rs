//! Answers that hold a right, such as the right to their call, until the last byte is sent. A stream holds
//! the right until its end.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use axum::response::Response;
use http_body::{Body as HttpBody, Frame, SizeHint};

/// The body of an answer that holds a right.
struct WithRight<T> {
    body: Body,
    _right: T,
}

/// Returns the answer with a body that drops `right` at its end.
pub(super) fn until_end<T: Send + Unpin + 'static>(answer: Response, right: T) -> Response {
    answer.map(|body| {
        Body::new(WithRight {
            body,
            _right: right,
        })
    })
}

impl<T: Unpin> HttpBody for WithRight<T> {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
