//! Tests of the limits of a query: the query ends within its limits, reports the limit that ended it, and
//! never reports hidden or visible without a decision.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use std::cell::Cell;

use common::permutations;
use glam::{DVec3, Vec3};
use sightline_exact::{
    Occluders, Polygon, QueryCost, QueryLimits, UndecidedReason, Verdict, sightlines,
    sightlines_until,
};
use sightline_scene::{Object, Scene, Triangle};

/// Creates two squares, and between them two fences that close each other's gaps.
///
/// `turn` selects one of the permutations of the axes.
fn fences(turn: usize) -> (Occluders, [Vec<Polygon>; 2]) {
    let turn = permutations()[turn];
    let place = |p: [f64; 3]| (turn * DVec3::from(p)).as_vec3();
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    for (z, middle, width) in [(4.0, 0.0, 0.5), (4.125, 0.5, 0.75)] {
        for k in -9..=9 {
            let x = f64::from(k) + middle;
            let [lo, hi] = [x - width / 2.0, x + width / 2.0];
            let [a, b, c, d] =
                [[lo, -16.0, z], [hi, -16.0, z], [hi, 16.0, z], [lo, 16.0, z]].map(place);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let objects = vec![Object {
        name: "fences".into(),
        first: 0,
        count: triangles.len() as u32,
    }];
    let all = triangles.into_iter().map(|v| Triangle { v }).collect();
    let scene = Occluders::new(&Scene::new("fences", all, objects).unwrap()).unwrap();
    let square = |z: f64| {
        let corners = [
            [-4.0, -4.0, z],
            [4.0, -4.0, z],
            [4.0, 4.0, z],
            [-4.0, 4.0, z],
        ];
        Polygon::checked(&corners.map(|p| place(p).as_dvec3())).unwrap()
    };
    (scene, [square(0.0), square(8.0)])
}

fn reason(found: &(Verdict, QueryCost)) -> Option<UndecidedReason> {
    if let Verdict::Undecided(reason) = &found.0 {
        Some(*reason)
    } else {
        None
    }
}

#[test]
fn each_limit_ends_query_with_matching_reason() {
    for turn in 0..permutations().len() {
        let (scene, [a, b]) = fences(turn);
        let whole = sightlines(&scene, &a, &b, &QueryLimits::default());
        assert!(matches!(whole.0, Verdict::Hidden(_)), "{:?}", whole.0);
        let QueryCost {
            regions, vectors, ..
        } = whole.1;
        assert!(regions > 10, "{regions} regions tell little");
        // The measured cost is sufficient as a limit, and a lower limit is not.
        let with = |regions: u64, vectors: u64| {
            let (regions, vectors) = (regions as u32, vectors as u32);
            sightlines(
                &scene,
                &a,
                &b,
                &QueryLimits {
                    regions,
                    vectors,
                    ..QueryLimits::default()
                },
            )
        };
        assert_eq!(with(regions, vectors).1, whole.1);
        for part in [0, 1, regions / 2, regions - 1] {
            let found = with(part, vectors);
            assert_eq!(
                reason(&found),
                Some(UndecidedReason::Regions),
                "{part} of {regions} regions"
            );
            assert_eq!(found.1.regions, part + 1);
        }
        for part in [0, vectors / 2, vectors - 1] {
            assert_eq!(
                reason(&with(regions, part)),
                Some(UndecidedReason::Memory),
                "{part} of {vectors} vectors"
            );
        }
    }
}

#[test]
fn stopped_query_ends_before_next_region() {
    let (scene, [a, b]) = fences(0);
    let whole = sightlines(&scene, &a, &b, &QueryLimits::default());
    let regions = whole.1.regions;
    for after in [0, 1, 7, regions / 2, regions - 1, regions, regions + 1] {
        let asked = Cell::new(0);
        let stop = || asked.replace(asked.get() + 1) >= after;
        let found = sightlines_until(&scene, &a, &b, &QueryLimits::default(), &stop);
        if after < regions {
            assert_eq!(
                reason(&found),
                Some(UndecidedReason::Stopped),
                "told to stop at {after} of {regions}"
            );
            assert_eq!((found.1.regions, asked.get()), (after + 1, after + 1));
        } else {
            assert_eq!(found.1, whole.1);
            assert!(matches!(found.0, Verdict::Hidden(_)));
        }
    }
}
