//! Tests of queries at run time against free segments, in results with the portals of random buildings.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

mod common;

use common::{building, strictly_seen};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::{EnclosureLimits, Partition, table};
use sightline_pvs::{Builder, CellTree, Header, Looker, Node, Object, Pvs, View};
use sightline_scene::Scene;

/// Creates a result of one cell that shows every triangle.
fn result(scene: &Scene) -> Pvs {
    let bounds = scene.bounds();
    let partition =
        Partition::new(scene, None, bounds, EnclosureLimits::default(), &|| false).unwrap();
    let tree = CellTree::new(bounds.corners().map(|c| c.to_array()), vec![Node::Leaf]).unwrap();
    let objects = vec![Object {
        name: "all".into(),
        first: 0,
        count: scene.len(),
        source: None,
    }];
    let header = Header {
        triangles: scene.len(),
        method: "portals".into(),
        tree,
        objects,
        info_json: "{}".into(),
    };
    let mut builder = Builder::new(header).unwrap();
    builder.set_portals(table(&partition).encode()).unwrap();
    builder
        .push_cell(&(0..scene.len()).collect::<Vec<_>>(), &[], 0)
        .unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    Pvs::from_bytes(file).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn looker_returns_all_triangles_in_view(
        seed in any::<u64>(),
        angle in prop_oneof![Just(0.0f32), -1.5f32..1.5],
    ) {
        let scene = building(seed, angle);
        let pvs = result(&scene);
        let mut looker = Looker::new(&pvs).unwrap().unwrap();
        let mut random = SplitMix64::new(seed ^ 2);
        let bounds = scene.bounds();
        let mut point = |bounds: Aabb| {
            let mut unit = || random.unit_f32();
            bounds.min + (bounds.max - bounds.min) * Vec3::new(unit(), unit(), unit())
        };
        let mut shares = Vec::new();
        for k in 0..40 {
            let (mut eye, at) = (point(bounds), point(bounds));
            if k % 4 == 0 {
                // The viewpoint is on a wall, or nearly.
                let t = scene.triangles()[(k * 7) % scene.triangles().len()].v;
                eye = ((t[0] + t[1] + t[2]) / 3.0).clamp(bounds.min, bounds.max);
            }
            let (ahead, up) = ((at - eye).normalize(), Vec3::new(0.1, 0.9, 0.2));
            let view = View {
                eye: eye.to_array().map(f64::from),
                direction: ahead.to_array().map(f64::from),
                up: up.to_array().map(f64::from),
                fov: [90.0, 60.0],
            };
            prop_assert_eq!(looker.look(&view).unwrap(), Some(0));
            shares.push(looker.visible().len());
            let ahead = DVec3::from(view.direction).normalize();
            let right = ahead.cross(DVec3::from(view.up)).normalize();
            let up = right.cross(ahead);
            for _ in 0..200 {
                let to = point(bounds);
                let d = (to - eye).as_dvec3();
                let (x, y, z) = (right.dot(d), up.dot(d), ahead.dot(d));
                // The segment is well within the view.
                if z > 0.0 && x.abs() < 0.999 * z && y.abs() < 0.577 * z {
                    for part in [1.0f32, 0.5, 0.25, 0.125] {
                        if let Some(id) = strictly_seen(&scene, eye, eye + (to - eye) * part) {
                            let is_there = looker.visible().binary_search(&id).is_ok();
                            prop_assert!(is_there, "{id} from {eye} to {to}");
                        }
                    }
                }
            }
        }
        shares.sort_unstable();
        prop_assert!(shares[shares.len() / 2] < scene.len() as usize, "walls hide something");
    }
}
