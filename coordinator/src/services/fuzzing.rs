//! The body of the fuzz target `calls`: arbitrary bytes as calls of the gRPC interface, to a coordinator
//! without a disk.
//!
//! The tests run it, too. The calls and their messages come from the descriptors of the interface, so that a
//! new call is covered.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use glam::Vec3;
use http_body::Body as _;
use prost::Message as _;
use prost::encoding::{WireType, encode_key, encode_varint};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet, MethodDescriptorProto};
use sightline_model::{GridCells, JobSpec, KnownCells, Sampler, Sampling};
use sightline_proto::v1;
use sightline_records::ids::Digest;
use sightline_scene::{Aabb, Object, Scene, Triangle};
use sightline_store::{MemoryBlobs, MemoryStore};
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, Request};
use tonic::{Code, Status};
use tower::{Layer as _, ServiceExt as _};

use super::authorize::AuthorizeLayer;
use super::call_metrics::CallMetrics;
use super::server::Services;
use crate::clock::SystemClock;
use crate::config::Leases;
use crate::coordinator::Coordinator;

/// The number of calls per run.
const CALLS: usize = 6;
/// Maximum nesting depth of a generated message.
const DEEPEST: u32 = 5;
/// The time without a part of an answer after which the caller disconnects, because answers to watchers are
/// endless.
const PATIENCE: Duration = Duration::from_millis(20);
/// The text with which tonic answers a message that it cannot decode, as Internal.
const UNDECODABLE: &str = "failed to decode Protobuf message";
/// The texts of DataLoss errors about sent bytes rather than stored bytes.
const IN_TRANSIT: [&str; 2] = ["arrived damaged", "the stream ended before"];
/// Maximum number of parts of an answer that the caller reads.
const PARTS: usize = 40;

/// A method of the interface.
#[derive(Clone, Debug)]
pub struct Method {
    /// The path, such as `/sightline.v1.Jobs/Show`.
    pub path: String,
    request: String,
    is_stream: bool,
}

/// The methods and messages of the interface, by name.
pub struct Interface {
    /// All methods.
    pub methods: Vec<Method>,
    messages: BTreeMap<String, DescriptorProto>,
}

impl Interface {
    /// Reads the compiled descriptors.
    ///
    /// # Panics
    /// Panics if the compiled descriptors cannot be read.
    pub fn new() -> Self {
        #[expect(
            clippy::unwrap_used,
            reason = "the descriptors are part of the program"
        )]
        let files = FileDescriptorSet::decode(sightline_proto::DESCRIPTORS).unwrap();
        let (mut methods, mut messages) = (Vec::new(), BTreeMap::new());
        for file in &files.file {
            let package = format!(".{}", file.package());
            file.message_type
                .iter()
                .for_each(|m| add(&mut messages, &package, m));
            for service in &file.service {
                let method = |m: &MethodDescriptorProto| Method {
                    path: format!("/{}.{}/{}", file.package(), service.name(), m.name()),
                    request: m.input_type().to_owned(),
                    is_stream: m.client_streaming(),
                };
                methods.extend(service.method.iter().map(method));
            }
        }
        Self { methods, messages }
    }

    /// Creates a message of the type `name` from `bytes`, with arbitrary fields and with likely and unlikely
    /// values.
    fn message(&self, name: &str, bytes: &mut Entropy<'_>, known: &Fixture, depth: u32) -> Vec<u8> {
        let mut out = Vec::new();
        match name {
            ".sightline.v1.Chunk" if bytes.one_in(2) => return chunk(bytes),
            // Later fields replace the fields of a valid message.
            ".sightline.v1.JobSpec" if bytes.one_in(2) => return known.spec.clone(),
            ".sightline.v1.JobSpec" if !bytes.one_in(4) => out.extend(&known.spec),
            _ => {}
        }
        let Some(descriptor) = self.messages.get(name) else {
            return out;
        };
        for field in &descriptor.field {
            let count = match field.label() {
                Label::Repeated => bytes.below(4),
                // One field of a choice is sufficient.
                _ if field.oneof_index.is_some() => {
                    usize::from(bytes.one_in(descriptor.field.len().min(4)))
                }
                _ => usize::from(!bytes.one_in(4)),
            };
            for _ in 0..if depth < DEEPEST { count } else { 0 } {
                let number = field.number().unsigned_abs();
                let mut key = |wire| encode_key(number, wire, &mut out);
                match field.r#type() {
                    Type::Message => {
                        key(WireType::LengthDelimited);
                        let message = self.message(field.type_name(), bytes, known, depth + 1);
                        put(&mut out, &message);
                    }
                    Type::String => {
                        key(WireType::LengthDelimited);
                        let long = "x".repeat(300);
                        put(
                            &mut out,
                            bytes
                                .pick(&["fuzz", "w", "cpu/test", "", "\u{202e}\n", &long])
                                .as_bytes(),
                        );
                    }
                    Type::Bytes => {
                        key(WireType::LengthDelimited);
                        let digest = bytes.pick(&[
                            known.scene,
                            known.scene,
                            blake3::hash(b"fuzz").into(),
                            [0; 32],
                        ]);
                        let length = if bytes.one_in(4) { bytes.below(40) } else { 32 };
                        put(&mut out, digest.get(..length).unwrap_or(&digest));
                    }
                    Type::Double | Type::Fixed64 | Type::Sfixed64 => {
                        key(WireType::SixtyFourBit);
                        let number = bytes.pick(&[
                            0.0,
                            0.5,
                            1.0,
                            -1.0,
                            1e308,
                            5e-324,
                            f64::NAN,
                            f64::INFINITY,
                            90.0,
                        ]);
                        out.extend(number.to_le_bytes());
                    }
                    Type::Float | Type::Fixed32 | Type::Sfixed32 => {
                        key(WireType::ThirtyTwoBit);
                        let number = bytes.pick(&[
                            0.0,
                            0.5,
                            1.0,
                            -1.0,
                            3e38,
                            1e-45,
                            f32::NAN,
                            f32::INFINITY,
                            64.0,
                        ]);
                        out.extend(number.to_le_bytes());
                    }
                    _ => {
                        key(WireType::Varint);
                        let small = bytes.below(5) as u64;
                        let large = [
                            u64::MAX,
                            u64::from(u32::MAX),
                            1 << 63,
                            1 << 31,
                            1 << 20,
                            65_536,
                            4096,
                            300,
                        ];
                        encode_varint(
                            if bytes.one_in(3) {
                                bytes.pick(&large)
                            } else {
                                small
                            },
                            &mut out,
                        );
                    }
                }
            }
        }
        out
    }
}

impl Default for Interface {
    fn default() -> Self {
        Self::new()
    }
}

fn add(messages: &mut BTreeMap<String, DescriptorProto>, scope: &str, message: &DescriptorProto) {
    let name = format!("{scope}.{}", message.name());
    message
        .nested_type
        .iter()
        .for_each(|m| add(messages, &name, m));
    messages.insert(name, message.clone());
}

fn put(out: &mut Vec<u8>, bytes: &[u8]) {
    encode_varint(bytes.len() as u64, out);
    out.extend(bytes);
}

/// Creates a chunk with a correct checksum.
fn chunk(bytes: &mut Entropy<'_>) -> Vec<u8> {
    let data = bytes.pick(&[&b"fuzz"[..], b"", &[7; 1000]]).to_vec();
    let total = bytes.pick(&[data.len() as u64, 8, 0, u64::MAX]);
    let chunk = v1::Chunk {
        crc32c: crc32c::crc32c(&data),
        offset: bytes.pick(&[0, 4, u64::MAX]),
        total,
        data,
        address: None,
    };
    chunk.encode_to_vec()
}

/// Values that exist in the coordinator under test.
struct Fixture {
    scene: Digest,
    spec: Vec<u8>,
}

/// A source of choices from bytes. After the last byte, every choice is the first one.
struct Entropy<'a>(&'a [u8]);

impl Entropy<'_> {
    fn next(&mut self) -> Option<u8> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*first)
    }

    fn below(&mut self, n: usize) -> usize {
        usize::from(self.next().unwrap_or(0)) % n.max(1)
    }

    /// Returns true in one of `n` cases, and always after the last byte.
    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    fn pick<T: Clone>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())].clone()
    }
}

/// Calls methods of a new coordinator, which has a scene and a job of two tiles. Returns the calls and their
/// codes.
///
/// # Panics
/// Panics if a call panics or fails for an internal reason. No input may cause either.
pub fn calls(interface: &Interface, bytes: &[u8]) -> Vec<(String, Code)> {
    #[expect(
        clippy::unwrap_used,
        reason = "without a runtime there is nothing to test"
    )]
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let made = runtime.block_on(make_calls(interface, &mut Entropy(bytes)));
    // The shutdown waits for the remaining work of the calls.
    runtime.shutdown_timeout(Duration::from_secs(10));
    #[expect(clippy::unwrap_used, reason = "the coordinator is in memory")]
    made.unwrap()
}

async fn make_calls(
    interface: &Interface,
    bytes: &mut Entropy<'_>,
) -> Result<Vec<(String, Code)>, Box<dyn std::error::Error>> {
    let (store, blobs) = (Box::new(MemoryStore::new()), Box::new(MemoryBlobs::new()));
    let coordinator = Coordinator::new(Leases::default(), store, blobs, Box::new(SystemClock))?;
    let triangles = vec![Triangle {
        v: [Vec3::ZERO, Vec3::X, Vec3::Y],
    }];
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count: 1,
    }];
    let scene = coordinator.take_scene(&Scene::new("fuzz", triangles, objects)?)?;
    let cells = GridCells::new(Aabb::new(Vec3::ZERO, Vec3::ONE), [2, 1, 1])?;
    let sampling = Sampling::new(Sampler::lines(KnownCells::Grid(cells)));
    let spec = JobSpec::new(scene, sightline_model::Method::aggressive(sampling));
    let known = Fixture {
        scene,
        spec: spec.to_message().encode_to_vec(),
    };
    let services = Services::new();
    let routes =
        AuthorizeLayer(Arc::clone(&coordinator)).layer(services.routes(&coordinator).await?);
    let routes = CallMetrics::new(&coordinator).layer(routes);
    let submitted = v1::SubmitRequest {
        request_id: "first".to_owned(),
        name: "fuzz".to_owned(),
        spec: Some(spec.to_message()),
        ..Default::default()
    };
    let answer = call(
        &routes,
        "/sightline.v1.Jobs/Submit",
        &[submitted.encode_to_vec()],
    )
    .await?;
    assert_eq!(
        answer.code(),
        Code::Ok,
        "the job of the fuzz target is valid"
    );
    let mut made = Vec::new();
    while made.len() < CALLS && !bytes.0.is_empty() {
        let method = bytes.pick(&interface.methods);
        let count = if method.is_stream {
            1 + bytes.below(4)
        } else {
            1
        };
        let messages: Vec<Vec<u8>> = (0..count)
            .map(|_| {
                let mut message = match bytes.one_in(8) {
                    true => (0..bytes.below(60)).filter_map(|_| bytes.next()).collect(),
                    false => interface.message(&method.request, bytes, &known, 0),
                };
                if bytes.one_in(4) && !message.is_empty() {
                    let at = bytes.below(message.len());
                    message[at] ^= bytes.pick(&[1, 2, 0x7f, 0x80, 0xff]);
                }
                message
            })
            .collect();
        let status = call(&routes, &method.path, &messages).await?;
        let (code, text) = (status.code(), status.message());
        let is_fault = match code {
            Code::Internal => !text.contains(UNDECODABLE),
            Code::DataLoss => !IN_TRANSIT.iter().any(|part| text.contains(part)),
            Code::Unknown => true,
            _ => false,
        };
        assert!(
            !is_fault,
            "{} answered {code:?} ({text}) to {messages:02x?}",
            method.path
        );
        made.push((method.path, code));
    }
    Ok(made)
}

/// Calls a method and reads the answer. A call whose caller stops waiting counts as cancelled.
async fn call<S>(
    routes: &S,
    path: &str,
    messages: &[Vec<u8>],
) -> Result<Status, Box<dyn std::error::Error>>
where
    S: tower::Service<Request<Body>, Response = tonic::codegen::http::Response<Body>> + Clone,
    S::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let mut frames = Vec::new();
    for message in messages {
        frames.push(0);
        frames.extend((message.len() as u32).to_be_bytes());
        frames.extend(message);
    }
    let request = Request::post(format!("http://fuzz{path}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(Body::new(axum::body::Body::from(frames)))?;
    let response = routes
        .clone()
        .oneshot(request)
        .await
        .map_err(|e| e.into() as Box<dyn std::error::Error>)?;
    let status_in = |headers: &HeaderMap| Status::from_header_map(headers);
    if let Some(status) = status_in(response.headers()) {
        return Ok(status);
    }
    let mut body = response.into_body();
    for _ in 0..PARTS {
        let part = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context));
        match tokio::time::timeout(PATIENCE, part).await {
            Err(_) => return Ok(Status::cancelled("")),
            Ok(None) => return Ok(Status::new(Code::Ok, "")),
            Ok(Some(part)) => {
                if let Some(status) = part?.trailers_ref().and_then(status_in) {
                    return Ok(status);
                }
            }
        }
    }
    Ok(Status::cancelled(""))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use sightline_numbers::random::SplitMix64;

    use super::*;

    /// The number of runs of the body.
    const RUNS: u64 = 300;

    /// Calls methods with random bytes. `SIGHTLINE_FUZZ_SEED` sets the first seed.
    #[test]
    fn fuzzed_calls_do_not_crash() {
        let interface = Interface::new();
        let first =
            std::env::var("SIGHTLINE_FUZZ_SEED").map_or(1, |text| text.parse::<u64>().unwrap());
        let (mut called, mut answered) = (BTreeSet::new(), BTreeSet::new());
        for seed in first..first + RUNS {
            let mut stream = SplitMix64::new(seed);
            let length = stream.bits() % 600;
            let bytes: Vec<u8> = (0..length).map(|_| (stream.bits() >> 56) as u8).collect();
            let ran = std::panic::catch_unwind(|| calls(&interface, &bytes));
            for (path, code) in ran.unwrap_or_else(|_| panic!("seed {seed} panicked")) {
                if code == Code::Ok {
                    answered.insert(path.clone());
                }
                assert_ne!(code, Code::Unimplemented, "{path} is in the descriptors");
                called.insert(path);
            }
        }
        let all: BTreeSet<String> = interface.methods.iter().map(|m| m.path.clone()).collect();
        assert!(all.len() >= 25, "{all:?}");
        assert_eq!(called, all, "every call is made");
        // Messages that every method rejects would cover little of the code.
        assert!(
            answered.len() * 2 > all.len(),
            "only {answered:?} succeeded"
        );
    }
}
