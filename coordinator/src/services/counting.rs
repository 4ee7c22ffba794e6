//! Every gRPC call: its id, its code, its time and its bytes.
//!
//! A call has the id that its `x-request-id` names, or a random one. The answer names it, and so do the lines
//! of the log that belong to the call.

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

use super::connections::Peer;
use super::guard::CallRight;
use super::silence::UntilSilent;
use crate::state::Coordinator;

/// The streams that workers keep open, which are silent while a tile is computed.
const OPEN_ENDED: [&str; 2] = ["Workers/Work", "Workers/Crew"];

const REQUEST_ID: &str = "x-request-id";
/// Longest request id of a caller.
const MAX_ID: usize = 64;

/// Puts a [`Counted`] around the services.
#[derive(Clone)]
pub(super) struct Counting {
    coordinator: Arc<Coordinator>,
    /// The methods that there are, by path: others are counted together.
    methods: Arc<BTreeMap<String, Arc<str>>>,
    bytes: [Counter; 2],
}

impl Counting {
    pub(super) fn of(c: &Arc<Coordinator>) -> Self {
        let bytes = ["in", "out"].map(|direction| c.metrics.transferred(direction));
        Self {
            coordinator: Arc::clone(c),
            methods: Arc::new(methods()),
            bytes,
        }
    }
}

/// The methods of our services by their paths, as `Service/Method`.
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

impl<S> Layer<S> for Counting {
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
    counting: Counting,
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
        let Counting {
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
            // An answer without a body has its code here, others have it at their end.
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

/// The id of a call.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let given = headers.get(REQUEST_ID).filter(|id| {
        let letters = id.as_bytes();
        (1..=MAX_ID).contains(&letters.len()) && letters.iter().all(u8::is_ascii_graphic)
    });
    let random = || {
        let mut bytes = [0; 8];
        // Without random numbers calls have no ids of their own, and nothing depends on them.
        let _ = getrandom::fill(&mut bytes);
        HeaderValue::from_str(&format!("{:016x}", u64::from_le_bytes(bytes)))
    };
    given
        .cloned()
        .or_else(|| random().ok())
        .unwrap_or_else(|| HeaderValue::from_static("none"))
}

/// A call that goes on. It is counted when it is dropped.
struct Call {
    coordinator: Arc<Coordinator>,
    method: Arc<str>,
    begun: Instant,
    /// Its code, once it is known. A call whose caller has gone has none.
    code: Option<Code>,
    /// The right to it, and its memory.
    held: Option<Arc<CallRight>>,
}

impl Drop for Call {
    fn drop(&mut self) {
        let code = name(self.code.unwrap_or(Code::Cancelled));
        self.coordinator
            .metrics
            .request(&self.method, code, self.begun.elapsed());
    }
}

/// The name of a code, as the specification of gRPC has it.
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

/// A body whose bytes are counted, and, of an answer, the call that ends with it.
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
    fn every_method_has_a_name_of_its_own() {
        let methods = methods();
        assert_eq!(methods["/sightline.v1.Jobs/Submit"].as_ref(), "Jobs/Submit");
        assert!(methods.len() >= 30, "{}", methods.len());
    }

    #[test]
    fn an_id_of_the_caller_is_kept_if_it_can_be_shown() {
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
