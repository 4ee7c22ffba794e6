//! Sets from points among see-through, occluder-only and moving triangles, within cones and distances, and of
//! boxes: by both engines, and against rays.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::f64::consts::PI;

mod meshes;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_numbers::random::SplitMix64;
use sightline_scene::{Kind, Kinds, Object, Scene, Triangle};
use sightline_tetra::file::write;
use sightline_tetra::{Engine, Mode, Quiet, Scratch, Seen, Target, Tets, View, build};

use meshes::{few_points, sheets};

type T = [[f32; 3]; 3];

const KINDS: [Kind; 5] = [
    Kind::Opaque,
    Kind::Opaque,
    Kind::SeeThrough,
    Kind::OccluderOnly,
    Kind::Moving,
];

fn tets(triangles: &[(T, Kind)]) -> Tets {
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

fn look(tets: &Tets, x: [f64; 3], view: &View, engine: Engine) -> Seen {
    let view = View {
        engine,
        witnesses: true,
        ..view.clone()
    };
    tets.look(x, &view, Mode::Exact, &mut Scratch::default())
        .unwrap()
        .clone()
}

/// The triangles that a ray shows: those that it passes, and the first that blocks, several where they are in
/// one plane. Nothing where it passes near the border of a triangle or where planes are near each other.
fn shown(triangles: &[(T, Kind)], x: DVec3, way: DVec3) -> Option<Vec<u32>> {
    let mut hits: Vec<(f64, u32)> = Vec::new();
    for (id, (t, kind)) in (0..).zip(triangles) {
        let [a, b, c] = t.map(|p| DVec3::from(p.map(f64::from)) - x);
        let normal = (b - a).cross(c - a);
        let height = a.dot(normal);
        if normal.length() == 0.0 || height.abs() < 1e-12 || *kind == Kind::Moving {
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
    let blocks = |id: u32| triangles[id as usize].1 != Kind::SeeThrough;
    let end = hits
        .iter()
        .filter(|h| blocks(h.1))
        .map(|h| h.0)
        .fold(f64::INFINITY, f64::min);
    let ends_there = |h: &(f64, u32)| h.0 <= end * (1.0 + 1e-12);
    // See-through triangles in the plane of the end are shown or not: no ray tells.
    let near = |h: &(f64, u32)| !blocks(h.1) && (h.0 / end - 1.0).abs() < 1e-9;
    if hits.iter().any(near) {
        return None;
    }
    let shows = |id: u32| triangles[id as usize].1 != Kind::OccluderOnly;
    Some(
        hits.iter()
            .filter(|h| ends_there(h) && shows(h.1))
            .map(|h| h.1)
            .collect(),
    )
}

fn way(k: u32, n: u32) -> DVec3 {
    // A spiral over the sphere.
    let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(n);
    let turn = f64::from(k) * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * libm::cos(turn), r * libm::sin(turn), z)
}

fn total(seen: &Seen) -> f64 {
    seen.areas.iter().sum::<f64>() + seen.sky + seen.unseen + seen.dropped
}

fn alike(a: &Seen, b: &Seen) -> Result<(), TestCaseError> {
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

fn check(
    triangles: &[(T, Kind)],
    x: [f64; 3],
    direction: [f64; 3],
    angle: f64,
    distance: f64,
    rays: bool,
) -> Result<(), TestCaseError> {
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
        prop_assert!(triangles[*id as usize].1 == Kind::Opaque || *area == 0.0);
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
    // The limits are rounded: what is in the view by less than that may be in one set and not in the other.
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

fn kind() -> impl Strategy<Value = Kind> {
    (0..KINDS.len()).prop_map(|k| KINDS[k])
}

fn limits() -> impl Strategy<Value = ([f64; 3], f64, f64)> {
    let direction = prop::array::uniform3(-1.0..1.0f64).prop_filter("of some length", |d| {
        d.iter().map(|c| c * c).sum::<f64>() > 0.01
    });
    (direction, 0.1..6.2f64, 0.3..8.0f64)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn kinds_on_a_lattice_are_seen_alike(
        all in prop::collection::vec((prop::array::uniform3(prop::array::uniform3(-3..=3i8)), kind()), 1..20),
        x in prop::array::uniform3(-9..=9i8),
        (direction, angle, distance) in limits(),
    ) {
        let all: Vec<(T, Kind)> =
            all.into_iter().map(|(t, kind)| (t.map(|p| p.map(f32::from)), kind)).collect();
        check(&all, x.map(|c| f64::from(c) / 2.0), direction, angle, distance, true)?;
    }

    #[test]
    fn scattered_kinds_are_seen_alike(
        all in prop::collection::vec(
            (prop::array::uniform3(prop::array::uniform3(-3.0..3.0f32)), kind()), 1..20,
        ),
        x in prop::array::uniform3(-5.0..5.0f64),
        (direction, angle, distance) in limits(),
    ) {
        check(&all, x, direction, angle, distance, true)?;
    }

    #[test]
    fn meshes_of_kinds_are_seen_alike(
        all in prop_oneof![few_points(), sheets()],
        kinds in prop::collection::vec(kind(), 1..12),
        x in prop::array::uniform3(-9..=9i8),
        (direction, angle, distance) in limits(),
    ) {
        let all: Vec<(T, Kind)> = all.into_iter().zip(kinds.into_iter().cycle()).collect();
        check(&all, x.map(|c| f64::from(c) / 2.0), direction, angle, distance, true)?;
    }

    /// Near a triangle's plane beams are thinner than rounding, and rays in doubles do not tell which side
    /// the point is on.
    #[test]
    fn kinds_are_seen_alike_from_places_that_are_nearly_in_triangles(
        all in prop_oneof![few_points(), sheets()],
        kinds in prop::collection::vec(kind(), 1..12),
        (at, weights, push) in (any::<u16>(), prop::array::uniform3(0.05..1.0f64), -1e-9..1e-9f64),
        (direction, angle, distance) in limits(),
    ) {
        let all: Vec<(T, Kind)> = all.into_iter().zip(kinds.into_iter().cycle()).collect();
        prop_assume!(!all.is_empty());
        let [a, b, c] = all[usize::from(at) % all.len()].0.map(|p| DVec3::from(p.map(f64::from)));
        let sum: f64 = weights.iter().sum();
        let x = (a * weights[0] + b * weights[1] + c * weights[2]) / sum;
        // Most often by rounding alone.
        let x = if push > 0.0 { x } else { x + DVec3::splat(push) };
        check(&all, x.to_array(), direction, angle, distance, false)?;
    }
}

#[test]
fn the_engine_with_less_to_do_answers() {
    // Triangles around one edge, like the pages of a book.
    let page = |k: u32| {
        let angle = f64::from(k) * PI / 60.0;
        let (x, y) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
        (
            [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [x, y, 0.0]],
            Kind::Opaque,
        )
    };
    let book: Vec<(T, Kind)> = (0..60).map(page).collect();
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
    // Among large triangles that cross little is seen, and all boxes overlap.
    let mut random = SplitMix64::new(1);
    let mut place = |size: f32| [0.0f32; 3].map(|_| size * (random.unit_f32() - 0.5));
    let crossing: Vec<(T, Kind)> = (0..100)
        .map(|_| ([0; 3].map(|_| place(9.0)), Kind::Opaque))
        .collect();
    let found = self::tets(&crossing).faster([0.1; 3], &View::default(), Mode::Exact, &mut scratch);
    assert_eq!(found, Ok(Engine::Cells));
    // What is given up leaves nothing behind, whatever is asked next.
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
fn a_wide_cone_and_a_distance_that_have_nothing_in_common_show_nothing() {
    // The cone leaves what is more than 1 away from the axis in the triangle's plane, the distance what is
    // nearer to it.
    let wall = tets(&[(
        [[-10.0, -10.0, 1.0], [10.0, -10.0, 1.0], [0.0, 15.0, 1.0]],
        Kind::Opaque,
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
        let one = tets(&[(triangle, Kind::Opaque)]);
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
