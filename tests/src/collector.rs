//! A collector of OpenTelemetry that keeps what it is sent, and one that takes connections and says nothing.

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

/// A span that has arrived.
#[derive(Clone, Debug)]
pub struct Taken {
    /// The kind of process that sent it.
    pub service: String,
    /// The process.
    pub instance: String,
    /// What it is called.
    pub name: String,
    /// The ids of its trace, its own and its parent's, in hexadecimal digits; the last is empty without one.
    pub ids: [String; 3],
    /// Beginning and end in nanoseconds since 1970.
    pub times: [u64; 2],
    /// Its attributes as text.
    pub attributes: BTreeMap<String, String>,
    /// The traces and spans that it points to.
    pub links: Vec<[String; 2]>,
    /// Whether it failed, and why.
    pub failed: Option<String>,
    /// All of it as text, for what must not be there.
    pub whole: String,
}

/// A collector on a free port, until the end of the test.
pub struct Collector {
    url: String,
    taken: Arc<Mutex<Vec<Taken>>>,
    /// Holds the port.
    _silent: Option<TcpListener>,
    _runtime: Option<tokio::runtime::Runtime>,
}

struct Keeper(Arc<Mutex<Vec<Taken>>>);

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
                taken.push(Taken {
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
    let text = |of: &KeyValue| match of.value.clone().and_then(|value| value.value) {
        Some(Value::StringValue(text)) => text,
        Some(Value::IntValue(number)) => number.to_string(),
        other => panic!("{}: {other:?} is no text and no number", of.key),
    };
    attributes
        .iter()
        .map(|of| (of.key.clone(), text(of)))
        .collect()
}

impl Default for Collector {
    fn default() -> Self {
        Self::new()
    }
}

impl Collector {
    /// One that keeps what it is sent.
    pub fn new() -> Self {
        Self::at("127.0.0.1:0")
    }

    /// The same at this address.
    pub fn at(address: &str) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        let taken = Arc::<Mutex<Vec<Taken>>>::default();
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

    /// One that takes connections and says nothing.
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

    /// Its address, for `--traces`.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Address and port alone.
    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://")
    }

    /// What has arrived so far.
    pub fn taken(&self) -> Vec<Taken> {
        self.taken.lock().unwrap().clone()
    }
}
