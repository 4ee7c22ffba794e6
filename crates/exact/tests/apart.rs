//! Tests of boxes hidden from a cell: rays do not refute the answer, the checker accepts the proofs and
//! rejects altered proofs, and no query runs for boxes that share a part of a face.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use common::Corners;
use common::cells::exact_scene;
use glam::Vec3;
use proptest::prelude::*;
use sightline_certificate::checker::{CellClaims, Triangles, check_box_claim};
use sightline_certificate::{CellCertificate, HiddenBox};
use sightline_exact::{Cell, FromCellAnswer, QueryCost, QueryLimits, box_from_cell};
use sightline_numbers::random::SplitMix64;
use sightline_scene::Aabb;

fn ask(triangles: &[Corners], cell: Aabb, target: Aabb) -> Option<FromCellAnswer> {
    let scene = exact_scene(triangles);
    let cell = Cell::new(cell.min, cell.max).unwrap();
    let limits = QueryLimits::default();
    box_from_cell(
        scene.occluders(),
        cell,
        target,
        &limits,
        &|| false,
        &mut QueryCost::default(),
    )
}

fn check(triangles: &[Corners], cell: Aabb, apart: HiddenBox) -> Result<(), String> {
    let certificate = CellCertificate {
        apart: vec![apart],
        ..CellCertificate::default()
    };
    let claims = CellClaims {
        cell,
        visible: &[],
        undecided: &[],
        certificate: &certificate,
        above: None,
    };
    check_box_claim(&Triangles::new(triangles), &claims, 0).map_err(|e| e.to_string())
}

/// Creates a wall at a height over the square from `from` to `to`.
fn wall(z: f32, from: f32, to: f32) -> [Corners; 2] {
    let [a, b, c, d] =
        [[from, from], [to, from], [to, to], [from, to]].map(|[x, y]| Vec3::new(x, y, z));
    [[a, b, c], [a, c, d]]
}

fn unit(x: f32, y: f32, z: f32) -> Aabb {
    Aabb {
        min: Vec3::new(x, y, z),
        max: Vec3::new(x + 1.0, y + 1.0, z + 1.0),
    }
}

#[test]
fn wall_hides_box_behind_it_and_gap_shows_it() {
    let closed = wall(2.0, -20.0, 20.0);
    let (cell, target) = (unit(0.0, 0.0, 0.0), unit(0.5, 0.0, 3.0));
    let Some(FromCellAnswer::Hidden(proofs)) = ask(&closed, cell, target) else {
        panic!("the wall hides the box")
    };
    let apart = HiddenBox {
        bounds: target,
        proofs,
    };
    assert_eq!(check(&closed, cell, apart.clone()), Ok(()));
    // These are a larger box, a box on this side, missing proofs, additional proofs, and another wall.
    let larger = HiddenBox {
        bounds: Aabb {
            min: target.min - 1.5,
            max: target.max,
        },
        ..apart.clone()
    };
    assert!(check(&closed, cell, larger).is_err());
    let beside = HiddenBox {
        bounds: unit(2.0, 0.0, 0.0),
        ..apart.clone()
    };
    assert!(check(&closed, cell, beside).is_err());
    let mut few = apart.clone();
    few.proofs.pop();
    assert!(check(&closed, cell, few).unwrap_err().contains("missing"));
    let mut many = apart.clone();
    many.proofs.push(many.proofs[0].clone());
    assert!(
        check(&closed, cell, many)
            .unwrap_err()
            .contains("more proofs")
    );
    assert!(check(&wall(2.0, -20.0, 0.9), cell, apart).is_err());
    // This wall ends next to the box.
    assert!(matches!(
        ask(&wall(2.0, -20.0, 0.9), cell, target),
        Some(FromCellAnswer::Visible(_))
    ));
}

#[test]
fn boxes_with_common_face_are_not_queried() {
    let none: Vec<Corners> = wall(9.0, 0.0, 1.0).into();
    let cell = unit(0.0, 0.0, 0.0);
    for target in [
        unit(1.0, 0.0, 0.0),
        unit(1.0, 0.5, 0.5),
        unit(0.5, 0.0, 0.0),
        unit(0.0, 0.0, -1.0),
    ] {
        assert!(ask(&none, cell, target).is_none(), "{target:?}");
        let empty = HiddenBox {
            bounds: target,
            proofs: Vec::new(),
        };
        assert!(
            check(&none, cell, empty)
                .unwrap_err()
                .contains("part of a face"),
            "{target:?}"
        );
    }
    // Boxes that share an edge or a corner are queried, and are visible past it.
    for target in [
        unit(1.0, 1.0, 0.0),
        unit(1.0, -1.0, 0.5),
        unit(1.0, 1.0, 1.0),
    ] {
        assert!(
            matches!(ask(&none, cell, target), Some(FromCellAnswer::Visible(_))),
            "{target:?}"
        );
    }
}

#[test]
fn wall_through_common_edge_hides_box() {
    // The wall is in the plane x + y = 2.
    let v = Vec3::new;
    let [a, b, c, d] = [
        v(-9.0, 11.0, -9.0),
        v(11.0, -9.0, -9.0),
        v(11.0, -9.0, 9.0),
        v(-9.0, 11.0, 9.0),
    ];
    let triangles: Vec<Corners> = vec![[a, b, c], [a, c, d]];
    let (cell, target) = (unit(0.0, 0.0, 0.0), unit(1.0, 1.0, 0.0));
    let Some(FromCellAnswer::Hidden(proofs)) = ask(&triangles, cell, target) else {
        panic!("a wall is between")
    };
    assert_eq!(
        check(
            &triangles,
            cell,
            HiddenBox {
                bounds: target,
                proofs
            }
        ),
        Ok(())
    );
}

/// Returns true if a segment meets a triangle, in doubles. Segments near edges may go either way.
fn blocked(triangles: &[Corners], a: Vec3, b: Vec3) -> bool {
    triangles.iter().any(|t| {
        let [p, q, r] = t.map(|v| v.as_dvec3());
        let (o, d) = (a.as_dvec3(), (b - a).as_dvec3());
        let n = (q - p).cross(r - p);
        let along = d.dot(n);
        let s = (p - o).dot(n) / along;
        let x = o + d * s;
        let inside = |a: glam::DVec3, b: glam::DVec3| (b - a).cross(x - a).dot(n) >= -1e-9;
        along != 0.0 && (0.0..=1.0).contains(&s) && inside(p, q) && inside(q, r) && inside(r, p)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn rays_do_not_refute_answer(seed in any::<u64>(), walls in 1usize..6) {
        let mut random = SplitMix64::new(seed);
        let mut unit_f = |least: f32, most: f32| least + (most - least) * random.unit_f32();
        let triangles: Vec<Corners> = (0..walls)
            .flat_map(|_| {
                let from = unit_f(-6.0, 0.5);
                let to = unit_f(0.5, 8.0);
                wall(unit_f(1.2, 3.8), from, to)
            })
            .collect();
        let cell = unit(0.0, 0.0, 0.0);
        let target = unit(unit_f(-2.0, 2.0), unit_f(-2.0, 2.0), 4.0);
        let point = |b: &Aabb, f: &mut dyn FnMut(f32, f32) -> f32| {
            Vec3::from([0, 1, 2].map(|a| f(b.min[a], b.max[a])))
        };
        let free = (0..3000).any(|_| {
            let (a, b) = (point(&cell, &mut unit_f), point(&target, &mut unit_f));
            !blocked(&triangles, a, b)
        });
        match ask(&triangles, cell, target) {
            Some(FromCellAnswer::Hidden(proofs)) => {
                prop_assert!(!free);
                prop_assert_eq!(
                    check(&triangles, cell, HiddenBox { bounds: target, proofs }),
                    Ok(())
                );
            }
            Some(FromCellAnswer::Visible(_)) => {}
            other => prop_assert!(false, "{other:?}"),
        }
    }
}
