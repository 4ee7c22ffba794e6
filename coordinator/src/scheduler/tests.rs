//! Who gets which tile: two workers, two tiles, a memory store.

use glam::Vec3;
use prost::Message as _;
use sightline_model::{BackendChoice, CellToCell, SamplingParams};
use sightline_model::{JobSpec, Method};
use sightline_scene::Aabb;
use sightline_viewcells::Division;
use tokio::sync::mpsc;

use super::*;
use crate::clock::{Clock as _, SystemClock};
use crate::store::{MemoryStore, NewJob, SceneRecord};

impl Outbox for mpsc::Sender<Order> {
    fn offer(&self, order: Order) -> bool {
        self.try_send(order).is_ok()
    }
}

/// A scheduler with a job of two tiles, and its store.
fn two_tiles() -> (Scheduler, MemoryStore) {
    let spec = JobSpec {
        scene: [7; 32],
        division: Division::Grid([2, 1, 1]),
        view_box: Aabb::new(Vec3::ZERO, Vec3::ONE),
        sampling: SamplingParams { cell_to_cell: CellToCell::Off, ..SamplingParams::default() },
        backend: BackendChoice::Cpu,
        seed: 1,
        time_budget_ms: 0,
        block_cells: 1,
        method: Method::Aggressive,
        certificates: false,
        viewpoints: None,
        up: None,
    };
    let store = MemoryStore::new();
    store.record_scene(SceneRecord { digest: spec.scene, bytes: 1, triangles: 1, objects: 1 }).unwrap();
    let job = NewJob {
        key: spec.key(),
        request_id: "one".to_owned(),
        name: "two tiles".to_owned(),
        scene: spec.scene,
        spec: spec.to_proto().encode_to_vec(),
        tiles: 2,
        submitted_at_ms: 0,
    };
    let id = store.submit_job(job).unwrap().id;
    let mut scheduler = Scheduler::new(Epoch(1));
    scheduler.take_up(store.job(id).unwrap().unwrap(), &spec.to_proto(), store.tiles(id).unwrap()).unwrap();
    (scheduler, store)
}

type Told = mpsc::Receiver<Order>;

fn introduction(name: &str, instance: u64) -> Introduction {
    let profiles = vec!["cpu/test".to_owned()];
    Introduction { name: name.to_owned(), instance, profiles, held: Vec::new() }
}

/// Lets a worker join; gives its number and the orders to it.
fn join(scheduler: &mut Scheduler, name: &str) -> (WorkerId, Told) {
    let (out, told) = mpsc::channel(8);
    let joined = scheduler.join(introduction(name, 0), Box::new(out), Instant::now()).unwrap();
    (joined.worker, told)
}

/// The worker that has each tile.
fn holders(scheduler: &Scheduler) -> Vec<Option<WorkerId>> {
    let slots = scheduler.jobs.values().flat_map(|j| &j.slots);
    slots.map(|s| s.lease.as_ref().map(|l| l.worker)).collect()
}

#[test]
fn no_worker_gets_a_second_tile_while_another_has_none() {
    let (mut scheduler, store) = two_tiles();
    let ((a, _told_a), (b, _told_b)) = (join(&mut scheduler, "a"), join(&mut scheduler, "b"));
    scheduler.want(a, 2);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    assert_eq!(holders(&scheduler), [Some(a), None]);
    scheduler.want(b, 2);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    assert_eq!(holders(&scheduler), [Some(a), Some(b)]);
}

#[test]
fn a_worker_that_joins_late_takes_over_a_queued_tile_of_a_busy_worker() {
    let (mut scheduler, store) = two_tiles();
    let (a, mut told_a) = join(&mut scheduler, "a");
    scheduler.want(a, 2);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    assert_eq!(holders(&scheduler), [Some(a), Some(a)]);
    let (b, mut told_b) = join(&mut scheduler, "b");
    scheduler.want(b, 2);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    assert_eq!(holders(&scheduler), [Some(a), Some(b)]);
    let mut leases = Vec::new();
    for _ in 0..2 {
        let Ok(Order::Grant(grant)) = told_a.try_recv() else { panic!("no grant") };
        leases.push(grant.lease);
    }
    assert_eq!(told_a.try_recv(), Ok(Order::Revoke(leases[1])));
    let Ok(Order::Grant(grant)) = told_b.try_recv() else { panic!("no grant") };
    assert_eq!(grant.lease.tile, leases[1].tile);
    // A tile that has begun stays with its worker, and so does a worker's only tile.
    let (c, _told_c) = join(&mut scheduler, "c");
    scheduler.want(c, 2);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    assert_eq!(holders(&scheduler), [Some(a), Some(b)]);
}

#[test]
fn a_second_worker_of_one_name_is_refused_and_the_same_worker_may_reconnect() {
    let (mut scheduler, store) = two_tiles();
    let now = Instant::now();
    let mut join = |name: &str, instance: u64, held: Vec<Lease>| {
        let (out, told) = mpsc::channel(8);
        let intro = Introduction { held, ..introduction(name, instance) };
        (scheduler.join(intro, Box::new(out), now), told)
    };
    let (first, mut told) = join("a", 1, Vec::new());
    let first = first.unwrap().worker;
    let refused = join("a", 2, Vec::new()).0.unwrap_err();
    assert!(refused.to_string().contains("give this one another --name"), "{refused}");
    join("b", 2, Vec::new()).0.unwrap();
    // Workers that send no instance cannot be told from reconnecting ones.
    join("a", 0, Vec::new()).0.unwrap();
    scheduler.want(first, 1);
    scheduler.grant_tiles(&store, SystemClock.now()).unwrap();
    let Ok(Order::Grant(grant)) = told.try_recv() else { panic!("no grant") };
    // Before the coordinator has noticed that the earlier stream is broken.
    let (out, _told) = mpsc::channel(8);
    let intro = Introduction { held: vec![grant.lease], ..introduction("a", 1) };
    let again = scheduler.join(intro, Box::new(out), now).unwrap();
    assert_eq!(again.kept, [grant.lease]);
    scheduler.leave(first, now);
    assert_eq!(holders(&scheduler), [Some(again.worker), None]);
    assert!(scheduler.workers.contains_key(&again.worker));
    // The name is free when its worker has gone.
    scheduler.leave(again.worker, now);
    let (out, _told) = mpsc::channel(8);
    scheduler.join(introduction("a", 3), Box::new(out), now).unwrap();
}

#[test]
fn a_departure_says_whether_the_worker_had_drained() {
    let (mut scheduler, _) = two_tiles();
    let ((a, _told_a), (b, _told_b)) = (join(&mut scheduler, "a"), join(&mut scheduler, "b"));
    assert!(scheduler.drain(a));
    assert!(!scheduler.drain(a), "it is news only once");
    assert_eq!(scheduler.leave(a, Instant::now()), Departure::Drained);
    assert_eq!(scheduler.leave(b, Instant::now()), Departure::Lost);
}
