//! OpenTelemetry collectors for tests: one that stores the received spans, and one that accepts connections
//! and never answers.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{
    TraceService, TraceServiceServer,
};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::KeyValue;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status};

/// A received span.
#[derive(Clone, Debug)]
pub struct ReceivedSpan {
    /// The name of the service that sent the span.
    pub service: String,
    /// The process that sent the span.
    pub instance: String,
    /// The name of the span.
    pub name: String,
    /// The ids of the trace, of the span and of its parent, in hexadecimal digits. The last is empty without
    /// a parent.
    pub ids: [String; 3],
    /// The start and the end in nanoseconds since 1970.
    pub times: [u64; 2],
    /// The attributes as text.
    pub attributes: BTreeMap<String, String>,
    /// The ids of linked traces and spans.
    pub links: Vec<[String; 2]>,
    /// The reason of the failure, if the span failed.
    pub failed: Option<String>,
    /// The whole span as text, for checks that it does not contain secrets.
    pub whole: String,
}

/// A collector on a free port, which exists until the end of the test.
pub struct Collector {
    url: String,
    taken: Arc<Mutex<Vec<ReceivedSpan>>>,
    /// The listener of a silent collector, which keeps the port open.
    _silent: Option<TcpListener>,
    _runtime: Option<tokio::runtime::Runtime>,
}

struct Keeper(Arc<Mutex<Vec<ReceivedSpan>>>);

#[tonic::async_trait]
impl TraceService for Keeper {
    async fn export(
        &self,
        r: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        let headers = format!("{:?}", r.metadata());
        let mut taken = self.0.lock().unwrap();
        for of_process in r.into_inner().resource_spans {
            let process = of_process.resource.clone().unwrap_or_default();
            let resource = texts(&process.attributes);
            for span in of_process
                .scope_spans
                .into_iter()
                .flat_map(|scope| scope.spans)
            {
                let status = span.status.clone().filter(|status| status.code == 2);
                let ids = [&span.trace_id, &span.span_id, &span.parent_span_id].map(|id| hex(id));
                let links = span
                    .links
                    .iter()
                    .map(|link| [hex(&link.trace_id), hex(&link.span_id)]);
                taken.push(ReceivedSpan {
                    service: resource["service.name"].clone(),
                    instance: resource["service.instance.id"].clone(),
                    name: span.name.clone(),
                    ids,
                    times: [span.start_time_unix_nano, span.end_time_unix_nano],
                    attributes: texts(&span.attributes),
                    links: links.collect(),
                    failed: status.map(|status| status.message),
                    whole: format!("{headers} {process:?} {span:?}"),
                });
            }
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn texts(attributes: &[KeyValue]) -> BTreeMap<String, String> {
    let text = |entry: &KeyValue| match entry.value.clone().and_then(|value| value.value) {
        Some(Value::StringValue(text)) => text,
        Some(Value::IntValue(number)) => number.to_string(),
        other => panic!("{}: {other:?} is no text and no number", entry.key),
    };
    attributes
        .iter()
        .map(|entry| (entry.key.clone(), text(entry)))
        .collect()
}

impl Default for Collector {
    fn default() -> Self {
        Self::new()
    }
}

impl Collector {
    /// Starts a collector that stores the received spans.
    pub fn new() -> Self {
        Self::at("127.0.0.1:0")
    }

    /// Starts a collector at this address that stores the received spans.
    pub fn at(address: &str) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        let taken = Arc::<Mutex<Vec<ReceivedSpan>>>::default();
        let listener = runtime
            .block_on(tokio::net::TcpListener::bind(address))
            .unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let service = TraceServiceServer::new(Keeper(Arc::clone(&taken)));
        let server = tonic::transport::Server::builder().add_service(service);
        runtime.spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
        Self {
            url,
            taken,
            _silent: None,
            _runtime: Some(runtime),
        }
    }

    /// Starts a collector that accepts connections and never answers.
    pub fn silent() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        Self {
            url,
            taken: Arc::default(),
            _silent: Some(listener),
            _runtime: None,
        }
    }

    /// Returns the address of the collector, for `--traces`.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Returns only the address and the port of the collector.
    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://")
    }

    /// Returns the spans received so far.
    pub fn taken(&self) -> Vec<ReceivedSpan> {
        self.taken.lock().unwrap().clone()
    }
}
