//! Tests of a block that several workers share: the result equals the bytes of one process, regardless of
//! workers that come, go, stop or die.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::OnceLock;

use sightline_tests::{Background, Coordinator, Sandbox, assert_same, wait_for};

/// The scene of a job with one tile of several seconds, with default flags except for the target
/// error.
const SCENE: &str = "generate town --triangles 60000 -o town.glb";
const JOB: &str = "town.glb --backend cpu --target-error 5e-5";

fn sandbox() -> Sandbox {
    let mut sandbox = Sandbox::new();
    sandbox.set("SIGHTLINE_LOG", "sightline=debug");
    sandbox.ok(SCENE);
    sandbox
}

/// Returns the result of [`JOB`] in one process.
fn alone() -> &'static [u8] {
    static ALONE: OnceLock<Vec<u8>> = OnceLock::new();
    ALONE.get_or_init(|| {
        let sandbox = sandbox();
        sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir data"));
        sandbox.read("alone.pvs")
    })
}

/// Returns true if the complete outcome of a phase is on the disk: its length, a hash and the bytes.
fn has_outcome(sandbox: &Sandbox) -> bool {
    let Ok(files) = std::fs::read_dir(sandbox.path("data/crews")) else {
        return false;
    };
    let is_whole = |bytes: Vec<u8>| {
        let length = bytes
            .first_chunk()
            .map(|length| u64::from_le_bytes(*length));
        length.is_some_and(|length| bytes.len() as u64 >= 8 + 32 + length)
    };
    files
        .flatten()
        .any(|file| std::fs::read(file.path()).is_ok_and(is_whole))
}

/// Starts a job with one worker, which leads its only tile and has stored outcomes.
fn led<'a>(sandbox: &'a Sandbox, coordinator: &Coordinator<'a>) -> (u64, Background) {
    let job = coordinator.submit(JOB);
    let leader = coordinator.worker();
    wait_for("an outcome", || has_outcome(sandbox).then_some(()));
    (job, leader)
}

/// Waits until a worker helps.
fn helps(worker: &Background) {
    wait_for("a worker that helps", || {
        worker.err().contains("helps with tile").then_some(())
    });
}

/// Returns true if a worker has continued the work of a lost worker.
fn has_gone_on(worker: &Background) -> bool {
    worker.err().contains("phases of an earlier worker")
}

#[test]
fn late_workers_share_block() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let (job, leader) = led(&sandbox, &coordinator);
    let helpers = [coordinator.worker(), coordinator.worker()];
    helpers.iter().for_each(helps);
    let shown = coordinator.json(&format!("show {job}"));
    let team = &shown["teams"][0];
    assert_eq!(team["helpers"].as_array().map(Vec::len), Some(2), "{shown}");
    let names = coordinator.ok(&format!("show {job}"));
    assert!(
        names.contains(&format!(
            "{} leads, helped by ",
            team["leader"].as_str().unwrap()
        )),
        "{names}"
    );
    assert_same(&coordinator.finish(job), alone(), "with helpers");
    assert_eq!(coordinator.count(job, "tiles_total"), 1);
    wait_for("rays of helpers", || {
        leader.err().contains("rays of helpers").then_some(())
    });
    assert_eq!(
        sandbox.files_below("data/crews"),
        0,
        "the outcomes are not needed any more"
    );
}

#[test]
fn block_of_killed_leader_continues() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let (job, leader) = led(&sandbox, &coordinator);
    let heirs = [coordinator.worker(), coordinator.worker()];
    heirs.iter().for_each(helps);
    leader.kill();
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after the leader was killed",
    );
    assert_eq!(
        heirs.iter().filter(|heir| has_gone_on(heir)).count(),
        1,
        "one of them leads now"
    );
}

#[test]
fn helpers_that_die_or_stop_do_not_delay() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let (job, _leader) = led(&sandbox, &coordinator);
    let helpers = [coordinator.worker(), coordinator.worker()];
    helpers.iter().for_each(helps);
    let [dies, stops] = helpers;
    stops.signal("STOP");
    dies.kill();
    assert_same(&coordinator.finish(job), alone(), "with lost helpers");
    stops.signal("CONT");
}

#[test]
fn killed_coordinator_loses_no_phase() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let address = coordinator.address();
    let (job, leader) = led(&sandbox, &coordinator);
    coordinator.process.kill();
    leader.kill();
    let coordinator = sandbox.coordinator("data", &address);
    let heir = coordinator.worker();
    assert_same(&coordinator.finish(job), alone(), "after all were killed");
    assert!(has_gone_on(&heir));
}

#[test]
fn interrupted_bake_continues_block() {
    let sandbox = sandbox();
    let line = format!("bake {JOB} -o whole.pvs --data-dir data");
    let interrupted = sandbox.start(&line);
    wait_for("an outcome", || has_outcome(&sandbox).then_some(()));
    interrupted.kill();
    let again = sandbox.run(&line).code(0);
    assert!(
        again.err.contains("phases of an earlier worker"),
        "{}",
        again.err
    );
    assert_same(&sandbox.read("whole.pvs"), alone(), "after an interruption");
}

#[test]
fn leader_has_crew_again_after_coordinator_restart() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let address = coordinator.address();
    let (job, leader) = led(&sandbox, &coordinator);
    coordinator.process.kill();
    let coordinator = sandbox.coordinator("data", &address);
    let again = || leader.err().contains("has a crew again").then_some(());
    wait_for("the leader's new stream", again);
    let helper = coordinator.worker();
    helps(&helper);
    assert_same(&coordinator.finish(job), alone(), "with another crew");
    assert!(!has_gone_on(&helper), "the leader kept its tile");
}

#[test]
fn exact_cells_are_shared() {
    let sandbox = sandbox();
    sandbox.ok("generate rooms --triangles 600 -o rooms.glb");
    let exact = "rooms.glb --backend cpu --cells 2x2x2 --method exact --certificates";
    sandbox.ok(&format!("bake {exact} -o alone.pvs --data-dir alone"));
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let (one, two) = (coordinator.worker(), coordinator.worker());
    let job = coordinator.submit(exact);
    assert_same(
        &coordinator.finish(job),
        &sandbox.read("alone.pvs"),
        "two workers",
    );
    assert_eq!(coordinator.count(job, "tiles_total"), 1);
    let shared = [&one, &two]
        .iter()
        .any(|worker| worker.err().contains("rays of helpers"));
    assert!(shared, "the helper has decided cells");
}
