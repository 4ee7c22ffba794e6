//! Time limits of a request's body: for a silence between two parts, and for the whole body.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::Body;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Sleep;
use tonic::Status;

/// A body with a deadline for its end.
struct UntilDeadline {
    body: Body,
    deadline: Pin<Box<Sleep>>,
    limit: Duration,
}

/// Limits the time until the end of a body.
pub(super) fn until_deadline(body: Body, limit: Duration) -> Body {
    Body::new(UntilDeadline {
        body,
        deadline: Box::pin(tokio::time::sleep(limit)),
        limit,
    })
}

impl HttpBody for UntilDeadline {
    type Data = axum::body::Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if frame.is_pending() && self.deadline.as_mut().poll(context).is_ready() {
            let text = format!(
                "the request did not arrive within {:?}; send the request again",
                self.limit
            );
            return Poll::Ready(Some(Err(axum::Error::new(Status::deadline_exceeded(text)))));
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A body with a maximum time until its next part.
pub(super) struct UntilSilent<B> {
    body: B,
    limit: Duration,
    /// The end of the permitted silence, while the server waits for a part.
    silent: Option<Pin<Box<Sleep>>>,
}

impl<B> UntilSilent<B> {
    /// Limits the time between two parts of a body.
    pub(super) fn new(body: B, limit: Duration) -> Self {
        Self {
            body,
            limit,
            silent: None,
        }
    }
}

/// Limits the time between two parts of a body.
pub(super) fn until_silent(body: Body, limit: Duration) -> Body {
    Body::new(UntilSilent::new(body, limit))
}

impl<B: HttpBody + Unpin> HttpBody for UntilSilent<B>
where
    B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    type Data = B::Data;
    type Error = Box<dyn std::error::Error + Send + Sync>;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<B::Data>, Self::Error>>> {
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if frame.is_ready() {
            self.silent = None;
        } else {
            let limit = self.limit;
            let silent = self
                .silent
                .get_or_insert_with(|| Box::pin(tokio::time::sleep(limit)));
            if silent.as_mut().poll(context).is_ready() {
                let text =
                    format!("no part of the request arrived for {limit:?}; send the request again");
                return Poll::Ready(Some(Err(Status::deadline_exceeded(text).into())));
            }
        }
        frame.map(|frame| frame.map(|frame| frame.map_err(Into::into)))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use axum::body::Bytes;
    use futures::{FutureExt as _, StreamExt as _};
    use tokio::sync::mpsc;

    use super::*;

    #[tokio::test]
    async fn limit_runs_only_while_a_part_is_missing() {
        let (send, parts) = mpsc::channel::<Result<Bytes, Status>>(1);
        let parts = tokio_stream::wrappers::ReceiverStream::new(parts);
        let mut body = UntilSilent::new(Body::from_stream(parts), Duration::from_secs(3600));
        for _ in 0..3 {
            let next = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context));
            assert!(next.now_or_never().is_none() && body.silent.is_some());
            send.send(Ok(Bytes::from_static(b"part"))).await.unwrap();
            let next = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context));
            assert!(next.now_or_never().unwrap().unwrap().is_ok() && body.silent.is_none());
        }
    }

    #[tokio::test]
    async fn slow_body_ends_with_an_error() {
        // The body is endless and never silent for long.
        let parts = futures::stream::unfold((), |()| async {
            tokio::time::sleep(Duration::from_millis(1)).await;
            Some((Ok::<_, Status>(Bytes::from_static(b"a")), ()))
        });
        let mut body =
            until_deadline(Body::from_stream(parts), Duration::from_millis(50)).into_data_stream();
        let mut count = 0;
        let error = loop {
            match body.next().await.unwrap() {
                Ok(_) => count += 1,
                Err(e) => break e,
            }
        };
        assert!(
            count > 0 && error.to_string().contains("within 50ms"),
            "{count}: {error}"
        );
    }

    #[tokio::test]
    async fn silent_body_ends_with_an_error() {
        let parts = futures::stream::pending::<Result<Bytes, Status>>();
        let mut body =
            until_silent(Body::from_stream(parts), Duration::from_millis(5)).into_data_stream();
        let error = body.next().await.unwrap().unwrap_err();
        assert!(
            error
                .to_string()
                .contains("no part of the request arrived for 5ms"),
            "{error}"
        );
    }
}
