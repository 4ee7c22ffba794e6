//! Tests of the assignment of helpers to crews, with two tiles and more workers.

use sightline_records::ids::{Lease, WorkerId};

use super::event::Event;
use super::messages::WorkerCommand;
use super::tests::{Bench, two_tiles};

/// Returns the leases that a worker was sent to help, in the order of the commands.
fn helps(b: &Bench, worker: WorkerId) -> Vec<Lease> {
    let told = b.told.get(&worker).into_iter().flatten();
    told.filter_map(|o| {
        if let WorkerCommand::Help(help) = o {
            Some(help.lease)
        } else {
            None
        }
    })
    .collect()
}

/// Creates two leaders with one tile each. Returns their leases, too.
fn two_leaders() -> (Bench, [WorkerId; 2], [Lease; 2]) {
    let mut b = two_tiles();
    let leaders = ["a", "b"].map(|name| b.join(name));
    leaders.iter().for_each(|w| b.want(*w, 1));
    let leases = leaders.map(|w| b.grants(w)[0]);
    (b, leaders, leases)
}

#[test]
fn idle_workers_are_spread_over_crews() {
    let (mut b, _, [one, two]) = two_leaders();
    let early = b.join("early");
    b.want(early, 2);
    assert_eq!(helps(&b, early), []);
    b.step(Event::CrewOpened(one));
    assert_eq!(helps(&b, early), [one]);
    b.step(Event::CrewOpened(two));
    let late = b.join("late");
    assert_eq!(helps(&b, late), [], "it wants nothing yet");
    b.want(late, 2);
    assert_eq!(helps(&b, late), [two]);
    // A returning helper is sent to the next crew.
    b.step(Event::CrewClosed(one));
    b.step(Event::Helped(early, one));
    assert_eq!(helps(&b, early), [one, two]);
    b.step(Event::Helped(early, one));
    assert_eq!(
        helps(&b, early).len(),
        2,
        "an answer to an earlier command has no effect"
    );
}

#[test]
fn crew_has_at_most_31_helpers() {
    let (mut b, _, [one, two]) = two_leaders();
    b.step(Event::CrewOpened(one));
    let helpers: Vec<WorkerId> = (0..32).map(|i| b.join(&format!("helper {i}"))).collect();
    helpers.iter().for_each(|w| b.want(*w, 2));
    let with = |b: &Bench, lease| {
        helpers
            .iter()
            .filter(|w| helps(b, **w).last() == Some(&lease))
            .count()
    };
    assert_eq!((with(&b, one), with(&b, two)), (31, 0));
    // The remaining worker helps, and others move until both crews have the same number of helpers.
    b.step(Event::CrewOpened(two));
    assert_eq!((with(&b, one), with(&b, two)), (16, 16));
}

#[test]
fn helper_is_called_back_before_it_gets_tile() {
    let (mut b, [leader, other], [one, two]) = two_leaders();
    b.step(Event::CrewOpened(one));
    let helper = b.join("helper");
    b.want(helper, 2);
    assert_eq!(helps(&b, helper), [one]);
    // Another worker gives a tile back.
    b.step(Event::Drains(other));
    b.fail(other, two, true);
    b.wait(3);
    let tail: Vec<&WorkerCommand> = b.told[&helper].iter().rev().take(2).collect();
    assert!(
        matches!(tail[0], WorkerCommand::Grant(grant) if grant.lease.tile == two.tile),
        "{tail:?}"
    );
    assert_eq!(tail[1], &WorkerCommand::Revoke(one));
    b.step(Event::Helped(helper, one));
    assert_eq!(helps(&b, helper), [one], "it has a tile of its own");
    b.leave(leader);
}

#[test]
fn lost_helpers_and_leaders_are_removed() {
    let (mut b, [leader, _], [one, _]) = two_leaders();
    let stray = Lease {
        tile: sightline_records::ids::TileIndex(1),
        ..one
    };
    b.step(Event::CrewOpened(stray));
    b.step(Event::CrewOpened(one));
    b.step(Event::CrewOpened(one));
    let (first, second) = (b.join("first"), b.join("second"));
    b.want(first, 2);
    b.leave(first);
    b.want(second, 2);
    assert_eq!(helps(&b, second), [one]);
    b.leave(leader);
    b.wait(5);
    // The helper got the leader's tile.
    assert_eq!(b.grants(second).len(), 1);
    b.step(Event::HelpUndelivered(second, one));
    b.wait(2);
}
