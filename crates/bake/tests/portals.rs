//! The method portals: its sets hold those of exact queries, and the bytes depend on nothing but the scene.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use sightline_bake::{Alone, BakeScene, Control, Watcher, run_portal_tile, run_tile};
use sightline_model::{BackendChoice, CellSet, JobSpec, Method, TileOutput, codec};
use sightline_sampling::{BackendError, CubeSpec, embree::CpuBackend};
use sightline_scene::Scene;
use sightline_scene::generate::{Kind, Params, generate};
use sightline_viewcells::Division;

struct Quiet;

impl Watcher for Quiet {
    fn rendered(&self, _: u64) {}
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

fn rooms() -> Arc<Scene> {
    Arc::new(generate(Kind::Rooms, &Params { triangles: Some(700), ..Params::default() }).unwrap())
}

fn spec(scene: &Scene) -> JobSpec {
    let mut spec = JobSpec::new(scene.digest().0, Division::Grid([3, 2, 2]), scene.bounds());
    (spec.method, spec.backend) = (Method::Portals, BackendChoice::None);
    spec.check().unwrap();
    spec
}

fn cells(bytes: &[u8], scene: &Scene) -> Vec<CellSet> {
    match codec::decode(bytes, scene.len()).unwrap() {
        TileOutput::Cells(sets) => sets.cells,
        TileOutput::Pack(_) => panic!("a leaf tile has cells"),
    }
}

fn by_portals(scene: &Arc<Scene>, deadline: Option<Instant>) -> Vec<u8> {
    let prepared = BakeScene::new(Arc::clone(scene)).unwrap();
    let control = Control { watcher: &Quiet, deadline, crew: &Alone };
    run_portal_tile(&spec(scene), 0, &prepared, control).unwrap().bytes
}

#[test]
fn sets_hold_what_is_seen_and_say_what_has_no_witness() {
    let scene = rooms();
    let found = by_portals(&scene, None);
    assert_eq!(found, by_portals(&scene, None));
    let exact = JobSpec { method: Method::Exact, backend: BackendChoice::Cpu, ..spec(&scene) };
    let backend = match CpuBackend::new(Arc::clone(&scene), CubeSpec::of(&exact.sampling)) {
        Ok(backend) => backend,
        Err(BackendError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            eprintln!("not run: {why}");
            return;
        }
        Err(e) => panic!("{e}"),
    };
    // With certificates, exact queries take nothing from portals.
    let proved = JobSpec { certificates: true, ..exact.clone() };
    let control = || Control { watcher: &Quiet, deadline: None, crew: &Alone };
    let bake = |spec: &JobSpec| {
        let prepared = BakeScene::new(Arc::clone(&scene)).unwrap();
        cells(&run_tile(spec, 0, &prepared, &backend, &[], control()).unwrap().bytes, &scene)
    };
    let (exact, proved) = (bake(&exact), bake(&proved));
    let is_part = |a: &[u32], b: &[u32]| a.iter().all(|t| b.binary_search(t).is_ok());
    let mut sums = [0; 3];
    for ((found, exact), proved) in cells(&found, &scene).iter().zip(&exact).zip(&proved) {
        assert_eq!(exact.visible, proved.visible, "portals change no set of exact queries");
        assert!(is_part(&exact.visible, &found.visible));
        let undecided = &found.decision.as_ref().unwrap().undecided;
        assert!(is_part(undecided, &found.visible));
        let witnessed: Vec<u32> =
            found.visible.iter().copied().filter(|t| undecided.binary_search(t).is_err()).collect();
        assert!(is_part(&witnessed, &exact.visible));
        for (sum, n) in sums.iter_mut().zip([witnessed.len(), exact.visible.len(), found.visible.len()]) {
            *sum += n;
        }
    }
    let [witnessed, seen, drawn] = sums;
    assert!(2 * witnessed > seen && drawn < 2 * seen, "{witnessed} witnessed, {seen} seen, {drawn} drawn");
    assert!(drawn < 12 * scene.len() as usize, "portals hide something");
}

#[test]
fn without_time_everything_may_be_seen() {
    let scene = rooms();
    let past = Instant::now().checked_sub(Duration::from_secs(1)).unwrap();
    for cell in cells(&by_portals(&scene, Some(past)), &scene) {
        let hidden = cell.decision.as_ref().unwrap().counts.iter().sum::<u64>();
        assert!(cell.visible.len() + hidden as usize >= scene.len() as usize / 2);
        assert!(!cell.decision.unwrap().undecided.is_empty());
    }
}

#[test]
fn what_needs_samples_or_proofs_is_refused() {
    let scene = rooms();
    let good = spec(&scene);
    let mut others = vec![
        JobSpec { certificates: true, ..good.clone() },
        JobSpec { backend: BackendChoice::Cpu, ..good.clone() },
        JobSpec { division: Division::Adaptive { budget: 5, max_depth: 6 }, ..good.clone() },
        JobSpec { method: Method::Exact, ..good.clone() },
    ];
    let mut sampled = good.clone();
    sampled.sampling.contributions = true;
    others.push(sampled);
    for other in others {
        assert!(other.check().is_err(), "{other:?}");
    }
    assert_eq!(JobSpec::from_proto(&good.to_proto(), None).unwrap(), good);
}
