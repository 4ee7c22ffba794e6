//! Tests of traces of jobs that several processes send to one collector: complete trees without secrets, and
//! no cost if the collector is absent.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_tests::{Collector, ReceivedSpan, Sandbox, assert_same, wait_for};

/// The job has eight tiles.
const JOB: &str = "town.glb --cells 4x4x2 --block-cells 4 --target-error 0.1 --backend cpu";
/// The maximum delay from the end of a lease to the end of its worker's span, in nanoseconds. The span
/// includes the answer to the upload.
const ON_THE_WAY: u64 = 500_000_000;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 2000 -o town.glb");
    sandbox
}

/// Waits for the span of a whole job and for the given numbers of other spans. Returns all received spans.
fn whole(collector: &Collector, others: &[(&str, usize)]) -> Vec<ReceivedSpan> {
    wait_for("all spans", || {
        let taken = collector.taken();
        let count = |name: &str| taken.iter().filter(|span| span.name == name).count();
        (count("job") > 0 && others.iter().all(|(name, least)| count(name) >= *least))
            .then_some(taken)
    })
}

/// Waits like [`whole`], and also for the parents of all spans. Each process sends its spans at its own time,
/// so a parent may arrive last.
fn whole_tree(collector: &Collector, others: &[(&str, usize)]) -> Vec<ReceivedSpan> {
    wait_for("all parents", || {
        let taken = whole(collector, others);
        let there: BTreeSet<&str> = taken.iter().map(|span| span.ids[1].as_str()).collect();
        let is_there =
            |span: &ReceivedSpan| span.ids[2].is_empty() || there.contains(span.ids[2].as_str());
        let is_tree = taken.iter().all(is_there);
        is_tree.then_some(taken)
    })
}

/// Panics unless the spans are one tree below `job`, and each span lies within its parent's time.
fn assert_tree(taken: &[ReceivedSpan]) {
    let by_id: BTreeMap<&str, &ReceivedSpan> = taken
        .iter()
        .map(|span| (span.ids[1].as_str(), span))
        .collect();
    assert_eq!(by_id.len(), taken.len(), "no id is there twice: {taken:#?}");
    assert_eq!(
        taken
            .iter()
            .map(|span| &span.ids[0])
            .collect::<BTreeSet<_>>()
            .len(),
        1,
        "one trace"
    );
    let roots: Vec<&ReceivedSpan> = taken.iter().filter(|span| span.ids[2].is_empty()).collect();
    assert_eq!(
        roots
            .iter()
            .map(|span| span.name.as_str())
            .collect::<Vec<_>>(),
        ["job"]
    );
    for span in taken {
        let [begin, end] = span.times;
        assert!(
            begin <= end && begin > 1_600_000_000_000_000_000,
            "{span:?}"
        );
        assert_eq!(span.attributes["sightline.job"], "1", "{span:?}");
        let Some(parent) = by_id.get(span.ids[2].as_str()) else {
            assert_eq!(span.name, "job", "no parent: {span:?}");
            continue;
        };
        let below = match span.name.as_str() {
            "submit" | "plan" | "wait" | "lease" | "assemble" => "job",
            "commit" | "tile" | "help" => "lease",
            "turn" | "compute" => parent.name.as_str(),
            "fetch" if parent.name == "help" => "help",
            "fetch" => "tile",
            "phase" | "items" => "compute",
            "upload" if parent.name == "submit" => "submit",
            "upload" => "tile",
            other => unreachable!("a span {other}"),
        };
        assert_eq!(parent.name, below, "{span:?}");
        // The scene is uploaded before its job exists, and the time of the record has milliseconds.
        let ahead = matches!(
            (span.name.as_str(), below),
            ("submit" | "plan" | "wait", "job")
        );
        assert!(
            ahead || begin >= parent.times[0],
            "{span:?} begins before {parent:?}"
        );
        // A worker whose waiting tile was given to another one notices this only after its previous tile.
        let late = span
            .attributes
            .get("sightline.end")
            .is_some_and(|end| end == "taken_back");
        assert!(
            late || end <= parent.times[1] + ON_THE_WAY,
            "{span:?} ends after {parent:?}"
        );
        if let (Some(tile), Some(of)) = (
            span.attributes.get("sightline.tile"),
            parent.attributes.get("sightline.tile"),
        ) {
            assert_eq!(tile, of, "{span:?} below {parent:?}");
        }
    }
}

fn named<'a>(taken: &'a [ReceivedSpan], name: &'a str) -> impl Iterator<Item = &'a ReceivedSpan> {
    taken.iter().filter(move |span| span.name == name)
}

/// Returns the instances of a service that have sent spans.
fn instances<'a>(taken: &'a [ReceivedSpan], service: &str) -> BTreeSet<&'a str> {
    taken
        .iter()
        .filter(|span| span.service == service)
        .map(|span| span.instance.as_str())
        .collect()
}

#[test]
fn job_is_one_tree_across_processes_without_secrets() {
    let mut sandbox = sandbox();
    let token = |user: &str, scope: &str| {
        let text = sandbox.ok(&format!(
            "token new --tokens tokens.json --user {user} --scope {scope}"
        ));
        sandbox.write(&format!("{user}.token"), &text);
        text.trim().to_owned()
    };
    let secrets = [token("ada", "submit"), token("worker", "worker")];
    sandbox.set("SIGHTLINE_TOKEN", &secrets[0]);
    let collector = Collector::new();
    let traces = format!("--traces {}", collector.url());
    let coordinator = sandbox.serve(
        "data",
        &format!("--listen 127.0.0.1:0 --tokens tokens.json {traces}"),
    );
    let job = coordinator.submit(&format!("{JOB} {traces} --name of-the-test"));
    let worker = |name: &str| {
        let line =
            format!("worker --backend cpu --threads 1 --name {name} --token-file worker.token");
        coordinator.start(&format!("{line} {traces}"))
    };
    let _workers = [worker("one"), worker("two")];
    let bytes = coordinator.finish(job);
    let wanted = [
        ("plan", 1),
        ("submit", 1),
        ("assemble", 1),
        ("wait", 8),
        ("lease", 8),
        ("tile", 8),
    ];
    let and = [("compute", 8), ("commit", 8), ("upload", 9)];
    let taken = whole_tree(&collector, &[&wanted[..], &and[..]].concat());
    assert_tree(&taken);
    let counts = |name| named(&taken, name).count();
    for once in ["job", "plan", "submit", "assemble"] {
        assert_eq!(counts(once), 1, "{once}");
    }
    let done = |span: &&ReceivedSpan| span.attributes["sightline.end"] == "done";
    for (name, least) in [
        ("wait", 8),
        ("lease", 8),
        ("tile", 8),
        ("compute", 8),
        ("commit", 8),
    ] {
        assert!(counts(name) >= least, "{name}: {}", counts(name));
    }
    assert_eq!(named(&taken, "commit").filter(done).count(), 8);
    // The scene is uploaded once, and each tile's output once.
    assert!(counts("upload") >= 9);
    assert!(
        named(&taken, "fetch").any(|span| span.service == "sightline-worker"),
        "the scene was fetched"
    );
    let workers = instances(&taken, "sightline-worker");
    assert!(
        !workers.is_empty() && workers.iter().all(|name| ["one", "two"].contains(name)),
        "{workers:?}"
    );
    assert_eq!(instances(&taken, "sightline-coordinator").len(), 1);
    assert_eq!(instances(&taken, "sightline-submit").len(), 1);
    // The span has the same words and numbers as the other outputs.
    let shown = coordinator.json(&format!("show {job}"));
    let root = named(&taken, "job").next().unwrap();
    assert_eq!(shown["trace"].as_str(), Some(root.ids[0].as_str()));
    assert_eq!(root.attributes["sightline.tiles"], "8");
    assert_eq!(
        root.attributes["sightline.profile"],
        shown["profile"].as_str().unwrap()
    );
    assert_eq!(root.attributes["sightline.bytes"], bytes.len().to_string());
    let sum: u64 = named(&taken, "commit")
        .filter(done)
        .map(|span| span.attributes["sightline.samples"].parse::<u64>().unwrap())
        .sum();
    assert_eq!(shown["samples"].as_u64(), Some(sum));
    let folder = sandbox.path("").display().to_string();
    for hidden in secrets.iter().map(String::as_str).chain([
        folder.trim_end_matches('/'),
        "town",
        "of-the-test",
    ]) {
        let found = taken.iter().find(|span| span.whole.contains(hidden));
        assert!(found.is_none(), "{hidden} in {found:?}");
    }
}

#[test]
fn trace_continues_after_killed_coordinator() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 20000 -o town.glb");
    let collector = Collector::new();
    let traces = format!("--traces {}", collector.url());
    let coordinator = sandbox.serve("data", &format!("--listen 127.0.0.1:0 {traces}"));
    let address = coordinator.address();
    // The job has 64 tiles and lasts several seconds.
    let job = "town.glb --cells 8x8x4 --block-cells 4 --target-error 0.0003 --backend cpu";
    let job = coordinator.submit(job);
    let _worker = coordinator.start(&format!("worker --backend cpu --threads 1 {traces}"));
    coordinator.until(job, "a tile", |now| now["tiles_done"].as_u64() > Some(0));
    let of_before = || !instances(&collector.taken(), "sightline-coordinator").is_empty();
    wait_for("a span of before", || of_before().then_some(()));
    let before = coordinator.json(&format!("show {job}"));
    assert!(
        before["tiles_done"].as_u64() < Some(60),
        "it was too fast: {before}"
    );
    let first: Vec<String> = instances(&collector.taken(), "sightline-coordinator")
        .into_iter()
        .map(str::to_owned)
        .collect();
    coordinator.process.kill();
    let coordinator = sandbox.serve("data", &format!("--listen {address} {traces}"));
    coordinator.finish(job);
    assert_eq!(
        coordinator.json(&format!("show {job}"))["trace"],
        before["trace"]
    );
    let taken = whole(&collector, &[("assemble", 1)]);
    assert_eq!(
        instances(&taken, "sightline-coordinator").len(),
        2,
        "both have sent spans"
    );
    assert_eq!(
        taken
            .iter()
            .map(|span| &span.ids[0])
            .collect::<BTreeSet<_>>()
            .len(),
        1,
        "of one trace"
    );
    let roots: Vec<&ReceivedSpan> = taken.iter().filter(|span| span.ids[2].is_empty()).collect();
    assert_eq!(
        roots
            .iter()
            .map(|span| span.name.as_str())
            .collect::<Vec<_>>(),
        ["job"]
    );
    assert_eq!(before["trace"].as_str(), Some(roots[0].ids[0].as_str()));
    // An output that was committed after the restart is below its lease, regardless of the coordinator that
    // granted it.
    let second = |span: &&ReceivedSpan| {
        span.service == "sightline-coordinator" && !first.contains(&span.instance)
    };
    let since = named(&taken, "commit")
        .filter(second)
        .map(|span| span.times[0])
        .min()
        .unwrap();
    let leases: BTreeSet<&str> = named(&taken, "lease")
        .map(|span| span.ids[1].as_str())
        .collect();
    let done =
        |span: &&ReceivedSpan| span.attributes["sightline.end"] == "done" && span.times[1] > since;
    let after: Vec<&ReceivedSpan> = named(&taken, "tile").filter(done).collect();
    assert!(!after.is_empty());
    assert!(
        after
            .iter()
            .all(|span| leases.contains(span.ids[2].as_str())),
        "{after:#?}"
    );
}

#[test]
fn helpers_of_crew_are_below_lease_of_leader() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 60000 -o town.glb");
    let collector = Collector::new();
    let traces = format!("--traces {}", collector.url());
    let coordinator = sandbox.serve("data", &format!("--listen 127.0.0.1:0 {traces}"));
    let worker = |name| {
        coordinator.start(&format!(
            "worker --backend cpu --threads 1 --name {name} {traces}"
        ))
    };
    let _workers = [worker("one"), worker("two")];
    let job = coordinator.submit("town.glb --backend cpu --target-error 1e-3");
    coordinator.finish(job);
    let taken = whole_tree(&collector, &[("tile", 1), ("help", 1)]);
    assert_tree(&taken);
    let tile = named(&taken, "tile").next().unwrap();
    let help = named(&taken, "help").next().unwrap();
    assert_eq!(tile.ids[2], help.ids[2], "both below the lease");
    assert_ne!(tile.instance, help.instance);
    assert!(named(&taken, "phase").all(|span| span.instance == tile.instance));
    let items = named(&taken, "items")
        .map(|span| span.attributes["sightline.items"].parse::<u64>().unwrap());
    assert!(items.sum::<u64>() > 0, "the helper has computed some");
    assert!(named(&taken, "items").all(|span| span.instance == help.instance));
}

#[test]
fn bake_in_one_process_sends_tree() {
    let sandbox = sandbox();
    let collector = Collector::new();
    // Tiles of cubes depend on other tiles, and wait for them.
    let job = "town.glb --cells 2x2x1 --sampler cubes --resolution 32 --backend cpu";
    sandbox.ok(&format!(
        "bake {job} -o traced.pvs --data-dir one --traces {}",
        collector.url()
    ));
    sandbox.ok(&format!("bake {job} -o alone.pvs --data-dir two"));
    assert_same(
        &sandbox.read("traced.pvs"),
        &sandbox.read("alone.pvs"),
        "with traces and without",
    );
    // No span is sent after the end.
    let taken = collector.taken();
    assert_tree(&taken);
    for name in [
        "job", "submit", "plan", "wait", "lease", "tile", "compute", "commit", "assemble",
    ] {
        assert!(named(&taken, name).next().is_some(), "no span {name}");
    }
    assert!(taken.iter().all(|span| span.service == "sightline-bake"));
    let again = sandbox.run(&format!(
        "bake {job} -o again.pvs --data-dir one --traces {}",
        collector.url()
    ));
    again.code(0);
    assert_eq!(collector.taken().len(), taken.len(), "nothing took time");
}

#[test]
fn absent_or_silent_collector_costs_only_log_line() {
    let sandbox = sandbox();
    let bake = |name: &str, more: &str| {
        let began = Instant::now();
        let run = sandbox
            .run(&format!(
                "bake {JOB} -o {name}.pvs --data-dir {name} {more}"
            ))
            .code(0);
        (run, began.elapsed(), sandbox.read(&format!("{name}.pvs")))
    };
    let (_, alone, bytes) = bake("alone", "");
    let silent = Collector::silent();
    // No server listens at this address, which a collector has used.
    let gone = Collector::new().url().to_owned();
    for (name, url) in [("gone", gone.as_str()), ("silent", silent.url())] {
        let (run, took, same) = bake(name, &format!("--traces {url}"));
        assert_same(&same, &bytes, name);
        let lines: Vec<&str> = run.err.lines().filter(|line| line.contains(url)).collect();
        assert!((1..=2).contains(&lines.len()), "{name}: {}", run.err);
        assert!(
            lines
                .iter()
                .any(|line| line.contains("spans have not reached")),
            "{name}: {lines:?}"
        );
        // At its end, a process waits two seconds for a silent collector.
        assert!(
            took < alone * 3 + std::time::Duration::from_secs(10),
            "{name}: {took:?}, {alone:?} without"
        );
    }
}

#[test]
fn invalid_address_is_rejected_without_its_password() {
    let sandbox = sandbox();
    let bake = |url: &str| {
        sandbox
            .run(&format!(
                "bake {JOB} -o no.pvs --data-dir no --traces {url}"
            ))
            .code(2)
    };
    bake("127.0.0.1:4317").says("cannot be a collector's address");
    let run =
        bake("http://ada:hunter2@127.0.0.1:4317").says("must not contain a user or a password");
    assert!(!run.err.contains("hunter2"), "{}", run.err);
}

#[test]
fn submission_links_to_its_cause() {
    let sandbox = sandbox();
    let collector = Collector::new();
    let coordinator = sandbox.serve(
        "data",
        &format!("--listen 127.0.0.1:0 --traces {}", collector.url()),
    );
    // A client without traces, which uploads the scene.
    let job = coordinator.submit(JOB);
    let scene = coordinator.json(&format!("show {job}"))["scene"]
        .as_str()
        .unwrap()
        .to_owned();
    let digit = |at: usize| u8::from_str_radix(&scene[2 * at..2 * at + 2], 16).unwrap();
    let scene: Vec<u8> = (0..32).map(digit).collect();
    let parent = ["4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"];
    let submit = async |parent: &str| {
        let mut jobs = JobsClient::connect(coordinator.url.clone()).await.unwrap();
        let spec = Some(v1::JobSpec {
            scene: scene.clone(),
            ..v1::JobSpec::default()
        });
        let mut request = tonic::Request::new(v1::SubmitRequest {
            spec,
            ..v1::SubmitRequest::default()
        });
        request
            .metadata_mut()
            .insert("traceparent", parent.parse().unwrap());
        jobs.submit(request)
            .await
            .unwrap()
            .into_inner()
            .job
            .unwrap()
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let job = runtime.block_on(submit(&format!("00-{}-{}-01", parent[0], parent[1])));
    let plans = wait_for("both plans", || {
        let plans: Vec<ReceivedSpan> = named(&collector.taken(), "plan").cloned().collect();
        (plans.len() == 2).then_some(plans)
    });
    let hex: String = job.trace.iter().map(|byte| format!("{byte:02x}")).collect();
    let (linked, plain): (Vec<&ReceivedSpan>, Vec<&ReceivedSpan>) =
        plans.iter().partition(|span| span.ids[0] == hex);
    assert_eq!(linked[0].links, [parent.map(str::to_owned)]);
    assert!(plain[0].links.is_empty());
}

/// Measures the cost of traces:
/// `cargo test --release --workspace --test traces -- --ignored --nocapture measures_cost_of_traces`.
#[test]
#[ignore = "a measurement of minutes"]
#[allow(clippy::print_stdout, reason = "a measurement")]
fn measures_cost_of_traces() {
    const ROUNDS: usize = 6;
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 20000 -o town.glb");
    let collector = Collector::new();
    // Use many small tiles: 64 tiles of 8 cells.
    let job = "town.glb --cells 8x8x8 --block-cells 8 --target-error 0.02 --backend cpu";
    let mut seconds = [Vec::new(), Vec::new()];
    for round in 0..ROUNDS {
        for (which, more) in ["".to_owned(), format!("--traces {}", collector.url())]
            .iter()
            .enumerate()
        {
            let name = format!("{round}-{which}");
            let line = format!("bake {job} -o {name}.pvs --data-dir {name} {more}");
            seconds[which].push(sandbox.json(&line)["cpu_seconds"].as_f64().unwrap());
            std::fs::remove_dir_all(sandbox.path(&name)).unwrap();
        }
    }
    for (what, mut seconds) in ["without", "with"].into_iter().zip(seconds) {
        // The first round warms up the disk.
        seconds.remove(0);
        seconds.sort_by(f64::total_cmp);
        println!(
            "{what} traces: median {:.3} s of the CPU, {seconds:.3?}",
            seconds[ROUNDS / 2 - 1]
        );
    }
    println!("{} spans of a bake", collector.taken().len() / ROUNDS);
}
