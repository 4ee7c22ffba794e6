//! Tests of the order of service: priorities, and fair shares between users.

use std::cmp::Reverse;

use sightline_records::ids::{JobId, Lease, WorkerId};
use sightline_records::{JobPhase, JobState, TileStats};
use sightline_store::Store as _;

use super::event::Event;
use super::messages::{Progress, WorkerCommand};
use super::queue::{Queue, QueueKey, Share, User};
use super::tests::{Bench, empty};

fn queue_key(user: &str, priority: i32) -> QueueKey {
    QueueKey {
        user: user.into(),
        priority: Reverse(priority),
    }
}

#[test]
fn queue_serves_priorities_then_users_then_ages() {
    let [few, many] = [1, 5].map(|workers| Share { workers, used: 0 });
    let mut queue = Queue::default();
    queue.insert(&queue_key("greedy", 0), many, 1);
    queue.insert(&queue_key("modest", 0), few, 4);
    queue.insert(&queue_key("modest", 0), few, 3);
    queue.insert(&queue_key("greedy", 7), many, 9);
    let serve = |queue: &mut Queue<u32>, share: &dyn Fn(&User) -> Share| {
        let (turn, thing) = queue.first().map(|(turn, thing)| (turn.clone(), *thing))?;
        queue.remove(
            &QueueKey {
                user: User::clone(&turn.2),
                priority: turn.0,
            },
            share(&turn.2),
            &thing,
        );
        Some(thing)
    };
    let share = |user: &User| if &**user == "greedy" { many } else { few };
    assert!(queue.is_in_order(share));
    let order: Vec<u32> = std::iter::from_fn(|| serve(&mut queue, &share)).collect();
    assert_eq!(order, [9, 3, 4, 1]);
    assert!(queue.is_empty() && queue.is_in_order(share));
}

/// Lets a worker without a tile get one tile at a time. Returns the jobs of the tiles.
fn served(b: &mut Bench, worker: WorkerId, tiles: usize, millis: u64) -> Vec<u64> {
    let mut jobs = Vec::new();
    for _ in 0..tiles {
        b.want(worker, 1);
        let lease = *b.grants(worker).last().unwrap();
        b.step(Event::Progressed(Progress {
            lease,
            cells: 0,
            samples: 1,
        }));
        b.ms += millis;
        b.step(Event::Committed {
            lease,
            digest: [1; 32],
            stats: TileStats::default(),
        });
        jobs.push(lease.job.0);
    }
    jobs
}

#[test]
fn worker_serves_users_in_turn_and_higher_priority_at_once() {
    let mut b = empty(1);
    b.add(9, "a", 0, false);
    b.add(9, "a", 0, false);
    let worker = b.join("w");
    assert_eq!(served(&mut b, worker, 2, 10), [1, 1]);
    // A later user is not compensated for the earlier time of the first user.
    b.add(9, "b", 0, false);
    assert_eq!(served(&mut b, worker, 5, 10), [1, 3, 1, 3, 1]);
    let urgent = b.add(1, "a", 1, false);
    // A tile is granted while the store binds the new job to a profile.
    assert_eq!(served(&mut b, worker, 3, 10), [3, urgent.0, 3]);
    // Job 1 has three tiles left; its priority is raised now.
    let record = b.store.prioritize_job(JobId(1), 5).unwrap();
    b.step(Event::JobChanged(Box::new(record)));
    assert_eq!(served(&mut b, worker, 4, 10)[..4], [1, 1, 1, 1]);
}

#[test]
fn paused_job_saves_up_no_share() {
    let mut b = empty(1);
    let paused = b.add(9, "a", 0, false);
    b.add(20, "b", 0, false);
    let worker = b.join("w");
    b.set(
        paused,
        &[JobPhase::Queued, JobPhase::Running],
        JobState::Paused,
    );
    assert_eq!(served(&mut b, worker, 4, 1000), [2; 4]);
    b.set(paused, &[JobPhase::Paused], JobState::Running);
    let turns = served(&mut b, worker, 6, 1000);
    assert_eq!(
        turns.iter().filter(|job| **job == 1).count(),
        3,
        "{turns:?}"
    );
    // A user that joins while another one is paused does not inherit that time either.
    b.set(paused, &[JobPhase::Running], JobState::Paused);
    assert_eq!(served(&mut b, worker, 4, 1000), [2; 4]);
    b.add(9, "c", 0, false);
    let turns = served(&mut b, worker, 4, 1000);
    assert_eq!(
        turns.iter().filter(|job| **job == 3).count(),
        2,
        "{turns:?}"
    );
}

#[test]
fn users_share_workers_evenly_for_any_number_of_jobs() {
    let mut b = empty(1);
    for _ in 0..3 {
        b.add(4, "greedy", 0, false);
    }
    b.add(4, "modest", 0, false);
    let mut by_user = [0, 0];
    for w in 0..6 {
        let worker = b.join(&format!("w{w}"));
        b.want(worker, 1);
        by_user[usize::from(b.grants(worker)[0].job.0 == 4)] += 1;
    }
    assert_eq!(by_user, [3, 3]);
}

/// Returns the lease whose holder a worker was last sent to help.
fn helps(b: &Bench, worker: WorkerId) -> Option<Lease> {
    let told = b.told.get(&worker)?.iter();
    told.filter_map(|o| {
        if let WorkerCommand::Help(help) = o {
            Some(help.lease)
        } else {
            None
        }
    })
    .next_back()
}

#[test]
fn helpers_move_to_first_user_and_priority() {
    let mut b = empty(1);
    b.add(1, "a", 0, false);
    let workers: Vec<WorkerId> = (0..6).map(|w| b.join(&format!("w{w}"))).collect();
    b.want(workers[0], 2);
    let first = b.grants(workers[0])[0];
    b.step(Event::CrewOpened(first));
    workers[1..].iter().for_each(|w| b.want(*w, 2));
    let helping = |b: &Bench, lease: Lease| {
        workers
            .iter()
            .filter(|w| helps(b, **w) == Some(lease))
            .count()
    };
    assert_eq!(helping(&b, first), 5);
    // The job of the second user gets a leader from among the helpers, and then half of all workers.
    let second_job = b.add(1, "b", 0, false);
    let leader = *workers
        .iter()
        .find(|w| b.grants(**w).iter().any(|l| l.job == second_job))
        .unwrap();
    b.step(Event::Helped(leader, first));
    let second = *b.grants(leader).last().unwrap();
    b.step(Event::CrewOpened(second));
    assert_eq!(
        (helping(&b, first) - 1, helping(&b, second)),
        (2, 2),
        "the new leader helps nobody"
    );
    // With a higher priority the job gets all helpers.
    let record = b.store.prioritize_job(second_job, 1).unwrap();
    b.step(Event::JobChanged(Box::new(record)));
    assert_eq!((helping(&b, first) - 1, helping(&b, second)), (0, 4));
    // A late message of a moved worker about its earlier leader has no effect.
    let moved = *workers
        .iter()
        .find(|w| helps(&b, **w) == Some(second))
        .unwrap();
    b.step(Event::Helped(moved, first));
    assert_eq!(b.scheduler.roster.workers[&moved].helps, Some(second));
    b.step(Event::CrewClosed(second));
    workers
        .iter()
        .for_each(|w| b.step(Event::Helped(*w, second)));
    assert_eq!(
        helping(&b, first),
        5,
        "all come back, the other leader has not helped since"
    );
}
