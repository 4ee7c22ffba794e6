//! Tests of cells among triangles of all kinds: the certificate holds, rays do not refute the set,
//! see-through triangles do not hide others, and occluder-only triangles do not show others.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use common::Corners;
use common::cells::{set, solve};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_certificate::Target;
use sightline_certificate::checker::{
    CellClaims, CellRefusal, Kinds as Flags, Triangles, check_cell,
};
use sightline_exact::{CellDecisions, ExactScene};
use sightline_scene::kinds::{Kinds, SurfaceKind};
use sightline_scene::{Aabb, Object, Scene, Triangle};

fn exact_scene(triangles: &[Corners], kinds: &[SurfaceKind]) -> ExactScene {
    let objects = vec![Object {
        name: "test".into(),
        first: 0,
        count: triangles.len() as u32,
    }];
    let all = triangles.iter().map(|v| Triangle { v: *v }).collect();
    let kinds = Kinds::from_runs(kinds.iter().map(|k| (1, *k, "test")), Vec::new());
    ExactScene::prepare(
        &Scene::new("test", all, objects)
            .unwrap()
            .with_kinds("test", kinds)
            .unwrap(),
    )
    .unwrap()
}

fn decided(
    triangles: &[Corners],
    kinds: &[SurfaceKind],
    cell: Aabb,
    seen: &[u32],
) -> CellDecisions {
    solve(&exact_scene(triangles, kinds), cell, seen, &|| false)
}

fn check(
    triangles: &[Corners],
    kinds: &[SurfaceKind],
    cell: Aabb,
    d: &CellDecisions,
) -> Result<u64, CellRefusal> {
    let (blocks, shows): (Vec<bool>, Vec<bool>) =
        kinds.iter().map(|k| (k.blocks(), k.shows())).unzip();
    let scene = Triangles::with_kinds(
        triangles,
        Flags {
            blocks: &blocks,
            shows: &shows,
        },
    );
    let visible = set(d);
    let claims = CellClaims {
        cell,
        visible: &visible,
        undecided: &d.undecided,
        certificate: &d.certificate,
        above: None,
    };
    check_cell(&scene, &claims, &|_| true)
}

/// Creates a large square at a distance in front of the cell, as two triangles.
fn wall(z: f32) -> [Corners; 2] {
    let [a, b, c, d] =
        [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]].map(|[x, y]| Vec3::new(x, y, z));
    [[a, b, c], [a, c, d]]
}

const CELL: Aabb = Aabb::new(Vec3::ZERO, Vec3::splat(0.5));

#[test]
fn line_passes_panes_and_ends_at_first_wall() {
    use SurfaceKind::{Moving, OccluderOnly, Opaque, SeeThrough};
    // The walls are at 1, 2 and 3, with two triangles each.
    let triangles = [wall(1.0), wall(2.0), wall(3.0)].concat();
    let cases: [([SurfaceKind; 3], &[u32]); 8] = [
        ([Opaque, Opaque, Opaque], &[0, 1]),
        ([SeeThrough, Opaque, Opaque], &[0, 1, 2, 3]),
        ([SeeThrough, SeeThrough, Opaque], &[0, 1, 2, 3, 4, 5]),
        ([SeeThrough, SeeThrough, SeeThrough], &[0, 1, 2, 3, 4, 5]),
        ([OccluderOnly, Opaque, Opaque], &[]),
        ([SeeThrough, OccluderOnly, Opaque], &[0, 1]),
        ([Moving, Opaque, SeeThrough], &[2, 3]),
        ([Moving, SeeThrough, Opaque], &[2, 3, 4, 5]),
    ];
    for (walls, expected) in cases {
        let kinds: Vec<SurfaceKind> = walls.iter().flat_map(|k| [*k; 2]).collect();
        let d = decided(&triangles, &kinds, CELL, &[]);
        assert_eq!(
            (d.visible.as_slice(), d.undecided.len()),
            (expected, 0),
            "{walls:?}"
        );
        check(&triangles, &kinds, CELL, &d).unwrap();
    }
}

#[test]
fn cell_sees_panes_in_plane_of_wall_and_through_cell() {
    use SurfaceKind::{Opaque, SeeThrough};
    // A pane in the wall's plane is visible with the wall; triangles behind both are hidden.
    let triangles = [wall(1.0), wall(1.0), wall(2.0)].concat();
    let kinds = [Opaque, Opaque, SeeThrough, SeeThrough, Opaque, Opaque];
    let d = decided(&triangles, &kinds, CELL, &[]);
    assert_eq!(d.visible, [0, 1, 2, 3]);
    check(&triangles, &kinds, CELL, &d).unwrap();
    // A pane through the cell meets the cell and does not hide other triangles.
    let triangles = [wall(0.25), wall(2.0)].concat();
    let kinds = [SeeThrough, SeeThrough, Opaque, Opaque];
    let d = decided(&triangles, &kinds, CELL, &[]);
    assert_eq!(d.visible, [0, 1, 2, 3]);
    check(&triangles, &kinds, CELL, &d).unwrap();
}

#[test]
fn checker_rejects_changed_kind() {
    use SurfaceKind::{OccluderOnly, Opaque, SeeThrough};
    let triangles = [wall(1.0), wall(2.0)].concat();
    let opaque = [Opaque; 4];
    let d = decided(&triangles, &opaque, CELL, &[]);
    check(&triangles, &opaque, CELL, &d).unwrap();
    // The proof names a wall that does not block.
    let glass = [SeeThrough, SeeThrough, Opaque, Opaque];
    assert!(matches!(
        check(&triangles, &glass, CELL, &d),
        Err(CellRefusal::Hidden { .. })
    ));
    // The set names a wall that is not shown.
    let proxy = [OccluderOnly, OccluderOnly, Opaque, Opaque];
    assert!(matches!(
        check(&triangles, &proxy, CELL, &d),
        Err(CellRefusal::Account(0, _))
    ));
    // A witness meets a wall that now blocks.
    let d = decided(&triangles, &glass, CELL, &[]);
    assert!(matches!(
        check(&triangles, &opaque, CELL, &d),
        Err(CellRefusal::Witness(2..=3, _))
    ));
    // A see-through triangle belongs to no closed surface, so no surface can hide it.
    let mut forged = decided(&triangles, &opaque, CELL, &[]);
    forged.certificate.hidden.iter_mut().for_each(|g| {
        g.target = Target::Surfaces;
        g.proofs.clear();
    });
    assert!(check(&triangles, &glass, CELL, &forged).is_err());
}

fn grid_point(reach: i8) -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-reach..=reach).prop_map(|p| Vec3::from(p.map(f32::from)))
}

fn kind() -> impl Strategy<Value = SurfaceKind> {
    prop_oneof![
        4 => Just(SurfaceKind::Opaque),
        3 => Just(SurfaceKind::SeeThrough),
        1 => Just(SurfaceKind::OccluderOnly),
        1 => Just(SurfaceKind::Moving)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    #[test]
    fn checker_accepts_any_cell_and_rays_do_not_refute_it(
        triangles in prop::collection::vec((prop::array::uniform3(grid_point(4)), kind()), 1..14),
        corner in grid_point(3),
        size in prop::array::uniform3(1i8..3),
        guess in any::<u16>(),
        seed in any::<u64>(),
    ) {
        let (triangles, kinds): (Vec<Corners>, Vec<SurfaceKind>) = triangles.into_iter().unzip();
        let cell = Aabb::new(corner, corner + Vec3::from(size.map(f32::from)));
        // Sampling shows only triangles that can be in a set.
        let seen: Vec<u32> = (0..triangles.len() as u32)
            .filter(|t| guess >> t & 1 == 1 && kinds[*t as usize].shows())
            .collect();
        let d = decided(&triangles, &kinds, cell, &seen);
        prop_assert!(d.undecided.is_empty(), "{:?}", d.statistics);
        prop_assert!(d.visible.iter().all(|t| kinds[*t as usize].shows()), "{:?}", d.visible);
        if let Err(e) = check(&triangles, &kinds, cell, &d) {
            return Err(TestCaseError::fail(e.to_string()));
        }
        // See-through triangles never hide others, and occluder-only triangles never reveal others.
        let as_kind = |from: SurfaceKind, to: SurfaceKind| -> Vec<SurfaceKind> {
            kinds.iter().map(|k| if *k == from { to } else { *k }).collect()
        };
        let opaque = decided(&triangles, &as_kind(SurfaceKind::SeeThrough, SurfaceKind::Opaque), cell, &[]);
        prop_assert!(opaque.visible.iter().all(|t| d.visible.contains(t)), "opaque {:?}", opaque.visible);
        let passable = as_kind(SurfaceKind::OccluderOnly, SurfaceKind::Moving);
        let without = decided(&triangles, &passable, cell, &[]);
        prop_assert!(d.visible.iter().all(|t| without.visible.contains(t)), "without {:?}", without.visible);
        // Rays from inside the cell, in doubles: if a ray is clear of all edges, the cell sees every showing
        // triangle up to the first blocking triangle.
        let mut state = seed;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        for _ in 0..200 {
            let r = DVec3::new(unit(), unit(), unit());
            let p = cell.min.as_dvec3() + (cell.max - cell.min).as_dvec3() * r;
            let q = DVec3::new(unit(), unit(), unit()) * 8.0 - 4.0;
            let mut hits: Vec<(f64, usize)> = Vec::new();
            let mut clear = true;
            for (id, t) in triangles.iter().enumerate() {
                let [a, b, c] = t.map(|v| v.as_dvec3());
                let n = (b - a).cross(c - a);
                let (from, to) = (n.dot(p - a), n.dot(q - a));
                if n == DVec3::ZERO {
                    continue;
                }
                let along = from / (from - to);
                let x = p + (q - p) * along;
                let least = [(a, b), (b, c), (c, a)].map(|(s, t)| (t - s).cross(x - s).dot(n) / n.length());
                let least = least.into_iter().fold(f64::INFINITY, f64::min);
                clear &= from.abs() > 1e-6 && least.abs() > 1e-6;
                if least > 0.0 && along > 0.0 {
                    hits.push((along, id));
                }
            }
            let end = hits.iter().filter(|h| kinds[h.1].blocks()).fold(f64::INFINITY, |e, h| e.min(h.0));
            for (_, id) in hits.iter().filter(|h| clear && h.0 < end + 1e-9 && kinds[h.1].shows()) {
                prop_assert!(d.visible.contains(&(*id as u32)), "triangle {id} is seen from {p} towards {q}");
            }
        }
    }
}
