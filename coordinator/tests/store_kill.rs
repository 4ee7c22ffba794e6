//! Kills a process that writes to the store at random moments, again and again. After each kill, the store
//! must contain every acknowledged change completely, and no partial change.
//!
//! The test runs itself as the killed process. It kills the process, not the machine: the effect of a power
//! failure depends on the disk's syncs, which no test here can verify.

// The lint's exception for tests does not cover the helper functions of a test.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use sightline_records::ids::Digest;
use sightline_records::ids::TileIndex;
use sightline_records::{
    JobRecord, NewJob, SceneRecord, TileRecord, TileResult, TileState, TileStats,
};
use sightline_store::{Queries as _, SledStore, Store};

const DIRECTORY: &str = "SIGHTLINE_STORE_KILL_DIRECTORY";
const TILES: u32 = 100_000;
const SCENE: Digest = [7; 32];

fn digest_of(what: &str, number: u64) -> Digest {
    *blake3::hash(format!("{what} {number}").as_bytes()).as_bytes()
}

fn job(number: u64) -> NewJob {
    NewJob {
        key: digest_of("job", number),
        request_id: format!("request {number}"),
        name: String::new(),
        owner: String::new(),
        user: String::new(),
        priority: 0,
        scene: SCENE,
        spec: vec![0; 100],
        tiles: if number == 0 { TILES } else { 1 },
        submitted_at_ms: number,
    }
}

fn say(what: &str, number: u64) {
    // A single write prevents the lines of two threads from mixing.
    let mut out = std::io::stdout().lock();
    out.write_all(format!("\n{what} {number}\n").as_bytes())
        .unwrap();
    out.flush().unwrap();
}

/// Commits tiles in one thread and submits jobs in another, until the process is killed. The killed process
/// runs this test.
#[test]
fn writes_until_killed() {
    let Ok(directory) = std::env::var(DIRECTORY) else {
        println!(
            "writes_until_killed does nothing by itself; killed_at_any_moment_nothing_acknowledged_is_lost \
             runs it"
        );
        return;
    };
    let store = SledStore::open(Path::new(&directory)).unwrap();
    store.begin_epoch().unwrap();
    store
        .record_scene(SceneRecord {
            digest: SCENE,
            bytes: 1,
            triangles: 1,
            objects: 1,
            owners: Default::default(),
        })
        .unwrap();
    let first = store.submit_job(job(0)).unwrap().id;
    let done = store
        .tiles(first)
        .unwrap()
        .iter()
        .filter(|tile| tile.state != TileState::Open)
        .count() as u32;
    let submitted = store.jobs().unwrap().len() as u64;
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for tile in done..TILES {
                let stats = TileStats {
                    worker: "w".to_owned(),
                    ..TileStats::default()
                };
                let digest = digest_of("tile", tile.into());
                store
                    .commit_tile(
                        first,
                        TileIndex(tile),
                        TileResult {
                            digest,
                            bytes: 1,
                            stats,
                        },
                    )
                    .unwrap();
                say("tile", tile.into());
            }
        });
        for number in submitted.. {
            store.submit_job(job(number)).unwrap();
            say("job", number);
        }
    });
}

/// Returns the state of the store, for a comparison with a view that is rebuilt from the journal.
fn state(store: &SledStore) -> (u64, Vec<JobRecord>, Vec<TileRecord>) {
    let jobs = store.jobs().unwrap();
    let tiles = jobs
        .first()
        .map(|job| store.tiles(job.id).unwrap())
        .unwrap_or_default();
    (store.epoch().unwrap(), jobs, tiles)
}

#[test]
fn killed_at_any_moment_nothing_acknowledged_is_lost() {
    let directory = tempfile::tempdir().unwrap();
    let program = std::env::current_exe().unwrap();
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut acknowledged: BTreeMap<String, u64> = BTreeMap::new();
    for round in 0..15 {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        let mut child = Command::new(&program)
            .args([
                "writes_until_killed",
                "--exact",
                "--nocapture",
                "--test-threads=1",
            ])
            .env(DIRECTORY, directory.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let out = child.stdout.take().unwrap();
        let reader = std::thread::spawn(move || {
            let lines = BufReader::new(out).lines().map_while(Result::ok);
            let pairs = lines.filter_map(|line| {
                let (what, number) = line.split_once(' ')?;
                Some((what.to_owned(), number.parse::<u64>().ok()?))
            });
            pairs
                .filter(|(what, _)| what == "tile" || what == "job")
                .collect::<Vec<_>>()
        });
        std::thread::sleep(Duration::from_micros(20_000 + random % 250_000));
        child.kill().unwrap();
        let status = child.wait().unwrap();
        assert!(
            !status.success(),
            "round {round}: the process ended by itself"
        );
        for (what, number) in reader.join().unwrap() {
            let last = acknowledged.entry(what).or_default();
            *last = number.max(*last);
        }

        let store = SledStore::open(directory.path()).unwrap();
        let found = state(&store);
        let (_, jobs, tiles) = &found;
        // Each thread works in order, so the last acknowledged number implies all earlier ones.
        for (what, &last) in &acknowledged {
            let there = match what.as_str() {
                "tile" => tiles
                    .iter()
                    .filter(|tile| tile.state != TileState::Open)
                    .count() as u64,
                _ => jobs.len() as u64,
            };
            assert!(
                there > last,
                "round {round}: {what} {last} was acknowledged, only {there} are there"
            );
        }
        for (number, job_record) in (0..).zip(jobs) {
            assert_eq!(job_record.key, job(number).key);
            assert_eq!(
                store.job_by_key(&job_record.key).unwrap().as_ref(),
                Some(job_record)
            );
            assert_eq!(
                store
                    .job_by_request(&job_record.request_id)
                    .unwrap()
                    .as_ref(),
                Some(job_record)
            );
        }
        for tile in tiles {
            match tile.state {
                TileState::Done { digest, .. } => {
                    assert_eq!(digest, digest_of("tile", tile.tile.0.into()))
                }
                _ => assert!(
                    tiles[tile.tile.at()..]
                        .iter()
                        .all(|later| later.state == TileState::Open)
                ),
            }
            if tile.state == TileState::Open {
                break;
            }
        }
        drop(store);
        // The stored view equals the view that the journal produces.
        let other = tempfile::tempdir().unwrap();
        for name in ["journal", "journal.mark"] {
            std::fs::copy(directory.path().join(name), other.path().join(name)).unwrap();
        }
        assert!(
            state(&SledStore::open(other.path()).unwrap()) == found,
            "round {round}: view and journal differ"
        );
    }
    assert!(
        acknowledged.len() == 2,
        "the rounds were too short to acknowledge anything: {acknowledged:?}"
    );
}
