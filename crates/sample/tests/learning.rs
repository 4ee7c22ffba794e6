//! Tests that a leader that receives earlier outcomes during a phase uses each outcome for its own phase.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

use sightline_sample::crew::{Crew as _, ForeignFinds, Leader, Phase};
use sightline_sample::{TileError, Unwatched};

/// A phase of one item, whose outcome is the phase's number.
struct Numbered<'a> {
    number: u8,
    has: AtomicBool,
    /// A function that is called when the phase is prepared.
    prepared: &'a (dyn Fn() + Sync),
    /// The added outcomes: the number of the phase, and the number in the outcome.
    added: &'a Mutex<Vec<[u8; 2]>>,
}

impl Phase for Numbered<'_> {
    fn items(&self) -> usize {
        1
    }
    fn prepare(&self) {
        (self.prepared)();
    }
    fn costs(&self) -> Vec<u64> {
        vec![1]
    }
    fn compute(&self, _: usize, _: &(dyn Fn() -> bool + Sync)) -> Result<(), TileError> {
        self.has.store(true, Relaxed);
        Ok(())
    }
    fn has(&self, _: usize) -> bool {
        self.has.load(Relaxed)
    }
    fn take(&self, _: &[usize]) -> Vec<u8> {
        self.outcome()
    }
    fn add(&self, finds: &[u8]) -> Result<u64, ForeignFinds> {
        self.added.lock().unwrap().push([self.number, finds[0]]);
        self.has.store(true, Relaxed);
        Ok(0)
    }
    fn outcome(&self) -> Vec<u8> {
        vec![self.number]
    }
}

#[test]
fn outcomes_received_during_preparation_belong_to_next_phases() {
    let leader = Leader::new(Vec::new(), Arc::new(Unwatched), |_| {});
    let added = Mutex::new(Vec::new());
    let learn = || {
        leader.learn(
            leader.phase(),
            (leader.phase().0..5).map(|n| vec![n as u8]).collect(),
        )
    };
    for number in 0..5 {
        let nothing = || {};
        let prepared: &(dyn Fn() + Sync) = if number == 1 { &learn } else { &nothing };
        let phase = Numbered {
            number,
            has: AtomicBool::new(false),
            prepared,
            added: &added,
        };
        leader.run(&phase).unwrap();
        assert!(phase.has(0));
    }
    // Phases 0 and 1 were computed.
    assert_eq!(added.into_inner().unwrap(), [[2, 2], [3, 3], [4, 4]]);
}
