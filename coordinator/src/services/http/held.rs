//! An answer that holds the right to its call until its last byte is sent: a stream counts as long as it is
//! open.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use axum::response::Response;
use http_body::{Body as HttpBody, Frame, SizeHint};

use crate::limits::Permit;

/// The body of an answer, with the right to its call.
struct Held {
    body: Body,
    _permit: Permit,
}

/// The answer, which gives the right back at its end.
pub(super) fn until_end(answer: Response, permit: Permit) -> Response {
    answer.map(|body| Body::new(Held { body, _permit: permit }))
}

impl HttpBody for Held {
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
