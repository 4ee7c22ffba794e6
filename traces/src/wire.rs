//! Conversion of spans into OTLP messages.

use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value as Any;
use opentelemetry_proto::tonic::common::v1::{AnyValue, InstrumentationScope, KeyValue};
use opentelemetry_proto::tonic::resource::v1::Resource;
use opentelemetry_proto::tonic::trace::v1::span::{Link, SpanKind};
use opentelemetry_proto::tonic::trace::v1::status::StatusCode;
use opentelemetry_proto::tonic::trace::v1::{self, ResourceSpans, ScopeSpans, Status};

use crate::ids::SpanId;
use crate::span::{Span, Value};

/// The W3C Trace Context flag of a sampled trace. All traces are sampled.
const SAMPLED: u32 = 1;

/// Returns the OTLP resource that describes the sending process.
pub(crate) fn resource(service: &str, instance: &str) -> Resource {
    let version = env!("CARGO_PKG_VERSION");
    let pairs = [
        ("service.name", service),
        ("service.version", version),
        ("service.instance.id", instance),
    ];
    let attributes = pairs
        .map(|(name, value)| attribute(name, Value::Name(value.to_owned())))
        .into();
    Resource {
        attributes,
        ..Resource::default()
    }
}

/// Returns the message for a batch of spans. `fresh` generates ids for spans without one.
pub(crate) fn request(
    resource: &Resource,
    spans: Vec<Span>,
    mut fresh: impl FnMut() -> SpanId,
) -> ExportTraceServiceRequest {
    let scope = InstrumentationScope {
        name: "sightline".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..InstrumentationScope::default()
    };
    let spans = spans
        .into_iter()
        .map(|span| message(span, &mut fresh))
        .collect();
    let scope_spans = vec![ScopeSpans {
        scope: Some(scope),
        spans,
        ..ScopeSpans::default()
    }];
    let of_process = ResourceSpans {
        resource: Some(resource.clone()),
        scope_spans,
        ..ResourceSpans::default()
    };
    ExportTraceServiceRequest {
        resource_spans: vec![of_process],
    }
}

fn message(span: Span, fresh: &mut impl FnMut() -> SpanId) -> v1::Span {
    let link = span.link.map(|(trace, id)| Link {
        trace_id: trace.bytes().to_vec(),
        span_id: id.bytes().to_vec(),
        flags: SAMPLED,
        ..Link::default()
    });
    let status = span.failed.map(|why| Status {
        message: why.to_owned(),
        code: StatusCode::Error.into(),
    });
    v1::Span {
        trace_id: span.trace.bytes().to_vec(),
        span_id: span.id.unwrap_or_else(fresh).bytes().to_vec(),
        parent_span_id: span
            .parent
            .map_or_else(Vec::new, |parent| parent.bytes().to_vec()),
        flags: SAMPLED,
        name: span.name.to_owned(),
        kind: SpanKind::Internal.into(),
        start_time_unix_nano: span.start,
        end_time_unix_nano: span.end,
        attributes: span
            .attributes
            .into_iter()
            .map(|(name, value)| attribute(name, value))
            .collect(),
        links: link.into_iter().collect(),
        status,
        ..v1::Span::default()
    }
}

fn attribute(name: &str, value: Value) -> KeyValue {
    let value = match value {
        Value::Number(number) => Any::IntValue(i64::try_from(number).unwrap_or(i64::MAX)),
        Value::Word(word) => Any::StringValue(word.to_owned()),
        Value::Name(name) => Any::StringValue(name),
    };
    KeyValue {
        key: name.to_owned(),
        value: Some(AnyValue { value: Some(value) }),
        ..KeyValue::default()
    }
}
