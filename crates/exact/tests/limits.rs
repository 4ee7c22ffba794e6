//! A query ends within what it was allowed, says which limit that was, and never calls hidden or seen what it
//! did not decide.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

mod common;

use std::cell::Cell;

use common::permutations;
use glam::{DVec3, Vec3};
use sightline_exact::{
    Cost, Limits, Occluders, Polygon, Reason, Verdict, sightlines, sightlines_until,
};
use sightline_scene::{Object, Scene, Triangle};

/// Two squares with two fences between that close each other's gaps, in one of the ways the axes can be
/// turned.
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

fn reason(found: &(Verdict, Cost)) -> Option<Reason> {
    if let Verdict::Undecided(reason) = &found.0 {
        Some(*reason)
    } else {
        None
    }
}

#[test]
fn every_limit_ends_a_query_with_its_own_reason() {
    for turn in 0..permutations().len() {
        let (scene, [a, b]) = fences(turn);
        let whole = sightlines(&scene, &a, &b, &Limits::default());
        assert!(matches!(whole.0, Verdict::Hidden(_)), "{:?}", whole.0);
        let Cost {
            regions, vectors, ..
        } = whole.1;
        assert!(regions > 10, "{regions} regions tell little");
        // What it takes is enough, and less is not.
        let with = |regions: u64, vectors: u64| {
            let (regions, vectors) = (regions as u32, vectors as u32);
            sightlines(
                &scene,
                &a,
                &b,
                &Limits {
                    regions,
                    vectors,
                    ..Limits::default()
                },
            )
        };
        assert_eq!(with(regions, vectors).1, whole.1);
        for part in [0, 1, regions / 2, regions - 1] {
            let found = with(part, vectors);
            assert_eq!(
                reason(&found),
                Some(Reason::Regions),
                "{part} of {regions} regions"
            );
            assert_eq!(found.1.regions, part + 1);
        }
        for part in [0, vectors / 2, vectors - 1] {
            assert_eq!(
                reason(&with(regions, part)),
                Some(Reason::Memory),
                "{part} of {vectors} vectors"
            );
        }
    }
}

#[test]
fn a_query_that_is_told_to_stop_does_so_before_the_next_region() {
    let (scene, [a, b]) = fences(0);
    let whole = sightlines(&scene, &a, &b, &Limits::default());
    let regions = whole.1.regions;
    for after in [0, 1, 7, regions / 2, regions - 1, regions, regions + 1] {
        let asked = Cell::new(0);
        let stop = || asked.replace(asked.get() + 1) >= after;
        let found = sightlines_until(&scene, (&a, &b), &Limits::default(), &stop);
        if after < regions {
            assert_eq!(
                reason(&found),
                Some(Reason::Stopped),
                "told to stop at {after} of {regions}"
            );
            assert_eq!((found.1.regions, asked.get()), (after + 1, after + 1));
        } else {
            assert_eq!(found.1, whole.1);
            assert!(matches!(found.0, Verdict::Hidden(_)));
        }
    }
}
