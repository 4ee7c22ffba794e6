//! Tests of sets from points in scenes with see-through, occluder-only and moving triangles.
//!
//! The tests limit views by cones and distances, compute shares of boxes, and compare both engines with each
//! other and with rays.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::f64::consts::PI;

mod meshes;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_numbers::random::SplitMix64;
use sightline_scene::{Kinds, Object, Scene, SurfaceKind, Triangle};
use sightline_tetra::file::write;
use sightline_tetra::{Engine, Mode, Quiet, Scratch, Target, Tets, View, VisibleTriangles, build};

use meshes::{few_points, sheets};

type T = [[f32; 3]; 3];

const KINDS: [SurfaceKind; 5] = [
    SurfaceKind::Opaque,
    SurfaceKind::Opaque,
    SurfaceKind::SeeThrough,
    SurfaceKind::OccluderOnly,
    SurfaceKind::Moving,
];

fn tets(triangles: &[(T, SurfaceKind)]) -> Tets {
    let count = triangles.len() as u32;
    let object = Object {
        name: "all".into(),
        first: 0,
        count,
    };
    let kinds = Kinds::from_runs(
        triangles.iter().map(|(_, kind)| (1, *kind, "a test")),
        Vec::new(),
    );
    let all = triangles
        .iter()
        .map(|(t, _)| Triangle {
            v: t.map(Vec3::from_array),
        })
        .collect();
    let scene = Scene::new("test", all, vec![object])
        .unwrap()
        .with_kinds("test", kinds)
        .unwrap();
    let mut file = Vec::new();
    write(&mut file, &build(&scene, &Quiet).unwrap().contents()).unwrap();
    Tets::from_bytes(&file).unwrap()
}

fn look(tets: &Tets, x: [f64; 3], view: &View, engine: Engine) -> VisibleTriangles {
    let view = View {
        engine,
        witnesses: true,
        ..view.clone()
    };
    tets.look(x, &view, Mode::Exact, &mut Scratch::default())
        .unwrap()
        .clone()
}

/// Returns the triangles that a ray shows: the triangles that it passes, and the first that blocks.
///
/// If several blocking triangles are in one plane, all of them are returned. Returns `None` if the ray passes
/// near the border of a triangle, or if planes are near each other.
fn shown(triangles: &[(T, SurfaceKind)], x: DVec3, way: DVec3) -> Option<Vec<u32>> {
    let mut hits: Vec<(f64, u32)> = Vec::new();
    for (id, (t, kind)) in (0..).zip(triangles) {
        let [a, b, c] = t.map(|p| DVec3::from(p.map(f64::from)) - x);
        let normal = (b - a).cross(c - a);
        let height = a.dot(normal);
        if normal.length() == 0.0 || height.abs() < 1e-12 || *kind == SurfaceKind::Moving {
            continue;
        }
        let turns = [a.cross(b), b.cross(c), c.cross(a)].map(|n| n.dot(way) * height.signum());
        if turns.iter().any(|t| t.abs() < 1e-7) {
            return None;
        }
        if turns.iter().all(|t| *t > 0.0) {
            hits.push((height / normal.dot(way), id));
        }
    }
    let blocks = |id: u32| triangles[id as usize].1 != SurfaceKind::SeeThrough;
    let end = hits
        .iter()
        .filter(|h| blocks(h.1))
        .map(|h| h.0)
        .fold(f64::INFINITY, f64::min);
    let ends_there = |h: &(f64, u32)| h.0 <= end * (1.0 + 1e-12);
    // A ray cannot decide if see-through triangles in the plane of the end are shown.
    let near = |h: &(f64, u32)| !blocks(h.1) && (h.0 / end - 1.0).abs() < 1e-9;
    if hits.iter().any(near) {
        return None;
    }
    let shows = |id: u32| triangles[id as usize].1 != SurfaceKind::OccluderOnly;
    Some(
        hits.iter()
            .filter(|h| ends_there(h) && shows(h.1))
            .map(|h| h.1)
            .collect(),
    )
}

fn way(k: u32, n: u32) -> DVec3 {
    // The directions form a spiral over the sphere.
    let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(n);
    let turn = f64::from(k) * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * libm::cos(turn), r * libm::sin(turn), z)
}

fn total(seen: &VisibleTriangles) -> f64 {
    seen.areas.iter().sum::<f64>() + seen.sky + seen.unseen + seen.dropped
}

fn alike(a: &VisibleTriangles, b: &VisibleTriangles) -> Result<(), TestCaseError> {
    prop_assert_eq!(&a.visible, &b.visible);
    for (x, y) in a
        .areas
        .iter()
        .chain([&a.sky, &a.unseen])
        .zip(b.areas.iter().chain([&b.sky, &b.unseen]))
    {
        prop_assert!((x - y).abs() < 1e-9, "{} and {}", x, y);
    }
    Ok(())
}

/// The limits of a view: a round cone and a distance.
#[derive(Clone, Debug)]
struct ViewLimits {
    direction: [f64; 3],
    /// The angle of the cone, in radians.
    angle: f64,
    distance: f64,
}

fn check(
    triangles: &[(T, SurfaceKind)],
    x: [f64; 3],
    limits: &ViewLimits,
    rays: bool,
) -> Result<(), TestCaseError> {
    let ViewLimits {
        direction,
        angle,
        distance,
    } = *limits;
    let tets = tets(triangles);
    let both =
        |view: &View| [Engine::Boxes, Engine::Cells].map(|engine| look(&tets, x, view, engine));
    let [all, by_cells] = both(&View::default());
    alike(&all, &by_cells)?;
    prop_assert!((total(&all) - 4.0 * PI).abs() < 1e-9, "{}", total(&all));
    let at = DVec3::from(x);
    for k in (0..300).filter(|_| rays) {
        for id in shown(triangles, at, way(k, 300)).unwrap_or_default() {
            prop_assert!(all.visible.contains(&id), "a ray shows {}", id);
        }
    }
    for ((id, area), witness) in all.visible.iter().zip(&all.areas).zip(&all.witnesses) {
        prop_assert!(triangles[*id as usize].1 == SurfaceKind::Opaque || *area == 0.0);
        if let Some(shown) = witness
            .filter(|_| rays)
            .and_then(|w| shown(triangles, at, DVec3::from(w).normalize()))
        {
            prop_assert!(
                shown.contains(id),
                "the witness of {} shows {:?}",
                id,
                shown
            );
        }
    }
    // The limits are rounded, so the sets may differ by triangles that are in the view by less than the
    // rounding.
    let limited = [
        View {
            direction: Some(direction),
            angle,
            ..View::default()
        },
        View {
            distance: Some(distance),
            ..View::default()
        },
        View {
            direction: Some(direction),
            angle,
            distance: Some(distance),
            ..View::default()
        },
    ];
    for view in &limited {
        let [boxes, cells] = both(view);
        let cap = if view.direction.is_some() {
            2.0 * PI * (1.0 - (angle / 2.0).cos())
        } else {
            4.0 * PI
        };
        prop_assert!(
            (total(&boxes) - cap).abs() < 1e-9 && (total(&cells) - cap).abs() < 1e-9,
            "{} and {} of {}",
            total(&boxes),
            total(&cells),
            cap
        );
        prop_assert!(
            (boxes.sky - cells.sky).abs() < 1e-9 && (boxes.unseen - cells.unseen).abs() < 1e-9,
            "sky {} and {}, unseen {} and {}",
            boxes.sky,
            cells.sky,
            boxes.unseen,
            cells.unseen
        );
        for (one, other) in [(&boxes, &cells), (&cells, &boxes)] {
            for ((id, area), witness) in one.visible.iter().zip(&one.areas).zip(&one.witnesses) {
                prop_assert!(
                    all.visible.contains(id),
                    "{} is seen in a part of the view alone",
                    id
                );
                prop_assert!(*area < 1e-9 || other.visible.contains(id));
                let Some(witness) = witness else { continue };
                let witness = DVec3::from(*witness).normalize();
                if view.direction.is_some() {
                    let along = witness.dot(DVec3::from(direction).normalize());
                    prop_assert!(
                        along > (angle / 2.0).cos() - 1e-9,
                        "a witness out of the cone"
                    );
                }
            }
        }
    }
    let target = Target {
        low: [-1.0, -2.0, 0.5],
        high: [1.5, -0.5, 2.0],
    };
    let share = |engine, mode| {
        let view = View {
            engine,
            ..View::default()
        };
        tets.sees_in(x, &target, &view, mode, &mut Scratch::default())
            .unwrap()
    };
    let exact = share(Engine::Boxes, Mode::Exact);
    prop_assert!((exact - share(Engine::Cells, Mode::Exact)).abs() < 1e-9);
    for engine in [Engine::Boxes, Engine::Cells] {
        prop_assert!(share(engine, Mode::Aggressive(0.1)) <= exact + 1e-9);
        prop_assert!(share(engine, Mode::Conservative(0.1)) >= exact - 1e-9);
    }
    Ok(())
}

fn kind() -> impl Strategy<Value = SurfaceKind> {
    (0..KINDS.len()).prop_map(|k| KINDS[k])
}

fn limits() -> impl Strategy<Value = ViewLimits> {
    let direction = prop::array::uniform3(-1.0..1.0f64).prop_filter("of some length", |d| {
        d.iter().map(|c| c * c).sum::<f64>() > 0.01
    });
    (direction, 0.1..6.2f64, 0.3..8.0f64).prop_map(|(direction, angle, distance)| ViewLimits {
        direction,
        angle,
        distance,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn engines_agree_on_lattices_of_kinds(
        all in prop::collection::vec((prop::array::uniform3(prop::array::uniform3(-3..=3i8)), kind()), 1..20),
        x in prop::array::uniform3(-9..=9i8),
        limits in limits(),
    ) {
        let all: Vec<(T, SurfaceKind)> =
            all.into_iter().map(|(t, kind)| (t.map(|p| p.map(f32::from)), kind)).collect();
        check(&all, x.map(|c| f64::from(c) / 2.0), &limits, true)?;
    }

    #[test]
    fn engines_agree_on_scattered_kinds(
        all in prop::collection::vec(
            (prop::array::uniform3(prop::array::uniform3(-3.0..3.0f32)), kind()), 1..20,
        ),
        x in prop::array::uniform3(-5.0..5.0f64),
        limits in limits(),
    ) {
        check(&all, x, &limits, true)?;
    }

    #[test]
    fn engines_agree_on_meshes_of_kinds(
        all in prop_oneof![few_points(), sheets()],
        kinds in prop::collection::vec(kind(), 1..12),
        x in prop::array::uniform3(-9..=9i8),
        limits in limits(),
    ) {
        let all: Vec<(T, SurfaceKind)> = all.into_iter().zip(kinds.into_iter().cycle()).collect();
        check(&all, x.map(|c| f64::from(c) / 2.0), &limits, true)?;
    }

    /// Looks from viewpoints near a triangle's plane.
    ///
    /// Beams are thinner than rounding there, and rays in doubles do not decide on which side the point is.
    #[test]
    fn engines_agree_from_viewpoints_near_triangles(
        all in prop_oneof![few_points(), sheets()],
        kinds in prop::collection::vec(kind(), 1..12),
        at in any::<u16>(),
        weights in prop::array::uniform3(0.05..1.0f64),
        push in -1e-9..1e-9f64,
        limits in limits(),
    ) {
        let all: Vec<(T, SurfaceKind)> = all.into_iter().zip(kinds.into_iter().cycle()).collect();
        prop_assume!(!all.is_empty());
        let [a, b, c] = all[usize::from(at) % all.len()].0.map(|p| DVec3::from(p.map(f64::from)));
        let sum: f64 = weights.iter().sum();
        let x = (a * weights[0] + b * weights[1] + c * weights[2]) / sum;
        // If `push` is positive, the viewpoint is off the plane only by rounding.
        let x = if push > 0.0 { x } else { x + DVec3::splat(push) };
        check(&all, x.to_array(), &limits, false)?;
    }
}

#[test]
fn faster_selects_engine_with_less_work() {
    // The triangles share one edge, like the pages of a book.
    let page = |k: u32| {
        let angle = f64::from(k) * PI / 60.0;
        let (x, y) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
        (
            [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [x, y, 0.0]],
            SurfaceKind::Opaque,
        )
    };
    let book: Vec<(T, SurfaceKind)> = (0..60).map(page).collect();
    let tets = tets(&book);
    let mut scratch = Scratch::default();
    let x = [0.3, 3.0, 0.1];
    for (mode, engine) in [
        (Mode::Exact, Engine::Boxes),
        (Mode::Conservative(0.01), Engine::Cells),
    ] {
        assert_eq!(
            tets.faster(x, &View::default(), mode, &mut scratch)
                .unwrap(),
            engine,
            "{mode:?}"
        );
    }
    // Among large triangles that cross, few triangles are visible, and all boxes overlap.
    let mut random = SplitMix64::new(1);
    let mut place = |size: f32| [0.0f32; 3].map(|_| size * (random.unit_f32() - 0.5));
    let crossing: Vec<(T, SurfaceKind)> = (0..100)
        .map(|_| ([0; 3].map(|_| place(9.0)), SurfaceKind::Opaque))
        .collect();
    let found = self::tets(&crossing).faster([0.1; 3], &View::default(), Mode::Exact, &mut scratch);
    assert_eq!(found, Ok(Engine::Cells));
    // A search that was stopped does not affect any later query.
    let given_up = || {
        let mut scratch = Scratch::default();
        assert_eq!(
            tets.faster(x, &View::default(), Mode::Exact, &mut scratch),
            Ok(Engine::Boxes)
        );
        assert!(scratch.seen.visible.is_empty() && scratch.seen.areas.is_empty());
        scratch
    };
    let target = Target {
        low: [-0.5, 0.1, -0.1],
        high: [0.5, 0.2, 0.1],
    };
    let answers = |new: &dyn Fn() -> Scratch, engine| {
        let view = View {
            witnesses: true,
            engine,
            ..View::default()
        };
        let seen = tets
            .look(x, &view, Mode::Exact, &mut new())
            .unwrap()
            .clone();
        (
            seen,
            tets.sees_in(x, &target, &view, Mode::Exact, &mut new())
                .unwrap(),
        )
    };
    for engine in [Engine::Boxes, Engine::Cells] {
        assert_eq!(
            answers(&given_up, engine),
            answers(&Scratch::default, engine)
        );
    }
}

#[test]
fn disjoint_cone_and_distance_show_no_triangle() {
    // In the triangle's plane, the view's cone contains only points farther than 1 from the axis. A distance
    // of at most √2 limits the view to points nearer to the axis.
    let wall = tets(&[(
        [[-10.0, -10.0, 1.0], [10.0, -10.0, 1.0], [0.0, 15.0, 1.0]],
        SurfaceKind::Opaque,
    )]);
    for (distance, seen) in [(1.2, false), (1.4, false), (1.42, true), (3.0, true)] {
        let direction = Some([0.0, 0.0, -1.0]);
        let (angle, distance) = (270f64.to_radians(), Some(distance));
        let view = View {
            direction,
            angle,
            distance,
            ..View::default()
        };
        for engine in [Engine::Boxes, Engine::Cells] {
            let found = look(&wall, [0.0; 3], &view, engine);
            assert_eq!(!found.visible.is_empty(), seen, "{distance:?} {engine:?}");
            assert!(
                found.areas.iter().all(|a| *a > 1e-3),
                "{distance:?} {engine:?}"
            );
        }
    }
    let mut random = SplitMix64::new(2);
    let mut number = |size: f64| size * (f64::from(random.unit_f32()) - 0.5);
    for case in 0..3000 {
        let triangle = [0; 3].map(|_| [0; 3].map(|_| number(8.0) as f32));
        let direction = Some([0; 3].map(|_| number(1.0)));
        let (angle, distance) = (
            (270.0 + number(160.0)).to_radians(),
            Some(2.0 + number(3.0)),
        );
        let view = View {
            direction,
            angle,
            distance,
            ..View::default()
        };
        let one = tets(&[(triangle, SurfaceKind::Opaque)]);
        let [boxes, cells] =
            [Engine::Boxes, Engine::Cells].map(|engine| look(&one, [0.0; 3], &view, engine));
        assert_eq!(boxes.visible, cells.visible, "{case}");
        assert!(
            boxes.areas.iter().all(|a| *a > 1e-9),
            "{case}: {:?}",
            boxes.areas
        );
    }
}
