//! Metrics of gRPC calls: id, status code, duration and bytes.
//!
//! The id of a call is its `x-request-id`, or a random one. The answer and the log lines of the call contain
//! the id.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use futures::future::BoxFuture;
use http_body::{Body as HttpBody, Frame, SizeHint};
use prometheus_client::metrics::counter::Counter;
use prost::Message as _;
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, HeaderValue, Request, Response};
use tonic::{Code, Status};
use tower::{Layer, Service};
use tracing::Instrument as _;

use super::authorize::CallRight;
use super::connections::Peer;
use super::silence::UntilSilent;
use crate::coordinator::Coordinator;

/// The streams that workers keep open. They are silent while a worker computes a tile.
const OPEN_ENDED: [&str; 2] = ["Workers/Work", "Workers/Crew"];

const REQUEST_ID: &str = "x-request-id";
/// Maximum length of a caller's request id, in bytes.
const MAX_ID: usize = 64;

/// A layer that wraps services in [`Counted`].
#[derive(Clone)]
pub(super) struct CallMetrics {
    coordinator: Arc<Coordinator>,
    /// The known methods, by path. Calls of other paths are counted together.
    methods: Arc<BTreeMap<String, Arc<str>>>,
    bytes: [Counter; 2],
}

impl CallMetrics {
    pub(super) fn new(c: &Arc<Coordinator>) -> Self {
        let bytes = ["in", "out"].map(|direction| c.telemetry.metrics.transferred(direction));
        Self {
            coordinator: Arc::clone(c),
            methods: Arc::new(methods()),
            bytes,
        }
    }
}

/// Returns the methods of this program's services by their paths, as `Service/Method`.
fn methods() -> BTreeMap<String, Arc<str>> {
    let files =
        prost_types::FileDescriptorSet::decode(sightline_proto::DESCRIPTORS).unwrap_or_default();
    let mut methods = BTreeMap::new();
    for file in files.file {
        for service in &file.service {
            for method in &service.method {
                let name = format!("{}/{}", service.name(), method.name());
                methods.insert(format!("/{}.{name}", file.package()), name.into());
            }
        }
    }
    methods
}

impl<S> Layer<S> for CallMetrics {
    type Service = Counted<S>;

    fn layer(&self, inner: S) -> Counted<S> {
        Counted {
            inner,
            counting: self.clone(),
        }
    }
}

/// A service whose calls are counted.
#[derive(Clone)]
pub(super) struct Counted<S> {
    inner: S,
    counting: CallMetrics,
}

impl<S> Service<Request<Body>> for Counted<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = BoxFuture<'static, Result<S::Response, S::Error>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let CallMetrics {
            coordinator,
            methods,
            bytes: [read, written],
        } = self.counting.clone();
        let method = methods
            .get(request.uri().path())
            .map_or_else(|| "other".into(), Arc::clone);
        let id = request_id(request.headers());
        let span = tracing::info_span!("call", %method, id = id.to_str().unwrap_or_default());
        let silence = request
            .extensions()
            .get::<Peer>()
            .map(|peer| peer.limits().call_silence);
        let silence = silence.filter(|_| !OPEN_ENDED.contains(&&*method));
        let call = Call {
            coordinator,
            method,
            begun: Instant::now(),
            code: None,
            held: None,
        };
        let request = request.map(|body| {
            let inner = match silence {
                Some(limit) => Body::new(UntilSilent::new(body, limit)),
                None => body,
            };
            Body::new(CountedBody {
                inner,
                bytes: read,
                call: None,
            })
        });
        let answer = self.inner.call(request);
        let answer = async move {
            let mut call = call;
            let mut response = answer.await?;
            response.headers_mut().insert(REQUEST_ID, id);
            // An answer without a body has its status code in the headers; other answers have it in the
            // trailers.
            let code = Status::from_header_map(response.headers()).map(|status| status.code());
            call.code = code;
            call.held = response.extensions_mut().remove::<Arc<CallRight>>();
            let call = Some(call).filter(|_| code.is_none());
            Ok(response.map(|body| {
                Body::new(CountedBody {
                    inner: body,
                    bytes: written,
                    call,
                })
            }))
        };
        Box::pin(answer.instrument(span))
    }
}

/// Returns the id of a call: its request id if it is valid, or a random one.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let given = headers.get(REQUEST_ID).filter(|id| {
        let letters = id.as_bytes();
        (1..=MAX_ID).contains(&letters.len()) && letters.iter().all(u8::is_ascii_graphic)
    });
    let random = || {
        let mut bytes = [0; 8];
        // Without random numbers, the calls share an id. No behaviour depends on the ids.
        let _ = getrandom::fill(&mut bytes);
        HeaderValue::from_str(&format!("{:016x}", u64::from_le_bytes(bytes)))
    };
    given
        .cloned()
        .or_else(|| random().ok())
        .unwrap_or_else(|| HeaderValue::from_static("none"))
}

/// An open call. Dropping it counts the call.
struct Call {
    coordinator: Arc<Coordinator>,
    method: Arc<str>,
    begun: Instant,
    /// The status code, once it is known. A call whose caller has gone has no code.
    code: Option<Code>,
    /// The right to the call, and its memory.
    held: Option<Arc<CallRight>>,
}

impl Drop for Call {
    fn drop(&mut self) {
        let code = name(self.code.unwrap_or(Code::Cancelled));
        self.coordinator
            .telemetry
            .metrics
            .request(&self.method, code, self.begun.elapsed());
    }
}

/// Returns the name of a status code in the specification of gRPC.
fn name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

/// A body whose bytes are counted. The body of an answer also ends its call.
struct CountedBody {
    inner: Body,
    bytes: Counter,
    call: Option<Call>,
}

impl HttpBody for CountedBody {
    type Data = bytes::Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        let frame = Pin::new(&mut self.inner).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &frame {
            if let Some(data) = frame.data_ref() {
                self.bytes.inc_by(data.len() as u64);
            }
            let code = frame
                .trailers_ref()
                .and_then(Status::from_header_map)
                .map(|status| status.code());
            if let Some(call) = self.call.as_mut().filter(|_| code.is_some()) {
                call.code = code;
            }
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_have_distinct_names() {
        let methods = methods();
        assert_eq!(methods["/sightline.v1.Jobs/Submit"].as_ref(), "Jobs/Submit");
        assert!(methods.len() >= 30, "{}", methods.len());
    }

    #[test]
    fn printable_caller_id_is_kept() {
        let with = |id: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(REQUEST_ID, HeaderValue::from_bytes(id.as_bytes()).unwrap());
            request_id(&headers)
        };
        assert_eq!(with("frame-17"), "frame-17");
        let long = "x".repeat(MAX_ID + 1);
        for bad in ["", "two words", "é", &long] {
            let id = with(bad);
            assert!(id != bad && id.len() == 16, "{id:?}");
        }
        assert_ne!(request_id(&HeaderMap::new()), request_id(&HeaderMap::new()));
    }
}
