//! Passes calls on to the coordinator that leads: requests and answers as they are, streams included.
//!
//! A connection of HTTP/2 carries a bounded number of streams at a time, and workers and watchers keep theirs
//! open. So there are as many connections with the leader as the calls need.

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body::Frame;
use sightline_proto::connecting::Credentials;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, HeaderValue, Request, Response};
use tonic::transport::{Channel, Endpoint};
use tower::ServiceExt as _;

/// Calls at a time over one connection.
const CALLS: usize = 100;
/// Connections at a time; further calls are refused.
const CONNECTIONS: usize = 100;
/// How long the leader may keep silent before a connection counts as lost.
const SILENCE: Duration = Duration::from_secs(2);
/// Marks calls that were passed on, which are passed on once at most.
const FORWARDED: &str = "sightline-forwarded";

/// The way to a leader.
pub(super) struct Forwarder {
    address: String,
    endpoint: Endpoint,
    connections: Mutex<Vec<(Channel, Arc<Semaphore>)>>,
    /// Becomes true when it leads no more.
    over: watch::Sender<bool>,
}

impl Forwarder {
    /// The way to the leader at `address`.
    ///
    /// # Errors
    /// A sentence that says why nothing can be called there.
    pub(super) fn to(address: &str, credentials: &Credentials) -> Result<Self, String> {
        let endpoint = credentials.endpoint(address)?;
        let endpoint = endpoint
            .http2_keep_alive_interval(SILENCE)
            .keep_alive_timeout(SILENCE)
            .connect_timeout(SILENCE);
        let (over, _) = watch::channel(false);
        Ok(Self {
            address: address.to_owned(),
            endpoint,
            connections: Mutex::default(),
            over,
        })
    }

    /// Ends all calls to it: it does not lead any more.
    pub(super) fn end(&self) {
        self.over.send_replace(true);
    }

    /// Passes a call on and gives its answer.
    pub(super) async fn forward<B>(&self, mut request: Request<B>) -> Response<Body>
    where
        B: http_body::Body<Data = Bytes> + Send + 'static,
        B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        if request.headers().contains_key(FORWARDED) {
            let text = "this coordinator does not lead, and the one that passed the call on has not heard \
                        of it";
            return Status::unavailable(text).into_http();
        }
        request
            .headers_mut()
            .insert(FORWARDED, HeaderValue::from_static("1"));
        let Some((channel, permit)) = self.connection() else {
            return self.lost("too many calls are passed on to it").into_http();
        };
        let mut over = self.over.subscribe();
        let answer = tokio::select! {
            answer = channel.oneshot(request.map(Body::new)) => answer,
            _ = over.wait_for(|over| *over) => return self.lost("it does not lead any more").into_http(),
        };
        match answer {
            Ok(answer) => {
                let address = self.address.clone();
                let over = Box::pin(async move { drop(over.wait_for(|over| *over).await) });
                answer.map(|body| {
                    Body::new(Forwarded {
                        body,
                        over,
                        address,
                        ended: false,
                        _permit: permit,
                    })
                })
            }
            Err(e) => {
                let reason = std::error::Error::source(&e)
                    .map_or_else(|| e.to_string(), ToString::to_string);
                self.lost(&reason).into_http()
            }
        }
    }

    fn lost(&self, why: &str) -> Status {
        lost(&self.address, why)
    }

    /// A connection with room for a call.
    fn connection(&self) -> Option<(Channel, OwnedSemaphorePermit)> {
        let mut connections = self
            .connections
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        for (channel, calls) in connections.iter() {
            if let Ok(permit) = Arc::clone(calls).try_acquire_owned() {
                return Some((channel.clone(), permit));
            }
        }
        if connections.len() == CONNECTIONS {
            return None;
        }
        let (channel, calls) = (
            self.endpoint.connect_lazy(),
            Arc::new(Semaphore::new(CALLS)),
        );
        let permit = Arc::clone(&calls).try_acquire_owned().ok()?;
        connections.push((channel.clone(), calls));
        Some((channel, permit))
    }
}

fn lost(address: &str, why: &str) -> Status {
    Status::unavailable(format!(
        "the leading coordinator at {address} does not answer ({why}); try again"
    ))
}

/// The body of an answer. When it breaks off, callers get a status that tells them to try again.
struct Forwarded {
    body: Body,
    over: Pin<Box<dyn Future<Output = ()> + Send>>,
    address: String,
    ended: bool,
    _permit: OwnedSemaphorePermit,
}

impl http_body::Body for Forwarded {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.ended {
            return Poll::Ready(None);
        }
        let why = match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(Some(Err(e))) => e.message().to_owned(),
            Poll::Ready(frame) => return Poll::Ready(frame),
            Poll::Pending => match self.over.as_mut().poll(context) {
                Poll::Ready(()) => "it does not lead any more".to_owned(),
                Poll::Pending => return Poll::Pending,
            },
        };
        self.ended = true;
        let mut trailers = HeaderMap::new();
        Poll::Ready(Some(
            lost(&self.address, &why)
                .add_header(&mut trailers)
                .map(|()| Frame::trailers(trailers)),
        ))
    }

    fn is_end_stream(&self) -> bool {
        self.ended || self.body.is_end_stream()
    }
}
