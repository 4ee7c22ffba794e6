//! Tests of the access of every kind of caller to every call and every path, from one table.

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use prost::Message as _;
use rcgen::{
    CertificateParams, CertifiedIssuer, ExtendedKeyUsagePurpose as Purpose, IsCa, KeyPair,
};
use sightline_proto::connection::Credentials;
use sightline_proto::v1;
use sightline_records::JobState;
use sightline_records::ids::JobId;
use tonic::body::Body;
use tonic::codegen::http::{Request, header};
use tonic::transport::Channel;
use tonic::{Code, Status};
use tower::ServiceExt as _;

use super::connections::{ConnectionLimits, Connections, Listener};
use super::{Tls, TlsFiles, serve, serve_http};
use crate::access::{Access, Scope, TokenFile};
use crate::config::Config;
use crate::coordinator::Coordinator;
use crate::jobs::submit::{Submission, submit};
use crate::tests::life::{nameless, one_cell, triangle};

/// The kinds of callers. Only workers have certificates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum By {
    Nobody,
    Token(Scope),
    Certificate,
}

const ADMIN: &[By] = &[By::Token(Scope::Admin)];
const SUBMIT: &[By] = &[By::Token(Scope::Submit), By::Token(Scope::Admin)];
const READ: &[By] = &[
    By::Token(Scope::Read),
    By::Token(Scope::Submit),
    By::Token(Scope::Admin),
];
const WORKER: &[By] = &[
    By::Token(Scope::Worker),
    By::Certificate,
    By::Token(Scope::Admin),
];
const ALL: [By; 6] = [
    By::Nobody,
    By::Token(Scope::Read),
    By::Token(Scope::Submit),
    By::Token(Scope::Worker),
    By::Token(Scope::Admin),
    By::Certificate,
];

/// The permitted callers of each call. A call that is missing in the table fails the test.
const CALLS: [(&str, &[By]); 38] = [
    ("sightline.v1.Jobs/List", READ),
    ("sightline.v1.Jobs/Show", READ),
    ("sightline.v1.Jobs/Watch", READ),
    ("sightline.v1.Jobs/Fetch", READ),
    ("sightline.v1.Jobs/FetchPartial", READ),
    ("sightline.v1.Jobs/MissingChunks", SUBMIT),
    ("sightline.v1.Jobs/PutChunks", SUBMIT),
    ("sightline.v1.Jobs/PutScene", SUBMIT),
    ("sightline.v1.Jobs/PutSceneFile", SUBMIT),
    ("sightline.v1.Jobs/PutReceivers", SUBMIT),
    ("sightline.v1.Jobs/Submit", SUBMIT),
    ("sightline.v1.Jobs/Estimate", SUBMIT),
    ("sightline.v1.Jobs/Cancel", SUBMIT),
    ("sightline.v1.Jobs/Pause", SUBMIT),
    ("sightline.v1.Jobs/Resume", SUBMIT),
    ("sightline.v1.Jobs/Prioritize", SUBMIT),
    ("sightline.v1.Jobs/Retry", SUBMIT),
    ("sightline.v1.Jobs/Delete", SUBMIT),
    ("sightline.v1.Results/Query", READ),
    ("sightline.v1.Results/Why", READ),
    ("sightline.v1.Results/Measure", READ),
    ("sightline.v1.Farm/ListTiles", READ),
    ("sightline.v1.Farm/Events", READ),
    ("sightline.v1.Farm/ListWorkers", ADMIN),
    ("sightline.v1.Farm/Invalidate", ADMIN),
    ("sightline.v1.Farm/ReleaseWorker", ADMIN),
    ("sightline.v1.Workers/Work", WORKER),
    ("sightline.v1.Workers/Crew", WORKER),
    ("sightline.v1.Workers/FetchScene", WORKER),
    ("sightline.v1.Workers/FetchPack", WORKER),
    ("sightline.v1.Workers/PutResult", WORKER),
    ("sightline.v1.Workers/StageResult", WORKER),
    ("grpc.health.v1.Health/Check", &ALL),
    ("grpc.health.v1.Health/Watch", &ALL),
    (
        "grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        &ALL,
    ),
    (
        "grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
        &ALL,
    ),
    // Calls that do not exist yet require `Admin`.
    ("sightline.v1.Jobs/NotYet", ADMIN),
    ("sightline.v2.Jobs/List", ADMIN),
];

/// The permitted callers of each page. A certificate does not open pages.
const PAGES: [(&str, &[By]); 12] = [
    ("GET /login", &ALL),
    ("POST /login", &ALL),
    ("POST /logout", &ALL),
    ("GET /", ADMIN),
    ("GET /live", ADMIN),
    ("GET /live?job=1&workers=true", ADMIN),
    ("GET /events/1", ADMIN),
    ("GET /results/1.pvs", ADMIN),
    ("GET /view/1", ADMIN),
    ("POST /scenes?name=a.obj", ADMIN),
    ("GET /nothing", ADMIN),
    ("POST /nothing", ADMIN),
];

/// The calls about one job. The job's number is the first field of their messages.
const ABOUT_A_JOB: [&str; 15] = [
    "Jobs/Show",
    "Jobs/Watch",
    "Jobs/Fetch",
    "Jobs/FetchPartial",
    "Jobs/Cancel",
    "Jobs/Pause",
    "Jobs/Resume",
    "Jobs/Prioritize",
    "Jobs/Retry",
    "Jobs/Delete",
    "Results/Query",
    "Results/Why",
    "Results/Measure",
    "Farm/ListTiles",
    "Farm/Events",
];

/// A coordinator that authenticates its callers, until the end of the test.
struct Farm {
    c: Arc<Coordinator>,
    url: String,
    pages: SocketAddr,
    authority: Vec<u8>,
    worker: (Vec<u8>, Vec<u8>),
    tokens: Vec<(String, Scope, String)>,
    tasks: Vec<tokio::task::JoinHandle<()>>,
    _folder: tempfile::TempDir,
}

impl Drop for Farm {
    fn drop(&mut self) {
        self.tasks.iter().for_each(tokio::task::JoinHandle::abort);
    }
}

/// Creates a certificate that an authority signs. Returns the certificate and its key.
fn certificate(
    folder: &Path,
    name: &str,
    by: &CertifiedIssuer<'static, KeyPair>,
) -> (Vec<u8>, Vec<u8>) {
    let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    params.extended_key_usages = vec![Purpose::ServerAuth, Purpose::ClientAuth];
    let key = KeyPair::generate().unwrap();
    let signed = params.signed_by(&key, by).unwrap();
    let both = (signed.pem().into_bytes(), key.serialize_pem().into_bytes());
    std::fs::write(folder.join(format!("{name}.pem")), &both.0).unwrap();
    std::fs::write(folder.join(format!("{name}.key")), &both.1).unwrap();
    both
}

impl Farm {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let authority = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        std::fs::write(folder.path().join("ca.pem"), authority.pem()).unwrap();
        certificate(folder.path(), "server", &authority);
        let worker = certificate(folder.path(), "worker", &authority);
        let path = |name: &str| folder.path().join(name);
        let tls = TlsFiles {
            certificate: path("server.pem"),
            key: path("server.key"),
            client_ca: Some(path("ca.pem")),
        };
        let mut file = TokenFile::default();
        let users = [
            ("eve", Scope::Read),
            ("ada", Scope::Submit),
            ("bob", Scope::Submit),
            ("farm", Scope::Worker),
            ("root", Scope::Admin),
        ];
        let mut add = |(at, (user, scope)): (usize, (&str, Scope))| {
            let token = file
                .add(
                    user,
                    &[scope],
                    1,
                    std::array::from_fn(|i| (at * 40 + i) as u8),
                )
                .unwrap();
            (user.to_owned(), scope, token)
        };
        let tokens = users.into_iter().enumerate().map(&mut add).collect();
        file.write(&path("tokens.json")).unwrap();
        let data = path("data");
        let open = move || Coordinator::open(Config::new(data)).unwrap();
        let c = tokio::task::spawn_blocking(open).await.unwrap();
        c.ask_callers(Arc::new(
            Access::new(Some(path("tokens.json")), true).unwrap(),
        ));
        let connections = Connections::new(ConnectionLimits::for_descriptors(1024));
        let listen = || Listener::bind("127.0.0.1:0".parse().unwrap(), false, &connections);
        let (calls, pages) = (listen().await.unwrap(), listen().await.unwrap());
        let url = format!("https://localhost:{}", calls.local_addr().unwrap().port());
        let at = pages.local_addr().unwrap();
        let tls = Some(Arc::new(Tls::open(tls).unwrap()));
        let (first, second) = (Arc::clone(&c), Arc::clone(&c));
        let tasks = vec![
            tokio::spawn(
                async move { drop(serve(first, calls, tls, std::future::pending()).await) },
            ),
            tokio::spawn(async move { drop(serve_http(second, pages, None).await) }),
        ];
        let authority = authority.pem().into_bytes();
        Self {
            c,
            url,
            pages: at,
            authority,
            worker,
            tokens,
            tasks,
            _folder: folder,
        }
    }

    /// Returns the token of a user.
    fn token(&self, user: &str) -> Option<&str> {
        self.tokens
            .iter()
            .find(|(name, ..)| name == user)
            .map(|(.., token)| token.as_str())
    }

    fn token_of(&self, by: By) -> Option<&str> {
        let By::Token(scope) = by else { return None };
        self.tokens
            .iter()
            .find(|(_, has, _)| *has == scope)
            .map(|(.., token)| token.as_str())
    }

    async fn channel(&self, with_certificate: bool) -> Channel {
        let identity = with_certificate.then(|| self.worker.clone());
        let credentials = Credentials {
            ca: Some(self.authority.clone()),
            identity,
            token: None,
        };
        credentials
            .endpoint(&self.url)
            .unwrap()
            .connect()
            .await
            .unwrap()
    }
}

/// Calls a method about a job. Returns the status of the answer, without its messages.
async fn call(channel: &Channel, path: &str, token: Option<&str>, job: u64) -> Option<Status> {
    let message = v1::ShowRequest { job }.encode_to_vec();
    let frame = [&[0], &(message.len() as u32).to_be_bytes()[..], &message].concat();
    let mut request = Request::post(format!("https://localhost/{path}"))
        .header(header::CONTENT_TYPE, "application/grpc")
        .header(header::TE, "trailers");
    if let Some(token) = token {
        request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
    }
    let request = request
        .body(Body::new(axum::body::Body::from(frame)))
        .unwrap();
    let answer = tokio::time::timeout(Duration::from_secs(60), channel.clone().oneshot(request));
    Status::from_header_map(answer.await.expect(path).unwrap().headers())
}

fn is_denied(status: Option<&Status>) -> bool {
    status.is_some_and(|s| matches!(s.code(), Code::PermissionDenied | Code::Unauthenticated))
}

/// Sends a request over HTTP. Returns the status of the answer.
fn ask(pages: SocketAddr, line: &str, token: Option<&str>) -> u16 {
    let mut stream = TcpStream::connect(pages).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(60)))
        .unwrap();
    let token = token.map_or_else(String::new, |token| {
        format!("Authorization: Bearer {token}\r\n")
    });
    let kind = match line {
        line if line.contains("/log") => "application/x-www-form-urlencoded",
        line if line.contains("/scenes") => "application/octet-stream",
        _ => "application/json",
    };
    let head = format!("Host: {pages}\r\nContent-Type: {kind}\r\nConnection: close\r\n{token}");
    write!(
        stream,
        "{line} HTTP/1.1\r\n{head}Content-Length: 2\r\n\r\n{{}}"
    )
    .unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    std::str::from_utf8(&answer[9..]).unwrap().parse().unwrap()
}

/// Returns the paths of all calls of the interface.
fn all_calls() -> BTreeSet<String> {
    let files = prost_types::FileDescriptorSet::decode(sightline_proto::DESCRIPTORS)
        .unwrap()
        .file;
    let mut all = BTreeSet::new();
    for file in &files {
        for service in &file.service {
            let name = |method: &str| format!("{}.{}/{method}", file.package(), service.name());
            all.extend(service.method.iter().map(|method| name(method.name())));
        }
    }
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_admit_only_callers_of_table() {
    let farm = Farm::start().await;
    let listed: BTreeSet<String> = CALLS.iter().map(|(path, _)| (*path).to_owned()).collect();
    let unlisted: Vec<_> = all_calls().difference(&listed).cloned().collect();
    assert_eq!(
        unlisted,
        Vec::<String>::new(),
        "calls without a row in the table"
    );
    let plain = farm.channel(false).await;
    let certified = farm.channel(true).await;
    for (path, open_to) in CALLS {
        for by in ALL {
            let channel = if by == By::Certificate {
                &certified
            } else {
                &plain
            };
            let status = call(channel, path, farm.token_of(by), 1).await;
            let is_open = !is_denied(status.as_ref());
            assert_eq!(
                is_open,
                open_to.contains(&by),
                "{path} by {by:?}: {status:?}"
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_admit_only_callers_of_table() {
    let farm = Farm::start().await;
    let mut rows: Vec<(String, &[By])> = PAGES
        .iter()
        .map(|(line, by)| ((*line).to_owned(), *by))
        .collect();
    let calls = CALLS
        .iter()
        .filter(|(path, _)| path.starts_with("sightline."));
    rows.extend(calls.map(|(path, by)| (format!("POST /{path}"), *by)));
    let (pages, tokens) = (
        farm.pages,
        ALL.map(|by| (by, farm.token_of(by).map(str::to_owned))),
    );
    let asked = tokio::task::spawn_blocking(move || {
        for (line, open_to) in rows {
            for (by, token) in &tokens {
                // Pages do not request certificates, so a caller with a certificate is unknown.
                let seen = if *by == By::Certificate {
                    By::Nobody
                } else {
                    *by
                };
                let status = ask(pages, &line, token.as_deref());
                let is_open = !matches!(status, 401 | 403);
                assert_eq!(
                    is_open,
                    open_to.contains(&seen),
                    "{line} by {by:?}: {status}"
                );
            }
        }
    });
    asked.await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn job_of_another_user_does_not_exist() {
    let farm = Farm::start().await;
    let c = Arc::clone(&farm.c);
    let submitted = tokio::task::spawn_blocking(move || {
        let scene = c.take_scene_of("ada", &triangle()).unwrap();
        let spec = one_cell(scene, 0);
        let (owner, user) = ("ada".to_owned(), "ada".to_owned());
        let submission = Submission {
            request_id: "one".to_owned(),
            owner,
            user,
            ..nameless(spec)
        };
        submit(&c, &submission).unwrap().id
    });
    let JobId(job) = submitted.await.unwrap();
    let plain = farm.channel(false).await;
    for method in ABOUT_A_JOB {
        let path = format!("sightline.v1.{method}");
        let call_as = async |user: &str, job| call(&plain, &path, farm.token(user), job).await;
        let strange = call_as("bob", job).await.unwrap();
        let missing = call_as("bob", 77).await.unwrap();
        assert_eq!(strange.code(), Code::NotFound, "{method}: {strange}");
        // The answer equals the answer for a job that does not exist.
        assert_eq!(
            strange.message(),
            missing.message().replace("77", &job.to_string()),
            "{method}"
        );
    }
    let state = farm.c.records.job(JobId(job)).unwrap().unwrap().state;
    assert_eq!(state, JobState::Queued);
    // The job's owner and an admin can read the job, with a call that does not change it.
    for (user, finds) in [
        ("ada", true),
        ("root", true),
        ("bob", false),
        ("eve", false),
    ] {
        let status = call(&plain, "sightline.v1.Jobs/Show", farm.token(user), job).await;
        assert_eq!(status.is_none(), finds, "{user}: {status:?}");
    }
}
