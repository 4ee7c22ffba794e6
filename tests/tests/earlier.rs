//! Tests that this version reads results and data directories of earlier versions, in `tests/earlier/`.
//!
//! `SIGHTLINE_FREEZE=1 cargo test --workspace --test earlier` adds files of this version; run it when a
//! format gains content. From the first release on, these files stay forever. Until then, a change of a
//! format may replace them.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use sightline_tests::{Background, Dump, Sandbox};

/// Bakes that cover every kind of content of a result, in as few bytes as possible.
const RESULTS: [(&str, &str); 6] = [
    (
        "lines",
        "--cells 2x1x2 --target-error 0.03 --backend cpu --cell-to-cell off",
    ),
    (
        "pairs",
        "--cells 2x1x2 --target-error 0.03 --backend cpu --cell-to-cell on",
    ),
    ("tree", "--triangle-budget 60 --max-depth 4 --backend cpu"),
    ("bound", "--cells 2x1x1 --max-error 0.05 --backend cpu"),
    (
        "exact",
        "--cells 2x1x1 --method exact --certificates --backend cpu",
    ),
    ("portals", "--cells 2x1x1 --method portals"),
];
const SCENE: &str = "generate rooms --triangles 300 -o rooms.glb";

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("earlier")
}

/// Returns the frozen folders of a kind, by age.
fn frozen(kind: &str) -> Vec<PathBuf> {
    let folder = folder().join(kind);
    let mut all: Vec<PathBuf> = fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    all.sort();
    assert!(!all.is_empty(), "{} holds nothing", folder.display());
    all
}

fn is_freezing() -> bool {
    std::env::var_os("SIGHTLINE_FREEZE").is_some()
}

/// Creates the next folder of a kind.
fn next(kind: &str) -> PathBuf {
    let folder = folder().join(kind);
    fs::create_dir_all(&folder).unwrap();
    let next = folder.join(format!("{:03}", fs::read_dir(&folder).unwrap().count() + 1));
    fs::create_dir(&next).unwrap();
    next
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns the output of `info` for a result, without the name of the file.
fn info(sandbox: &Sandbox, name: &str) -> Value {
    let mut info = sandbox.json(&format!("info {name}"));
    info.as_object_mut().unwrap().remove("file");
    info
}

fn freeze_results() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let folder = next("results");
    fs::copy(sandbox.path("rooms.glb"), folder.join("rooms.glb")).unwrap();
    for (name, options) in RESULTS {
        let result = format!("{name}.pvs");
        sandbox.ok(&format!(
            "bake rooms.glb {options} --data-dir {name} -o {result}"
        ));
        fs::copy(sandbox.path(&result), folder.join(&result)).unwrap();
        fs::write(
            folder.join(format!("{name}.dump")),
            sandbox.ok(&format!("dump {result}")),
        )
        .unwrap();
        let info = format!("{:#}\n", info(&sandbox, &result));
        fs::write(folder.join(format!("{name}.json")), info).unwrap();
    }
}

/// Checks that today's document contains every value of the frozen document. It may contain more.
fn has(today: &Value, then: &Value, at: &str) {
    match (today, then) {
        (Value::Object(today), Value::Object(then)) => {
            for (key, value) in then {
                let found = today
                    .get(key)
                    .unwrap_or_else(|| panic!("{at} has no {key} any more"));
                has(found, value, &format!("{at}.{key}"));
            }
        }
        _ => assert_eq!(today, then, "{at}"),
    }
}

#[test]
fn results_of_earlier_versions_have_same_contents() {
    if is_freezing() {
        freeze_results();
    }
    for folder in frozen("results") {
        let sandbox = Sandbox::new();
        copy(&folder, &sandbox.path("."));
        let mut results = 0;
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_none_or(|e| e != "pvs") {
                continue;
            }
            results += 1;
            let at = path.display().to_string();
            let name = path.file_name().unwrap().to_str().unwrap();
            assert_eq!(
                sandbox.ok(&format!("dump {name}")),
                read(&path.with_extension("dump")),
                "{at}"
            );
            let then: Value = serde_json::from_str(&read(&path.with_extension("json"))).unwrap();
            has(&info(&sandbox, name), &then, &at);
            let dump = Dump::parse(&read(&path.with_extension("dump")));
            let [x, y, z] = dump.cells[0].middle();
            let answer = sandbox.json(&format!("query {name} {x} {y} {z}"));
            assert_eq!(answer["visible"], json!(dump.cells[0].visible), "{at}");
        }
        assert!(results > 0, "{} has no results", folder.display());
        // The proofs hold for their scene.
        let verified = sandbox.json("verify rooms.glb exact.pvs");
        assert_eq!(verified["accepted"], true, "{verified}");
        assert!(
            verified["certificates_checked"].as_u64().unwrap() > 0,
            "{verified}"
        );
    }
}

/// The options of a job in `data/`, by its name.
const JOBS: [(&str, &str); 6] = [
    ("done", "--cells 2x1x2 --target-error 0.03"),
    ("again", "--cells 2x2x2 --target-error 0.03"),
    ("exact", "--cells 2x1x1 --method exact --certificates"),
    ("half", "--cells 8x8x8 --block-cells 8 --target-error 0.01"),
    ("cancelled", "--cells 4x1x2 --target-error 0.03"),
    (
        "waiting",
        "--cells 8x1x8 --block-cells 8 --target-error 0.03 --priority 3",
    ),
];

fn freeze_data() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let coordinator = sandbox.serve("data", "--listen 127.0.0.1:0 --spot-check 1");
    let workers = ["ann", "bob"]
        .map(|name| coordinator.start(&format!("worker --backend cpu --threads 1 --name {name}")));
    let submit = |(name, options): &(&str, &str)| {
        coordinator.submit(&format!("rooms.glb {options} --backend cpu --name {name}"))
    };
    let mut results = serde_json::Map::new();
    for job in &JOBS[..3] {
        let job = submit(job);
        let bytes = coordinator.finish(job);
        results.insert(
            job.to_string(),
            json!(blake3::hash(&bytes).to_hex().to_string()),
        );
    }
    // Compute the tiles again, so that records of tiles and of the job mention it.
    coordinator.ok("invalidate 2");
    coordinator.finish(2);
    let half = submit(&JOBS[3]);
    coordinator.until(half, "some tiles", |job| {
        job["tiles_done"].as_u64() >= Some(5)
    });
    coordinator.ok(&format!("pause {half} --now"));
    workers.into_iter().for_each(Background::kill);
    let done = coordinator.count(half, "tiles_done");
    assert!(
        done < coordinator.count(half, "tiles_total"),
        "all {done} tiles are done; make the job larger"
    );
    let cancelled = submit(&JOBS[4]);
    coordinator.ok(&format!("cancel {cancelled}"));
    submit(&JOBS[5]);
    let jobs = coordinator.json("jobs --all");
    coordinator.process.signal("TERM");
    coordinator.process.end().code(0);
    let folder = next("data");
    sandbox.ok(&format!(
        "store export --data-dir data -o {}",
        folder.join("records.jsonl").display()
    ));
    copy(&sandbox.path("data"), &folder.join("data"));
    for made_anew in [
        "data/state/sled",
        "data/crews",
        "data/events",
        "data/copies",
    ] {
        // Some of these folders do not exist.
        drop(fs::remove_dir_all(folder.join(made_anew)));
    }
    drop(fs::remove_file(folder.join("data/state/lock")));
    let algorithm = info(&sandbox, "fetched-1.pvs")["info"]["algorithm"].clone();
    let then = json!({ "algorithm": algorithm, "jobs": jobs, "results": results });
    fs::write(folder.join("then.json"), format!("{then:#}\n")).unwrap();
}

/// Checks that the records are unchanged, the results can be downloaded, and waiting jobs finish. If this
/// version samples differently, the job has to report that.
#[test]
fn data_of_earlier_versions_is_served() {
    if is_freezing() {
        freeze_data();
    }
    for folder in frozen("data") {
        let at = folder.display().to_string();
        let then: Value = serde_json::from_str(&read(&folder.join("then.json"))).unwrap();
        let sandbox = Sandbox::new();
        copy(&folder.join("data"), &sandbox.path("data"));
        sandbox.ok("store verify --data-dir data");
        sandbox.ok("store export --data-dir data -o records.jsonl");
        let records = String::from_utf8(sandbox.read("records.jsonl")).unwrap();
        assert_eq!(records, read(&folder.join("records.jsonl")), "{at}");

        sandbox.ok(SCENE);
        sandbox.ok("bake rooms.glb --cells 1x1x1 --backend cpu --data-dir own -o own.pvs");
        let own = info(&sandbox, "own.pvs")["info"].clone();
        let is_same = own["algorithm"] == then["algorithm"];
        let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
        for (job, digest) in then["results"].as_object().unwrap() {
            coordinator.ok(&format!("fetch {job} -o {job}.pvs"));
            let bytes = sandbox.read(&format!("{job}.pvs"));
            assert_eq!(
                json!(blake3::hash(&bytes).to_hex().to_string()),
                *digest,
                "{at}, job {job}"
            );
        }
        let _worker = coordinator.worker();
        let jobs = coordinator.json("jobs --all");
        let text = |job: &Value, key: &str| job[key].as_str().unwrap_or_default().to_owned();
        for (today, then) in jobs
            .as_array()
            .unwrap()
            .iter()
            .zip(then["jobs"].as_array().unwrap())
        {
            assert_eq!(
                (&today["job"], &today["name"]),
                (&then["job"], &then["name"]),
                "{at}"
            );
            let (job, state) = (then["job"].as_u64().unwrap(), text(then, "state"));
            if is_same && state == "paused" {
                assert_eq!(
                    (&today["state"], &today["tiles_done"]),
                    (&then["state"], &then["tiles_done"])
                );
                coordinator.ok(&format!("resume {job}"));
            }
            let goes_on = ["queued", "paused"].contains(&state.as_str());
            let profile = text(then, "profile");
            if goes_on && is_same && !profile.is_empty() && own["profile"] != *profile {
                // A begun job keeps the numerics profile of its first tiles. This machine has another
                // processor than the machine that froze the data, so the coordinator reports its worker.
                let reason = format!("the job is bound to the numerics profile {profile}");
                coordinator.until(job, "the report of an ineligible worker", |job| {
                    let unable = job["unable"].as_array().unwrap();
                    unable.iter().any(|u| text(u, "reason").contains(&reason))
                });
                continue;
            }
            let ended = coordinator.until(job, "its end", |job| {
                ["done", "failed", "cancelled"].contains(&text(job, "state").as_str())
            });
            if goes_on && !is_same {
                assert_eq!(ended["state"], "failed", "{at}: {ended}");
                let reason = text(&ended, "reason");
                assert!(
                    reason.contains("another version of this program began the job"),
                    "{at}: {reason}"
                );
            } else {
                let expected = if goes_on { "done" } else { &state };
                assert_eq!(text(&ended, "state"), expected, "{at}: {ended}");
            }
        }
        assert_eq!(
            jobs.as_array().unwrap().len(),
            then["jobs"].as_array().unwrap().len()
        );
    }
}
