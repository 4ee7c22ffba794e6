//! Tests of decided view cells: the checker accepts the certificate, rays do not refute it, the checker
//! rejects altered certificates, and a stopped search leaves triangles undecided.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use std::sync::atomic::{AtomicU32, Ordering};

use common::Corners;
use common::cells::{chambers, exact_scene, set, solve};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_certificate::checker::{CellClaims, CellRefusal, Triangles, check_cell};
use sightline_certificate::{CellCertificate, Target, Witness, codec};
use sightline_exact::{Cell, FromCellAnswer, Sources, from_cell};
use sightline_exact::{CellDecisions, Polygon, QueryCost, QueryLimits};
use sightline_scene::Aabb;

/// A scene, a cell, the decisions about the cell, and the uncompressed certificate of the cell.
type Case = (Vec<Corners>, Aabb, CellDecisions, Vec<u8>);

fn check(
    triangles: &[Corners],
    cell: Aabb,
    d: &CellDecisions,
    certificate: &CellCertificate,
) -> Result<u64, CellRefusal> {
    let (visible, index) = (set(d), Triangles::new(triangles));
    let claims = CellClaims {
        cell,
        visible: &visible,
        undecided: &d.undecided,
        certificate,
        above: None,
    };
    check_cell(&index, &claims, &|_| true)
}

#[test]
fn checker_accepts_all_claims_about_chambers() {
    let (triangles, cell) = chambers();
    let scene = exact_scene(&triangles);
    let d = solve(&scene, cell, &[], &|| false);
    assert!(d.undecided.is_empty(), "{:?}", d.undecided);
    assert_eq!(
        d.statistics.hidden as usize + d.visible.len(),
        triangles.len()
    );
    assert!(d.statistics.boxes > 0, "some box is hidden as a whole");
    assert!(
        d.visible
            .iter()
            .all(|t| (*t as usize) < triangles.len() - 12),
        "nothing outside is seen"
    );
    assert!(check(&triangles, cell, &d, &d.certificate).unwrap() > 0);
    // Guesses affect only the triangles that rays show; the search refutes wrong guesses.
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    let guessed = solve(&scene, cell, &all, &|| false);
    assert_eq!(guessed.visible, d.visible);
    assert_eq!(guessed.statistics.refuted, guessed.statistics.hidden);
    check(&triangles, cell, &guessed, &guessed.certificate).unwrap();
    // A second run returns the same bytes.
    let again = solve(&scene, cell, &all, &|| false);
    assert_eq!(
        codec::encode(&again.certificate).unwrap(),
        codec::encode(&guessed.certificate).unwrap()
    );
    let read = codec::decode(
        &codec::encode(&d.certificate).unwrap(),
        triangles.len() as u32,
    )
    .unwrap();
    assert_eq!(read, d.certificate);
}

#[test]
fn stopped_search_leaves_rest_undecided() {
    let (triangles, cell) = chambers();
    let scene = exact_scene(&triangles);
    let whole = solve(&scene, cell, &[], &|| false);
    for most in [0, 1, 3, 10, 20, 50, 200, 1000] {
        let asked = AtomicU32::new(0);
        let d = solve(&scene, cell, &whole.visible, &|| {
            asked.fetch_add(1, Ordering::Relaxed) >= most
        });
        assert!(
            d.visible
                .iter()
                .all(|t| whole.visible.binary_search(t).is_ok())
        );
        assert!(
            whole
                .visible
                .iter()
                .all(|t| set(&d).binary_search(t).is_ok()),
            "stopped after {most}"
        );
        assert_eq!(
            d.statistics.open.iter().sum::<u64>(),
            d.undecided.len() as u64
        );
        check(&triangles, cell, &d, &d.certificate).unwrap();
    }
}

#[test]
fn checker_rejects_tampered_claims() {
    let (triangles, cell) = chambers();
    let scene = exact_scene(&triangles);
    let d = solve(&scene, cell, &[], &|| false);
    let index = Triangles::new(&triangles);
    let visible = set(&d);
    let ask = |cell, visible: &[u32], undecided: &[u32], certificate: &CellCertificate| {
        check_cell(
            &index,
            &CellClaims {
                cell,
                visible,
                undecided,
                certificate,
                above: None,
            },
            &|_| true,
        )
    };
    ask(cell, &visible, &[], &d.certificate).unwrap();
    // The first sets hide a visible triangle and show a hidden one.
    let without: Vec<u32> = visible
        .iter()
        .copied()
        .filter(|t| *t != visible[3])
        .collect();
    assert!(ask(cell, &without, &[], &d.certificate).is_err());
    let hidden = d.certificate.hidden[0].triangles[0];
    let mut with = visible.clone();
    with.push(hidden);
    with.sort_unstable();
    assert!(ask(cell, &with, &[], &d.certificate).is_err());
    let mut fewer = d.certificate.clone();
    fewer.hidden.remove(0);
    assert!(matches!(
        ask(cell, &visible, &[], &fewer),
        Err(CellRefusal::Account(..))
    ));
    let mut both = fewer.clone();
    let (first, last) = (
        d.certificate.seen[0].clone(),
        d.certificate.seen.last().unwrap().clone(),
    );
    both.seen = vec![(first.0, last.1)];
    both.seen.extend(d.certificate.seen[1..].iter().cloned());
    both.hidden = d.certificate.hidden.clone();
    assert!(matches!(
        ask(cell, &visible, &[], &both),
        Err(CellRefusal::Witness(..))
    ));
    // A larger cell sees more, so some proof must fail or some witness must begin outside.
    let larger = Aabb::new(Vec3::new(1.0, 0.5, 1.0), Vec3::new(9.5, 8.0, 2.0));
    assert!(ask(larger, &visible, &[], &d.certificate).is_err());
    // These are a proof for another box, a moved box, and a missing proof.
    let mut polygons = 0;
    for at in 0..d.certificate.hidden.len() {
        let mut e = d.certificate.clone();
        if e.hidden[at].target == Target::Surfaces {
            // One triangle is hidden by another triangle's surface, and one is not entirely on the hidden
            // side.
            for other in 0..triangles.len() as u32 {
                if !e.hidden[at].triangles.contains(&other)
                    && visible.binary_search(&other).is_err()
                {
                    let [mut taken, mut added] = [e.clone(), e.clone()];
                    taken
                        .hidden
                        .iter_mut()
                        .for_each(|h| h.triangles.retain(|t| *t != other));
                    added.hidden[at].triangles.push(other);
                    added.hidden[at].triangles.sort_unstable();
                    assert!(matches!(
                        ask(cell, &visible, &[], &taken),
                        Err(CellRefusal::Account(..))
                    ));
                    assert!(ask(cell, &visible, &[], &added).is_err());
                }
            }
            let front: Vec<u32> = visible
                .iter()
                .copied()
                .filter(|t| !d.certificate.hidden[at].triangles.contains(t))
                .collect();
            for seen in &front {
                let less: Vec<u32> = visible.iter().copied().filter(|t| t != seen).collect();
                let mut lying = e.clone();
                lying.seen.retain(|(t, _)| t != seen);
                lying.hidden[at].triangles.push(*seen);
                lying.hidden[at].triangles.sort_unstable();
                assert!(
                    matches!(
                        ask(cell, &less, &[], &lying),
                        Err(CellRefusal::Hidden { .. })
                    ),
                    "{seen}"
                );
            }
            continue;
        }
        e.hidden[at].proofs.pop();
        assert!(matches!(
            ask(cell, &visible, &[], &e),
            Err(CellRefusal::Hidden { .. })
        ));
        if let Target::Box(Aabb { min, .. }) = &mut e.hidden[at].target {
            *min += Vec3::splat(0.25);
            e.hidden[at].proofs = d.certificate.hidden[at].proofs.clone();
            assert!(ask(cell, &visible, &[], &e).is_err());
        }
        if let Target::Polygon(corners) = &d.certificate.hidden[at].target {
            // These polygons do not cover a triangle, are not flat, or are not convex.
            let middle = corners.iter().sum::<Vec3>() / corners.len() as f32;
            let smaller: Vec<Vec3> = corners.iter().map(|c| (*c + middle) * 0.5).collect();
            let mut bent = corners.to_vec();
            bent[0] += (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let mut crossed = corners.to_vec();
            crossed.swap(0, 1);
            crossed.insert(1, middle);
            for other in [smaller, bent, crossed, Vec::new()] {
                let mut e = d.certificate.clone();
                e.hidden[at].target = Target::Polygon(other.into());
                assert!(matches!(
                    ask(cell, &visible, &[], &e),
                    Err(CellRefusal::Hidden { .. })
                ));
            }
            polygons += 1;
        }
    }
    assert!(
        polygons > 0,
        "no triangles were hidden together in a polygon"
    );
    // This witness continues through a wall.
    let (at, id, [p, q]) = d
        .certificate
        .seen
        .iter()
        .enumerate()
        .find_map(|(at, (id, w))| {
            if let Witness::Floats(ends) = w {
                Some((at, *id, *ends))
            } else {
                None
            }
        })
        .unwrap();
    let mut e = d.certificate.clone();
    e.seen[at].1 = Witness::Floats([p, p + (p - q)]);
    assert!(matches!(ask(cell, &visible, &[], &e), Err(CellRefusal::Witness(t, _)) if t == id));
}

/// Creates the twelve outward triangles of a box: two per face, axis by axis, the lower face first.
fn solid(min: Vec3, max: Vec3) -> Vec<Corners> {
    let triangle = |i: usize| {
        let (axis, up) = (i / 4, i / 2 % 2 == 1);
        let corner = |s: bool, t: bool| {
            let mut p = min;
            for (k, greater) in [(axis, up), ((axis + 1) % 3, s), ((axis + 2) % 3, t)] {
                if greater {
                    p[k] = max[k];
                }
            }
            p
        };
        let (a, c) = (corner(false, false), corner(true, true));
        let (b, d) = (corner(up, !up), corner(!up, up));
        if i.is_multiple_of(2) {
            [a, b, c]
        } else {
            [a, c, d]
        }
    };
    (0..12).map(triangle).collect()
}

#[test]
fn surfaces_hide_triangles_that_face_away() {
    let mut triangles = solid(Vec3::ZERO, Vec3::ONE);
    triangles.extend(solid(Vec3::splat(2.0), Vec3::splat(4.0)));
    let cell = Aabb::new(Vec3::new(-2.0, 0.25, 0.25), Vec3::new(-1.0, 0.75, 0.75));
    let scene = exact_scene(&triangles);
    let d = solve(&scene, cell, &[], &|| false);
    assert_eq!(
        (d.statistics.enclosed, d.statistics.queries > 0),
        (16, true)
    );
    check(&triangles, cell, &d, &d.certificate).unwrap();
    // From the inside of a box, all triangles of that box are visible, and all triangles of the other box are
    // hidden.
    let inside = Aabb::new(Vec3::splat(0.25), Vec3::splat(0.75));
    let d = solve(&scene, inside, &[], &|| false);
    assert_eq!(d.visible, (0..12).collect::<Vec<u32>>());
    check(&triangles, inside, &d, &d.certificate).unwrap();
    // The inner side is visible through a hole. Triangles that no line through the hole reaches are still
    // hidden by the surface.
    triangles.remove(1);
    let scene = exact_scene(&triangles);
    let d = solve(&scene, cell, &[], &|| false);
    assert!(
        d.visible.iter().filter(|t| **t < 11).count() > 2,
        "{:?}",
        d.visible
    );
    check(&triangles, cell, &d, &d.certificate).unwrap();
    let beside = Aabb::new(Vec3::new(2.0, -2.0, 0.25), Vec3::new(3.0, -1.0, 0.75));
    let d = solve(&scene, beside, &[], &|| false);
    assert!(d.statistics.enclosed > 0);
    check(&triangles, beside, &d, &d.certificate).unwrap();
}

/// Returns the chambers with their decisions, computed once.
fn decided() -> &'static Case {
    static ONCE: std::sync::OnceLock<Case> = std::sync::OnceLock::new();
    ONCE.get_or_init(|| {
        let (triangles, cell) = chambers();
        let d = solve(&exact_scene(&triangles), cell, &[], &|| false);
        let raw = zstd::decode_all(codec::encode(&d.certificate).unwrap().as_slice()).unwrap();
        (triangles, cell, d, raw)
    })
}

fn grid_point(reach: i8) -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-reach..=reach).prop_map(|p| Vec3::from(p.map(f32::from)))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// On a coarse grid, nearly every triangle touches or overlaps another or lies in one plane with it.
    ///
    /// The same holds for the faces of the cell.
    #[test]
    fn checker_accepts_any_cell_and_rays_do_not_refute_it(
        triangles in prop::collection::vec(prop::array::uniform3(grid_point(4)), 1..14),
        corner in grid_point(3),
        size in prop::array::uniform3(1i8..3),
        guess in any::<u16>(),
        seed in any::<u64>(),
    ) {
        let cell = Aabb::new(corner, corner + Vec3::from(size.map(f32::from)));
        let scene = exact_scene(&triangles);
        let seen: Vec<u32> = (0..triangles.len() as u32).filter(|t| guess >> t & 1 == 1).collect();
        let d = solve(&scene, cell, &seen, &|| false);
        prop_assert!(d.undecided.is_empty(), "{:?}", d.statistics);
        if let Err(e) = check(&triangles, cell, &d, &d.certificate) {
            return Err(TestCaseError::fail(e.to_string()));
        }
        // Rays from inside the cell, in doubles: if a hit is well inside a triangle and clear of all edges,
        // the cell sees the triangle.
        let mut state = seed;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        for _ in 0..400 {
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
            hits.sort_by(|x, y| x.0.total_cmp(&y.0));
            if let (true, Some((at, _))) = (clear, hits.first()) {
                for (_, id) in hits.iter().take_while(|h| h.0 < at + 1e-9) {
                    prop_assert!(d.visible.contains(&(*id as u32)), "triangle {id} is seen from {p} towards \
                        {q}");
                }
            }
        }
    }

    /// Boxes that overlap, touch and have holes: queries confirm that every triangle hidden by a surface is
    /// hidden.
    #[test]
    fn queries_confirm_triangles_hidden_by_surfaces(
        boxes in prop::collection::vec((grid_point(3), prop::array::uniform3(1i8..4)), 1..5),
        missing in prop::collection::btree_set(0usize..40, 0..4),
        corner in grid_point(5),
        size in prop::array::uniform3(1i8..3),
    ) {
        let mut triangles: Vec<Corners> =
            boxes.iter().flat_map(|(lo, s)| solid(*lo, *lo + Vec3::from(s.map(f32::from)))).collect();
        let mut number = 0;
        triangles.retain(|_| {
            number += 1;
            !missing.contains(&(number - 1))
        });
        prop_assume!(!triangles.is_empty());
        // The cell is off the grid, so that some cells touch no triangle.
        let lo = corner + Vec3::splat(0.25);
        let cell = Aabb::new(lo, lo + Vec3::from(size.map(f32::from)) - Vec3::splat(0.5));
        let scene = exact_scene(&triangles);
        let d = solve(&scene, cell, &[], &|| false);
        prop_assert!(d.undecided.is_empty());
        if let Err(e) = check(&triangles, cell, &d, &d.certificate) {
            return Err(TestCaseError::fail(e.to_string()));
        }
        let view = Cell::new(cell.min, cell.max).unwrap();
        for h in d.certificate.hidden.iter().filter(|h| matches!(h.target, Target::Surfaces | Target::Half)) {
            for id in &h.triangles {
                let target = Polygon::triangle(triangles[*id as usize].map(|v| v.as_dvec3())).unwrap();
                let limits = QueryLimits::default();
                let sources = Sources::new(view, None);
                let (stop, mut cost) = (|| false, QueryCost::default());
                let occluders = scene.occluders();
                let found = from_cell(occluders, &sources, &[target], None, &limits, &stop, &mut cost);
                prop_assert!(matches!(found, FromCellAnswer::Hidden(_)), "triangle {} is seen", id);
            }
        }
    }

    /// The checker accepts no altered certificate for a set that lacks a visible triangle or contains a
    /// hidden one.
    #[test]
    fn checker_rejects_wrong_set_with_any_certificate(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        moved in any::<prop::sample::Index>(),
    ) {
        let (triangles, cell, d, raw) = decided();
        let mut bytes = raw.clone();
        for (at, value) in &changes {
            bytes[at.index(raw.len())] = *value;
        }
        if let Ok(mut certificate) = codec::decode_raw(&bytes, triangles.len() as u32) {
            let id = moved.index(triangles.len()) as u32;
            let mut visible = d.visible.clone();
            match visible.binary_search(&id) {
                // The triangle is claimed to be hidden, with the other triangles of the first group.
                Ok(at) => {
                    visible.remove(at);
                    certificate.seen.retain(|(t, _)| *t != id);
                    if let Some(group) = certificate.hidden.first_mut() {
                        group.triangles.push(id);
                        group.triangles.sort_unstable();
                    }
                }
                // The triangle is claimed to be visible, with the witness of another triangle.
                Err(at) => {
                    visible.insert(at, id);
                    certificate.hidden.iter_mut().for_each(|h| h.triangles.retain(|t| *t != id));
                    if let Some((_, witness)) = certificate.seen.first().cloned() {
                        certificate.seen.push((id, witness));
                        certificate.seen.sort_by_key(|s| s.0);
                    }
                }
            }
            let claims = CellClaims {
                cell: *cell,
                visible: &visible,
                undecided: &[],
                certificate: &certificate,
                above: None,
            };
            prop_assert!(check_cell(&Triangles::new(triangles), &claims, &|_| true).is_err());
        }
    }

    #[test]
    fn decoder_handles_any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        sightline_certificate::fuzzing::certificate(&bytes);
    }
}
