//! Tests of encryption, tokens and owners with real processes: the permissions of each user, and the
//! visibility of other users' data.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use rcgen::{
    CertificateParams, CertifiedIssuer, ExtendedKeyUsagePurpose as Purpose, IsCa, KeyPair,
};
use sightline_proto::connection::{Bearer, Credentials};
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_tests::{
    Background, Coordinator, Sandbox, ask, ask_with_head, assert_same, wait_for,
};

/// Creates an authority, and writes its certificate as `NAME.pem`.
fn authority(sandbox: &Sandbox, name: &str) -> CertifiedIssuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let issuer = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
    sandbox.write(&format!("{name}.pem"), issuer.pem());
    issuer
}

/// Writes a certificate that an authority signed, as `NAME.pem` and `NAME.key`.
fn certificate(sandbox: &Sandbox, name: &str, by: &CertifiedIssuer<'static, KeyPair>) {
    let mut params =
        CertificateParams::new(vec!["localhost".to_owned(), "127.0.0.1".to_owned()]).unwrap();
    params.extended_key_usages = vec![Purpose::ServerAuth, Purpose::ClientAuth];
    let key = KeyPair::generate().unwrap();
    let signed = params.signed_by(&key, by).unwrap();
    sandbox.write(&format!("{name}.pem"), signed.pem());
    sandbox.write(&format!("{name}.key"), key.serialize_pem());
}

/// Returns a folder with an authority, the certificates of a coordinator and a worker, tokens, and a scene.
fn prepared() -> Sandbox {
    let sandbox = Sandbox::new();
    let farm = authority(&sandbox, "farm");
    certificate(&sandbox, "server", &farm);
    certificate(&sandbox, "worker", &farm);
    for (user, scope) in [
        ("ada", "submit"),
        ("bob", "submit"),
        ("eve", "read"),
        ("root", "admin"),
    ] {
        token(&sandbox, user, scope);
    }
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    sandbox
}

fn token(sandbox: &Sandbox, user: &str, scope: &str) {
    let text = sandbox.ok(&format!(
        "token new --tokens tokens.json --user {user} --scope {scope}"
    ));
    sandbox.write(&format!("{user}.token"), text);
}

fn guarded(sandbox: &Sandbox) -> Coordinator<'_> {
    let files =
        "--tls-cert server.pem --tls-key server.key --client-ca farm.pem --tokens tokens.json";
    sandbox.serve("data", &format!("--listen 127.0.0.1:0 {files}"))
}

fn certified_worker(coordinator: &Coordinator<'_>) -> Background {
    coordinator
        .start("worker --backend cpu --threads 1 --ca farm.pem --cert worker.pem --key worker.key")
}

/// Returns the text after `mark` in an endless stream of events, up to the end of its line.
fn first_of_stream(pages: &str, path: &str, headers: &str, mark: &str) -> String {
    let mut stream = TcpStream::connect(pages).unwrap();
    stream
        .set_read_timeout(Some(sightline_tests::LIMIT))
        .unwrap();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {pages}\r\n{headers}\r\n"
    )
    .unwrap();
    let mut text = String::new();
    let mut part = [0; 4096];
    loop {
        if let Some(line) = text
            .split_once(mark)
            .and_then(|(_, rest)| rest.split_once('\n'))
        {
            return line.0.to_owned();
        }
        let read = stream.read(&mut part).unwrap();
        assert!(read > 0, "the stream ended: {text}");
        text.push_str(&String::from_utf8_lossy(&part[..read]));
    }
}

const JOB: &str = "town.glb --cells 2x2x1 --target-error 0.1 --backend cpu";

#[test]
fn users_see_their_jobs_with_bytes_of_bake() {
    let sandbox = prepared();
    let coordinator = guarded(&sandbox);
    let worker = certified_worker(&coordinator);
    let [ada, bob, eve, root] =
        ["ada", "bob", "eve", "root"].map(|n| format!("--ca farm.pem --token-file {n}.token"));
    let job: u64 = coordinator
        .ok(&format!("submit {JOB} {ada}"))
        .trim()
        .parse()
        .unwrap();
    coordinator.ok(&format!("watch {job} {ada}"));
    coordinator.ok(&format!("fetch {job} -o ada.pvs {ada}"));
    sandbox.ok(&format!("bake {JOB} -o alone.pvs"));
    assert_same(
        &sandbox.read("ada.pvs"),
        &sandbox.read("alone.pvs"),
        "encrypted and alone",
    );

    // Other users receive no information, not even that the job exists.
    for command in [
        "show", "watch", "cancel", "pause", "resume", "retry", "delete", "logs",
    ] {
        let denied = coordinator
            .run(&format!("{command} {job} {bob}"))
            .code(4)
            .says(&format!("job {job} does not exist"));
        assert_eq!(
            denied.err,
            coordinator
                .run(&format!("{command} 77 {bob}"))
                .err
                .replace("77", &job.to_string())
        );
    }
    coordinator
        .run(&format!("fetch {job} -o stolen.pvs {bob}"))
        .code(4)
        .says("does not exist");
    coordinator
        .run(&format!("priority {job} 5 {bob}"))
        .code(4)
        .says("does not exist");
    assert!(!sandbox.path("stolen.pvs").exists());
    assert_eq!(coordinator.ok(&format!("jobs {bob}")), "");
    // The same job of another user is a separate job with the same bytes.
    let own: u64 = coordinator
        .ok(&format!("submit {JOB} {bob}"))
        .trim()
        .parse()
        .unwrap();
    assert_ne!(own, job);
    coordinator.ok(&format!("watch {own} {bob}"));
    coordinator.ok(&format!("fetch {own} -o bob.pvs {bob}"));
    assert_same(
        &sandbox.read("bob.pvs"),
        &sandbox.read("ada.pvs"),
        "of two users",
    );
    // Each user sees one job, and the admin both. A reader may not submit, and only an admin sees the farm.
    for (who, count) in [(&ada, 1), (&bob, 1), (&eve, 0), (&root, 2)] {
        assert_eq!(
            coordinator.ok(&format!("jobs {who}")).lines().count(),
            count
        );
    }
    coordinator
        .run(&format!("submit {JOB} {eve}"))
        .code(4)
        .says("needs the scope submit");
    coordinator
        .run(&format!("workers {ada}"))
        .code(4)
        .says("needs the scope admin");
    coordinator
        .run(&format!("logs {ada}"))
        .code(4)
        .says("scope admin");
    coordinator.ok(&format!("workers {root}"));
    coordinator.ok(&format!("logs {root}"));
    // The user of a job is the user of the token, regardless of the client's `--user`.
    let other = coordinator
        .ok(&format!("submit {JOB} --seed 3 --user bob {ada}"))
        .trim()
        .to_owned();
    assert!(
        coordinator
            .ok(&format!("show {other} --json {ada}"))
            .contains("\"user\":\"ada\"")
    );
    // Jobs of other users do not count as older jobs: ada has two jobs, with one of bob between them.
    let page = coordinator.run(&format!("jobs --limit 1 {ada}")).code(0);
    assert!(
        page.err.contains("older jobs") && page.out.lines().count() == 1,
        "{}",
        page.err
    );
    let page = coordinator.run(&format!("jobs --limit 1 {bob}")).code(0);
    assert!(
        !page.err.contains("older jobs") && page.out.lines().count() == 1,
        "{}",
        page.err
    );
    // No log contains a secret.
    for name in ["ada", "bob", "eve", "root"] {
        let text = String::from_utf8(sandbox.read(&format!("{name}.token"))).unwrap();
        let secret = text.trim().rsplit('_').next().unwrap();
        assert!(!coordinator.process.err().contains(secret) && !worker.err().contains(secret));
    }
}

#[test]
fn quota_limits_data_and_calls_of_user() {
    let sandbox = prepared();
    let quotas = "--quota jobs=1 --quota bob:jobs=none,requests=1 --quota root:requests=none";
    let arguments = format!("--listen 127.0.0.1:0 --tokens tokens.json {quotas}");
    let coordinator = sandbox.serve("data", &arguments);
    let [ada, bob] = ["ada", "bob"].map(|n| format!("--token-file {n}.token"));
    let job: u64 = coordinator
        .ok(&format!("submit {JOB} {ada}"))
        .trim()
        .parse()
        .unwrap();
    // The same job, submitted again, does not count again.
    assert_eq!(
        coordinator.ok(&format!("submit {JOB} {ada}")).trim(),
        job.to_string()
    );
    let other = format!("submit {JOB} --seed 5 {ada}");
    coordinator
        .run(&other)
        .code(4)
        .says("ada may have at most 1 jobs, but would have 2");
    coordinator.ok(&format!("cancel {job} {ada}"));
    coordinator.ok(&format!("delete {job} {ada}"));
    coordinator.ok(&other);
    // Up to five calls are saved up, and the calls of bob do not delay ada.
    let mut refused = false;
    for _ in 0..20 {
        let run = coordinator.run(&format!("jobs {bob}"));
        refused |= run.err.contains("bob may make at most 1 calls per second");
    }
    assert!(refused);
    coordinator.ok(&format!("jobs {ada}"));
    for bad in ["beer=1", "jobs", "jobs=-1", "bytes=1X"] {
        let run = sandbox.run(&format!(
            "coordinator --tokens tokens.json --quota {bad} --listen 127.0.0.1:0"
        ));
        run.code(2).says("is not a quota");
    }
}

#[test]
fn json_calls_count_for_rate_limit() {
    let sandbox = prepared();
    let quotas = "--quota ada:requests=1 --quota bob:calls=2,requests=none";
    let arguments =
        format!("--listen 127.0.0.1:0 --http 127.0.0.1:0 --tokens tokens.json {quotas}");
    let coordinator = sandbox.serve("data", &arguments);
    let pages = coordinator
        .pages
        .trim_start_matches("http://")
        .trim_end_matches('/')
        .to_owned();
    let with = |user: &str| {
        let token = String::from_utf8(sandbox.read(&format!("{user}.token"))).unwrap();
        format!(
            "content-type: application/json\r\nauthorization: Bearer {}\r\n",
            token.trim()
        )
    };
    let list = |user: &str| {
        let (code, body) = ask(&pages, "POST /sightline.v1.Jobs/List", &with(user), "{}");
        (code, String::from_utf8(body).unwrap())
    };
    // Up to five calls are saved up, and calls of both kinds use the saved ones.
    let refused = (0..20)
        .map(|_| list("ada"))
        .find(|(code, _)| *code != 200)
        .unwrap();
    assert_eq!(refused.0, 429);
    assert!(
        refused
            .1
            .contains("ada may make at most 1 calls per second"),
        "{}",
        refused.1
    );
    let is_refused = |_| {
        coordinator
            .run("jobs --token-file ada.token")
            .err
            .contains("1 calls per second")
    };
    assert!((0..20).any(is_refused));
    // A call counts from its first byte to the last byte of its answer. These two wait for their requests.
    let open = || {
        let mut stream = TcpStream::connect(&pages).unwrap();
        let head = format!("host: {pages}\r\n{}content-length: 2\r\n", with("bob"));
        write!(
            stream,
            "POST /sightline.v1.Jobs/List HTTP/1.1\r\n{head}\r\n"
        )
        .unwrap();
        stream
    };
    let mut streams = vec![open(), open()];
    let refused = wait_for("a call too many", || {
        let (code, text) = list("bob");
        // If a list call arrived before one of the streams, the stream was rejected.
        if code == 200 {
            streams.push(open());
        }
        (code != 200).then_some((code, text))
    });
    assert!(
        refused.0 == 429 && refused.1.contains("bob may have at most 2 open calls"),
        "{refused:?}"
    );
    coordinator
        .run("jobs --token-file bob.token")
        .code(4)
        .says("bob may have at most 2 open calls");
    drop(streams);
    wait_for("the end of the calls", || {
        (list("bob").0 == 200).then_some(())
    });
}

#[test]
fn unknown_callers_are_rejected() {
    let mut sandbox = prepared();
    let stranger = authority(&sandbox, "stranger");
    certificate(&sandbox, "forged", &stranger);
    sandbox.write("made-up.token", format!("slt_00000000_{}", "0".repeat(64)));
    {
        let coordinator = guarded(&sandbox);
        coordinator
            .run("jobs --ca farm.pem")
            .code(4)
            .says("needs a token");
        coordinator
            .run("jobs --ca farm.pem --token-file made-up.token")
            .code(4)
            .says("unknown or revoked");
        coordinator
            .run("jobs")
            .code(4)
            .says("give --ca the authority");
        coordinator
            .run("jobs --ca stranger.pem")
            .code(4)
            .says("give --ca the authority");
        coordinator
            .run("jobs --ca missing.pem")
            .code(3)
            .says("missing.pem");
        coordinator.ok("health --ca farm.pem");
        // A client without encryption cannot use an encrypted address.
        let plain = coordinator.url.replace("https", "http");
        sandbox.run(&format!("jobs --coordinator {plain}")).code(4);
        // A worker ends immediately if it may not work. Otherwise it would try forever.
        let worker = "worker --backend cpu --threads 1 --ca farm.pem";
        coordinator
            .run(worker)
            .code(4)
            .says("a worker needs a certificate");
        coordinator
            .run(&format!("{worker} --token-file ada.token"))
            .code(4)
            .says("needs the scope worker");
        let forged = format!("{worker} --cert forged.pem --key forged.key --give-up-after 1");
        coordinator.run(&forged).code(4);
        // A worker's certificate does not permit reading jobs.
        coordinator
            .run("jobs --ca farm.pem --cert worker.pem --key worker.key")
            .code(4)
            .says("needs the scope read");
    }
    // A client does not send a token over an unencrypted connection to another machine. A token is not a
    // command line argument.
    sandbox
        .run("jobs --coordinator http://10.0.0.1:7600 --token-file ada.token")
        .code(2)
        .says("unencrypted");
    sandbox.write("empty.token", "\n");
    sandbox
        .run("jobs --token-file empty.token")
        .code(2)
        .says("one line");
    // The environment variable works as well.
    let text = String::from_utf8(sandbox.read("ada.token")).unwrap();
    sandbox.set("SIGHTLINE_TOKEN", text.trim());
    sandbox.set("SIGHTLINE_CA", "farm.pem");
    let coordinator = guarded(&sandbox);
    assert_eq!(coordinator.ok("jobs"), "");
}

#[test]
fn digest_does_not_open_scene() {
    let sandbox = prepared();
    let coordinator = guarded(&sandbox);
    let ada = "--ca farm.pem --token-file ada.token";
    let job = coordinator
        .ok(&format!("submit {JOB} {ada}"))
        .trim()
        .to_owned();
    let shown = coordinator.ok(&format!("show {job} --json {ada}"));
    let shown: serde_json::Value = serde_json::from_str(&shown).unwrap();
    let hex = shown["scene"].as_str().unwrap().to_owned();
    let scene: Vec<u8> = (0..32)
        .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap())
        .collect();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let client_of = |user: &str| {
        let token = String::from_utf8(sandbox.read(&format!("{user}.token"))).unwrap();
        let credentials = Credentials {
            ca: Some(sandbox.read("farm.pem")),
            identity: None,
            token: Some(Bearer::parse(&token).unwrap()),
        };
        let endpoint = credentials.endpoint(&coordinator.url).unwrap();
        JobsClient::new(credentials.over(runtime.block_on(endpoint.connect()).unwrap()))
    };
    let (mut ada, mut bob) = (client_of("ada"), client_of("bob"));
    let spec = v1::JobSpec {
        scene: scene.clone(),
        ..v1::JobSpec::default()
    };
    let request = v1::SubmitRequest {
        spec: Some(spec),
        ..v1::SubmitRequest::default()
    };
    let refused = runtime.block_on(bob.submit(request.clone())).unwrap_err();
    assert_eq!(refused.code(), tonic::Code::NotFound, "{refused}");
    let refused = runtime.block_on(bob.estimate(request.clone())).unwrap_err();
    assert_eq!(refused.code(), tonic::Code::NotFound, "{refused}");
    // An estimate does not reveal other users' data, regardless of its view box.
    let mut boxed = request.clone();
    if let Some(spec) = &mut boxed.spec {
        let grid = v1::GridCells {
            view_box: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
            ..v1::GridCells::default()
        };
        let portals = v1::Portals {
            cells: Some(v1::portals::Cells::Grid(grid)),
            ..v1::Portals::default()
        };
        let task = v1::Visibility {
            method: Some(v1::visibility::Method::Portals(portals)),
            ..v1::Visibility::default()
        };
        spec.task = Some(v1::job_spec::Task::Visibility(task));
    }
    let estimate = runtime.block_on(bob.estimate(boxed)).unwrap().into_inner();
    assert!(estimate.existing.is_none() && estimate.cost.is_none());
    runtime.block_on(ada.submit(request)).unwrap();
    // The scene is one chunk, whose digest is the scene's digest. It is missing for a user who has not
    // uploaded it.
    let missing = v1::MissingChunksRequest {
        digests: vec![scene.clone()],
    };
    let missing = runtime
        .block_on(bob.missing_chunks(missing))
        .unwrap()
        .into_inner();
    assert_eq!(missing.digests, std::slice::from_ref(&scene));
    let put = v1::PutSceneRequest {
        digest: scene.clone(),
        chunks: vec![scene.clone()],
    };
    let refused = runtime.block_on(bob.put_scene(put)).unwrap_err();
    assert_eq!(refused.code(), tonic::Code::FailedPrecondition, "{refused}");
    let put = v1::PutSceneRequest {
        digest: scene.clone(),
        chunks: Vec::new(),
    };
    assert!(runtime.block_on(bob.put_scene(put)).is_err());
}

#[test]
fn certificates_and_tokens_change_at_run_time() {
    let sandbox = prepared();
    let coordinator = guarded(&sandbox);
    let ada = "--ca farm.pem --token-file ada.token";
    coordinator.ok(&format!("jobs {ada}"));
    // A revoked token is rejected, a new one accepted.
    let listed = sandbox.ok("token list --tokens tokens.json");
    let id = listed
        .lines()
        .find(|line| line.ends_with("ada"))
        .unwrap()
        .split(' ')
        .next()
        .unwrap();
    sandbox.ok(&format!("token revoke --tokens tokens.json {id}"));
    sandbox
        .run(&format!("token revoke --tokens tokens.json {id}"))
        .code(3)
        .says("has no token");
    wait_for("the token to be refused", || {
        coordinator
            .run(&format!("jobs {ada}"))
            .err
            .contains("unknown or revoked")
            .then_some(())
    });
    token(&sandbox, "new", "read");
    wait_for("the new token to be known", || {
        coordinator
            .run("jobs --ca farm.pem --token-file new.token")
            .err
            .is_empty()
            .then_some(())
    });
    // Invalid certificates do not replace the previous ones; valid ones are used from then on.
    let good = sandbox.read("server.pem");
    sandbox.write("server.pem", "spoilt");
    coordinator.process.signal("HUP");
    wait_for("the log to tell", || {
        coordinator
            .process
            .err()
            .contains("stay in use")
            .then_some(())
    });
    coordinator.ok("jobs --ca farm.pem --token-file new.token");
    sandbox.write("server.pem", good);
    let next = authority(&sandbox, "next");
    certificate(&sandbox, "server", &next);
    coordinator.process.signal("HUP");
    wait_for("the new certificate", || {
        coordinator
            .run("jobs --ca next.pem --token-file new.token")
            .err
            .is_empty()
            .then_some(())
    });
    coordinator
        .run("jobs --ca farm.pem --token-file new.token")
        .code(4)
        .says("is not trusted");
    // A file that cannot be used prevents the start.
    for (files, says) in [
        ("--tls-cert town.glb --tls-key server.key", "town.glb"),
        (
            "--tls-cert server.pem --tls-key worker.key",
            "cannot be used together",
        ),
        ("--tls-cert server.pem --tls-key missing.key", "missing.key"),
        (
            "--tls-cert server.pem --tls-key server.key --client-ca server.key",
            "authority",
        ),
        ("--tokens town.glb", "not a file of tokens"),
    ] {
        sandbox
            .run(&format!(
                "coordinator --listen 127.0.0.1:0 --data-dir other {files}"
            ))
            .code(3)
            .says(says);
    }
    sandbox.run("coordinator --tls-cert server.pem").code(2);
}

#[test]
fn json_calls_need_tokens() {
    let sandbox = prepared();
    let arguments = "--listen 127.0.0.1:0 --http 127.0.0.1:0 --tokens tokens.json";
    let coordinator = sandbox.serve("data", arguments);
    let pages = coordinator
        .pages
        .trim_start_matches("http://")
        .trim_end_matches('/')
        .to_owned();
    let token_of = |user: &str| {
        String::from_utf8(sandbox.read(&format!("{user}.token")))
            .unwrap()
            .trim()
            .to_owned()
    };
    let json = "content-type: application/json\r\n";
    let list = "POST /sightline.v1.Jobs/List";
    assert_eq!(ask(&pages, list, json, "{}").0, 401);
    let with = |user: &str| format!("{json}authorization: Bearer {}\r\n", token_of(user));
    assert_eq!(ask(&pages, list, &with("eve"), "{}").0, 200);
    assert_eq!(
        ask(
            &pages,
            "POST /sightline.v1.Farm/ListWorkers",
            &with("ada"),
            "{}"
        )
        .0,
        403
    );
    assert_eq!(
        ask(
            &pages,
            "POST /sightline.v1.Farm/ListWorkers",
            &with("root"),
            "{}"
        )
        .0,
        200
    );
    // Pages show the jobs of all users, so they need the token of an admin.
    assert_eq!(ask(&pages, "GET /", "", "").0, 401);
    assert_eq!(ask(&pages, "GET /live", "", "").0, 401);
    assert_eq!(ask(&pages, "GET /", &with("ada"), "").0, 403);
    // The stream of a job shows the job to callers with the permission.
    let job = coordinator
        .ok(&format!("submit {JOB} --token-file ada.token"))
        .trim()
        .to_owned();
    let live = |who: &str| {
        first_of_stream(
            &pages,
            &format!("/live?job={job}"),
            &with(who),
            "event: job\n",
        )
    };
    assert!(live("root").contains("\"job\":{"));
    assert_eq!(
        ask(&pages, &format!("GET /live?job={job}"), &with("ada"), "").0,
        403
    );
}

#[test]
fn browser_session_ends_at_logout_and_with_its_token() {
    let sandbox = prepared();
    let arguments = "--listen 127.0.0.1:0 --http 127.0.0.1:0 --tokens tokens.json";
    let coordinator = sandbox.serve("data", arguments);
    let pages = coordinator
        .pages
        .trim_start_matches("http://")
        .trim_end_matches('/')
        .to_owned();
    let port = pages.rsplit(':').next().unwrap();
    let token_of = |user: &str| {
        String::from_utf8(sandbox.read(&format!("{user}.token")))
            .unwrap()
            .trim()
            .to_owned()
    };
    let form = "content-type: application/x-www-form-urlencoded\r\n";
    let sent = |token: &str| ask_with_head(&pages, "POST /login", form, format!("token={token}"));
    assert_eq!(sent(&token_of("ada")).0, 403);
    assert_eq!(sent("slt_1_2").0, 401);
    // A form that is longer than a token is rejected unread.
    assert_eq!(sent(&"x".repeat(5000)).0, 413);
    // A login sets a cookie that does not contain the token. The browser sends it only to this port and this
    // site.
    let login = || {
        let (code, head, _) = sent(&token_of("root"));
        assert_eq!(code, 303);
        let set = head
            .lines()
            .find_map(|line| line.strip_prefix("set-cookie: "))
            .unwrap()
            .to_owned();
        assert!(
            !set.contains(token_of("root").rsplit('_').next().unwrap()),
            "{set}"
        );
        let (id, flags) = set.split_once("; ").unwrap();
        assert_eq!(flags, "Path=/; HttpOnly; SameSite=Strict; Max-Age=43200");
        assert!(
            id.starts_with(&format!("sightline-session-{port}=")),
            "{id}"
        );
        format!("cookie: other=1; {id}\r\n")
    };
    let [first, second] = [login(), login()];
    assert_ne!(first, second);
    let (code, head, page) = ask_with_head(&pages, "GET /", &first, "");
    assert!(code == 200 && page.len() > 10_000);
    assert!(head.contains("x-content-type-options: nosniff"), "{head}");
    let policy = head
        .lines()
        .find_map(|line| line.strip_prefix("content-security-policy: "))
        .unwrap();
    assert!(
        policy.starts_with("default-src 'none'") && !policy.contains("unsafe"),
        "{policy}"
    );
    let scene = format!("content-type: application/octet-stream\r\n{first}");
    assert_eq!(
        ask(
            &pages,
            "POST /scenes?name=town.glb",
            &scene,
            sandbox.read("town.glb")
        )
        .0,
        200
    );
    // Neither a token in a cookie nor another id opens a page.
    let raw = format!("cookie: sightline-session-{port}={}\r\n", token_of("root"));
    assert_eq!(ask(&pages, "GET /", &raw, "").0, 401);
    assert_eq!(
        ask(&pages, "GET /", &first.replace("session-", "session-1"), "").0,
        401
    );
    // A logout ends one session. The revocation of the token ends the others.
    let (code, head, _) = ask_with_head(&pages, "POST /logout", &first, "");
    assert!(code == 303 && head.contains("Max-Age=0"), "{head}");
    assert_eq!(ask(&pages, "GET /", &first, "").0, 401);
    assert_eq!(ask(&pages, "GET /", &second, "").0, 200);
    let listed = sandbox.ok("token list --tokens tokens.json");
    let id = listed
        .lines()
        .find(|line| line.contains("root"))
        .and_then(|l| l.split_whitespace().next());
    sandbox.ok(&format!(
        "token revoke --tokens tokens.json {}",
        id.unwrap()
    ));
    wait_for("the end of the session", || {
        (ask(&pages, "GET /", &second, "").0 == 401).then_some(())
    });
}
