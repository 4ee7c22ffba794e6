//! Tests of the dashboard in a browser, and of the calls as JSON.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::{Value, json};
use sightline_tests::{Browser, Sandbox, ask, assert_same, wait_for};

const JOB: &str = "rooms.glb --cells 8x8x8 --block-cells 8 --target-error 0.0003 --backend cpu";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 2000 -o rooms.glb");
    sandbox
}

const JSON: &str = "Content-Type: application/json\r\n";

/// Calls a method. Returns the status and the answer.
fn call(pages: &str, method: &str, request: &Value) -> (u32, Value) {
    let (status, body) = ask(
        pages,
        &format!("POST /sightline.v1.{method}"),
        JSON,
        request.to_string(),
    );
    (status, serde_json::from_slice(&body).unwrap())
}

#[test]
fn calls_are_json_and_foreign_pages_cannot_call() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator_with_pages("data");
    let pages = &coordinator.pages;
    let job = coordinator.submit("rooms.glb --cells 2x1x2 --backend cpu");
    let (status, listed) = call(pages, "Jobs/List", &json!({}));
    assert_eq!(
        (status, &listed["jobs"][0]["state"]),
        (200, &"JOB_STATE_QUEUED".into())
    );
    let of_job = json!({ "job": job });
    assert_eq!(
        call(pages, "Jobs/Pause", &of_job).1["state"],
        "JOB_STATE_PAUSED"
    );
    assert_eq!(
        call(pages, "Jobs/Show", &of_job).1["spec"]["visibility"]["aggressive"]["sampling"]["lines"]
            ["grid"]["z"],
        2
    );
    let tiles = call(pages, "Farm/ListTiles", &of_job).1;
    assert_eq!(
        (tiles["total"].as_u64(), &tiles["tiles"][0]["state"]),
        (Some(1), &"TILE_STATE_WAITING".into())
    );
    // Errors have the codes of the Connect protocol.
    let code = |method: &str, request: &Value| {
        let (status, answer) = call(pages, method, request);
        (
            status,
            answer["code"].as_str().unwrap_or_default().to_owned(),
        )
    };
    assert_eq!(
        code("Jobs/Show", &json!({"job": 99})),
        (404, "not_found".to_owned())
    );
    assert_eq!(
        code("Jobs/Show", &json!({"jobb": 1})),
        (400, "invalid_argument".to_owned())
    );
    assert_eq!(
        code("Jobs/Delete", &of_job),
        (400, "failed_precondition".to_owned())
    );
    assert_eq!(
        code("Jobs/Nothing", &json!({})),
        (501, "unimplemented".to_owned())
    );
    assert_eq!(
        code("Farm/ListTiles", &json!({"job": job, "limit": 10_001})).0,
        400
    );
    let text = |answer: &(u32, Vec<u8>)| String::from_utf8(answer.1.clone()).unwrap();
    let early = ask(pages, &format!("GET /view/{job}"), "", "");
    assert!(
        early.0 == 400 && text(&early).contains("no finished tile"),
        "{}",
        text(&early)
    );
    assert_eq!(ask(pages, "GET /results/x", "", "").0, 404);
    assert_eq!(ask(pages, "GET /nothing", "", "").0, 404);
    // Requests of a page of another site: with a form, with a script, and with its own name for this address.
    let list = "POST /sightline.v1.Jobs/List";
    assert_eq!(
        ask(pages, list, "Content-Type: text/plain\r\n", "{}").0,
        400
    );
    assert_eq!(
        ask(
            pages,
            list,
            &format!("{JSON}Origin: http://evil.example\r\n"),
            "{}"
        )
        .0,
        403
    );
    assert_eq!(
        ask(
            pages,
            list,
            &format!("{JSON}Host: evil.example:80\r\n"),
            "{}"
        )
        .0,
        403
    );
    let own = pages.trim_end_matches('/');
    assert_eq!(
        ask(pages, list, &format!("{JSON}Origin: {own}\r\n"), "{}").0,
        200
    );
    let large = format!("{JSON}X: {}\r\n", "x".repeat(100));
    assert_eq!(
        ask(
            pages,
            list,
            &large,
            format!("{{\"before\":\"{}\"}}", "1".repeat(5 << 20))
        )
        .0,
        413
    );
    // Download the result as a file.
    call(pages, "Jobs/Resume", &of_job);
    let _worker = coordinator.worker();
    let result = coordinator.finish(job);
    let (status, fetched) = ask(pages, &format!("GET /results/{job}.pvs"), "", "");
    assert_eq!(status, 200);
    assert_same(&fetched, &result, "over HTTP");
}

#[test]
fn plain_text_beyond_loopback_needs_permission() {
    let sandbox = Sandbox::new();
    let run = sandbox
        .run("coordinator --listen 127.0.0.1:0 --http 0.0.0.0:0 --data-dir data")
        .code(2);
    assert!(
        run.err.contains("--http") && run.err.contains("--allow-plaintext"),
        "{}",
        run.err
    );
}

#[test]
fn browser_follows_and_changes_job() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator_with_pages("data");
    let Some(browser) = Browser::start([1200, 1500]) else {
        return;
    };
    let job = coordinator.submit(JOB);
    browser.open(&coordinator.pages);
    let text = |selector: &str| {
        let script = format!("return document.querySelector('{selector}')?.textContent ?? ''");
        browser.run(&script).as_str().unwrap().to_owned()
    };
    let press = |what: &str| {
        browser.run(&format!(
            "document.querySelector('[data-call={what}]').click(); return 0"
        ));
    };
    wait_for("the job in the list", || {
        text("#job-rows").contains("rooms.glb").then_some(())
    });
    browser.run("document.querySelector('#job-rows tr').click(); return 0");
    wait_for("the map of tiles", || {
        text("#map-legend").contains("64 ready").then_some(())
    });
    let worker = coordinator.start("worker --backend cpu --threads 1 --name ann");
    wait_for("tiles at work", || {
        text("#job-state").starts_with("running").then_some(())
    });
    press("Pause");
    wait_for("the pause", || {
        text("#job-state").starts_with("paused").then_some(())
    });
    coordinator.until(job, "a rest", |job| job["tiles_running"] == 0);
    press("Resume");
    // The canvas has the colours of the legend, and a click shows the worker that computed a tile.
    wait_for("the end", || {
        text("#job-state").starts_with("done").then_some(())
    });
    wait_for("all tiles done", || {
        text("#map-legend").contains("64 done").then_some(())
    });
    let green = "const c = document.getElementById('map'), pen = c.getContext('2d');
        const p = pen.getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let i = 0; i < p.length; i += 4) n += p[i] === 46 && p[i + 1] === 158 && p[i + 2] === 91;
        return n;";
    wait_for("green tiles", || {
        (browser.run(green).as_u64().unwrap() > 10_000).then_some(())
    });
    let click = "const c = document.getElementById('map'), b = c.getBoundingClientRect();
        c.dispatchEvent(new MouseEvent('click', { clientX: b.left + 20, clientY: b.top + 20 })); return 0";
    browser.run(click);
    wait_for("the tile's words", || {
        text("#map-tile").contains("done on ann").then_some(())
    });
    assert!(
        text("#time-note").contains("1 worker over"),
        "{}",
        text("#time-note")
    );
    assert!(
        text("#events").contains("the job is done"),
        "{}",
        text("#events")
    );
    // The list shows workers as they come and go.
    browser.run("location.hash = 'workers'; return 0");
    wait_for("the worker", || {
        text("#worker-rows").contains("ann").then_some(())
    });
    worker.kill();
    wait_for("its end", || {
        (!text("#worker-rows").contains("ann")).then_some(())
    });
    // Open the result in the viewer.
    browser.open(&format!("{}view/{job}", coordinator.pages));
    let drawn = browser
        .run("return (await sightline).drawn")
        .as_u64()
        .unwrap();
    assert!(drawn > 0);
    // Delete the job, after a confirmation.
    browser.open(&format!("{}#job={job}", coordinator.pages));
    wait_for("the buttons", || {
        text("#job-buttons").contains("Delete").then_some(())
    });
    browser.run("window.confirm = () => true; return 0");
    press("Delete");
    let is_empty = "return !document.getElementById('no-jobs').hidden";
    wait_for("the list without it", || {
        (browser.run(is_empty) == true).then_some(())
    });
    coordinator.run(&format!("show {job}")).code(4);
    assert_eq!(browser.messages(), Vec::<String>::new());
    // Without its coordinator, the page reports the lost connection.
    coordinator.process.kill();
    wait_for("the word about it", || {
        text("#message").contains("does not answer").then_some(())
    });
}

/// Tests the maximum number of tiles of a job, and a thousand workers that join and request no tiles.
#[test]
fn large_farm_is_shown() {
    use sightline_proto::v1;
    use sightline_proto::v1::workers_client::WorkersClient;

    let sandbox = sandbox();
    let coordinator = sandbox.coordinator_with_pages("data");
    let Some(browser) = Browser::start([1200, 900]) else {
        return;
    };
    let job = coordinator.submit("rooms.glb --cells 64x16x64 --block-cells 1 --backend cpu");
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut streams = Vec::new();
    runtime.block_on(async {
        let mut channel = None;
        for number in 0..1000 {
            if number % 100 == 0 {
                let made = tonic::transport::Channel::from_shared(coordinator.url.clone()).unwrap();
                channel = Some(made.connect().await.unwrap());
            }
            let hello = v1::worker_message::Message::Hello(v1::Hello {
                name: format!("w{number:03}"),
                profiles: vec!["cpu/none".to_owned()],
                algorithm: sightline_model::ALGORITHM_VERSION,
                protocol: sightline_proto::PROTOCOL,
                ..Default::default()
            });
            let (say, said) = tokio::sync::mpsc::channel(1);
            say.send(v1::WorkerMessage {
                message: Some(hello),
            })
            .await
            .unwrap();
            let said = tokio_stream::wrappers::ReceiverStream::new(said);
            let heard = WorkersClient::new(channel.clone().unwrap())
                .work(said)
                .await
                .unwrap()
                .into_inner();
            streams.push((say, heard));
        }
    });
    let text = |id: &str| {
        let script = format!("return document.getElementById('{id}').textContent");
        browser.run(&script).as_str().unwrap().to_owned()
    };
    browser.open(&format!("{}#workers", coordinator.pages));
    wait_for("all workers", || {
        text("worker-count")
            .starts_with("1000 workers, of which 300")
            .then_some(())
    });
    browser.run(
        "const f = document.getElementById('worker-filter'); f.value = 'w99';
        f.dispatchEvent(new Event('input')); return 0",
    );
    assert_eq!(text("worker-count"), "10 workers");
    browser.run(&format!("location.hash = 'job={job}'; return 0"));
    wait_for("all tiles", || {
        text("map-legend").contains("65536 ready").then_some(())
    });
    let layers = browser.run("return document.getElementById('map-layer').max");
    assert_eq!(layers, "15");
    assert_eq!(browser.messages(), Vec::<String>::new());
    drop(streams);
}
