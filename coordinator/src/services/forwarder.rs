//! The forwarder of calls to the leading coordinator. Requests and answers stay unchanged, including streams.
//!
//! An HTTP/2 connection carries a bounded number of simultaneous streams, and workers and watchers keep
//! theirs open. So the forwarder opens as many connections to the leader as the calls need.

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body::Frame;
use sightline_proto::connection::Credentials;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, HeaderValue, Request, Response};
use tonic::transport::{Channel, Endpoint};
use tower::ServiceExt as _;

/// Maximum number of simultaneous calls per connection.
const CALLS: usize = 100;
/// Maximum number of simultaneous connections. Further calls are rejected.
const CONNECTIONS: usize = 100;
/// The time of silence after which a connection to the leader counts as lost.
const SILENCE: Duration = Duration::from_secs(2);
/// The header of forwarded calls. A call is forwarded at most once.
const FORWARDED: &str = "sightline-forwarded";

/// The connections to a leader.
pub(super) struct Forwarder {
    address: String,
    endpoint: Endpoint,
    connections: Mutex<Vec<(Channel, Arc<Semaphore>)>>,
    /// The channel that becomes true when the coordinator no longer leads.
    over: watch::Sender<bool>,
}

impl Forwarder {
    /// Creates a forwarder to the leader at `address`.
    ///
    /// # Errors
    /// A sentence with the reason, if the address or the credentials cannot be used.
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

    /// Ends all calls to the coordinator, which no longer leads.
    pub(super) fn end(&self) {
        self.over.send_replace(true);
    }

    /// Forwards a call and returns its answer.
    pub(super) async fn forward<B>(&self, mut request: Request<B>) -> Response<Body>
    where
        B: http_body::Body<Data = Bytes> + Send + 'static,
        B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        if request.headers().contains_key(FORWARDED) {
            let text = "this coordinator does not lead, and the coordinator that forwarded the call \
                        does not know the new leader";
            return Status::unavailable(text).into_http();
        }
        request
            .headers_mut()
            .insert(FORWARDED, HeaderValue::from_static("1"));
        let Some((channel, permit)) = self.connection() else {
            return self.lost("too many forwarded calls are open").into_http();
        };
        let mut over = self.over.subscribe();
        let answer = tokio::select! {
            answer = channel.oneshot(request.map(Body::new)) => answer,
            _ = over.wait_for(|over| *over) => {
                return self.lost("the coordinator no longer leads").into_http();
            }
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

    /// Returns a connection with capacity for a call, or `None` if all are in use.
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

/// The body of a forwarded answer. If it breaks off, the caller receives a status that requests another
/// attempt.
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
                Poll::Ready(()) => "the coordinator no longer leads".to_owned(),
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
