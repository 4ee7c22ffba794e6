//! Tests of cell groups: triangles hidden from the box are hidden from each cell, the other decisions stay
//! the same, and the checker rejects altered claims.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod common;

use std::sync::atomic::{AtomicU32, Ordering};

use common::Corners;
use common::cells::{chambers, exact_scene, set, solve};
use glam::Vec3;
use proptest::prelude::*;
use sightline_certificate::checker::{CellClaims, CellRefusal, Claim, Triangles, check_cell};
use sightline_certificate::{CellCertificate, GroupCertificate, HiddenGroup, Target, codec};
use sightline_exact::Cell;
use sightline_exact::{
    CellDecisions, CellGroup, CellTask, ExactScene, GroupDecisions, QueryLimits, decide,
    decide_group,
};
use sightline_scene::Aabb;

/// Creates the eight cells that fill a box, the first axis changing fastest.
fn cells(Aabb { min, max }: Aabb) -> Vec<Aabb> {
    let middle = (min + max) * 0.5;
    let corner = |k: usize| Vec3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32);
    (0..8)
        .map(|k| {
            Aabb::new(
                min + (middle - min) * corner(k),
                middle + (max - middle) * corner(k),
            )
        })
        .collect()
}

fn shared(
    scene: &ExactScene,
    boxes: &[Aabb],
    seen: &[&[u32]],
    stop: &(dyn Fn() -> bool + Sync),
) -> (Vec<u32>, GroupCertificate) {
    let cells: Vec<Cell> = boxes
        .iter()
        .map(|b| Cell::new(b.min, b.max).unwrap())
        .collect();
    let limits = QueryLimits::default();
    let GroupDecisions {
        hidden,
        shared,
        statistics,
    } = decide_group(&CellGroup {
        scene,
        cells: &cells,
        region: None,
        seen,
        listed: &[],
        limits,
        seed: 7,
        keep: true,
        stop,
        asked: &|| (),
    });
    assert_eq!(statistics.hidden, hidden.len() as u64);
    let mut all: Vec<u32> = shared
        .hidden
        .iter()
        .flat_map(|h| h.triangles.iter().copied())
        .collect();
    all.sort_unstable();
    assert_eq!(all, hidden);
    (hidden, shared)
}

fn below(scene: &ExactScene, cell: Aabb, seen: &[u32], above: &[u32]) -> CellDecisions {
    decide(&CellTask {
        scene,
        cell: Cell::new(cell.min, cell.max).unwrap(),
        region: None,
        seen,
        above,
        listed: None,
        limits: QueryLimits::default(),
        seed: 7,
        keep: true,
        stop: &|| false,
        asked: &|| (),
    })
}

fn check(
    triangles: &[Corners],
    cell: Aabb,
    d: &CellDecisions,
    certificate: &CellCertificate,
    above: Option<&GroupCertificate>,
) -> Result<u64, CellRefusal> {
    let (visible, index) = (set(d), Triangles::new(triangles));
    let named = CellCertificate {
        above: above.map(|_| 0),
        ..certificate.clone()
    };
    let claims = CellClaims {
        cell,
        visible: &visible,
        undecided: &d.undecided,
        certificate: &named,
        above,
    };
    check_cell(&index, &claims, &|_| true)
}

/// Returns the chambers and the far part of the first chamber.
///
/// Half of the triangles behind the wall are hidden from this part.
fn corner() -> (Vec<Corners>, Aabb) {
    (
        chambers().0,
        Aabb::new(Vec3::new(1.0, 5.0, 0.5), Vec3::new(5.0, 9.0, 2.5)),
    )
}

#[test]
fn triangles_hidden_from_box_are_hidden_from_each_cell() {
    let (triangles, around) = corner();
    let scene = exact_scene(&triangles);
    let cells = cells(around);
    let alone: Vec<CellDecisions> = cells
        .iter()
        .map(|c| solve(&scene, *c, &[], &|| false))
        .collect();
    let none: [&[u32]; 8] = [&[]; 8];
    let (hidden, shared_by_all) = shared(&scene, &cells, &none, &|| false);
    assert!(hidden.len() > 20, "{hidden:?}");
    let (mut apart, mut joint) = (0, 0);
    for (cell, alone) in cells.iter().zip(&alone) {
        assert!(
            hidden
                .iter()
                .all(|t| alone.visible.binary_search(t).is_err())
        );
        let d = below(&scene, *cell, &[], &hidden);
        assert_eq!(
            (&d.visible, &d.undecided),
            (&alone.visible, &alone.undecided)
        );
        assert_eq!(
            (d.statistics.hidden, d.statistics.above),
            (alone.statistics.hidden, hidden.len() as u64)
        );
        check(&triangles, *cell, &d, &d.certificate, Some(&shared_by_all)).unwrap();
        apart += alone.statistics.queries;
        joint += d.statistics.queries;
    }
    assert!(joint < apart, "{joint} queries instead of {apart}");
    // Triangles that sampling has shown from a cell are not queried.
    let seen: Vec<&[u32]> = alone.iter().map(|d| d.visible.as_slice()).collect();
    let (again, _) = shared(&scene, &cells, &seen, &|| false);
    assert_eq!(again, hidden);
    // Wrong guesses do not reduce the triangles hidden from the cells, and the cells refute them.
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    let d = below(&scene, cells[0], &all, &hidden);
    assert_eq!(d.visible, alone[0].visible);
    assert_eq!(d.statistics.refuted, d.statistics.hidden);
}

#[test]
fn stopped_group_leaves_triangles_to_cells() {
    let (triangles, around) = corner();
    let scene = exact_scene(&triangles);
    let cells = cells(around);
    let none: [&[u32]; 8] = [&[]; 8];
    let (whole, _) = shared(&scene, &cells, &none, &|| false);
    for most in [0, 5, 50, 500] {
        let asked = AtomicU32::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= most;
        let (hidden, owners) = shared(&scene, &cells, &none, &stop);
        assert!(
            hidden.iter().all(|t| whole.binary_search(t).is_ok()),
            "stopped after {most}"
        );
        let d = below(&scene, cells[3], &[], &hidden);
        assert!(d.undecided.is_empty());
        check(&triangles, cells[3], &d, &d.certificate, Some(&owners)).unwrap();
    }
}

#[test]
fn checker_rejects_tampered_box_claims() {
    let (triangles, around) = corner();
    let scene = exact_scene(&triangles);
    let cells = cells(around);
    let none: [&[u32]; 8] = [&[]; 8];
    let (hidden, owners) = shared(&scene, &cells, &none, &|| false);
    let cell = cells[0];
    let d = below(&scene, cell, &[], &hidden);
    let ask = |group: &GroupCertificate| check(&triangles, cell, &d, &d.certificate, Some(group));
    ask(&owners).unwrap();
    // The cell names no group.
    assert!(matches!(
        check(&triangles, cell, &d, &d.certificate, None),
        Err(CellRefusal::Account(..))
    ));
    let with = |change: &dyn Fn(&mut GroupCertificate)| {
        let mut changed = owners.clone();
        change(&mut changed);
        ask(&changed)
    };
    // These are a box that does not contain the cell, no valid box, and a box larger than the proved box.
    for (axis, greatest) in cell.max.to_array().into_iter().enumerate() {
        assert_eq!(
            with(&|s| s.bounds.min[axis] = s.bounds.min[axis].next_up()),
            Err(CellRefusal::Above)
        );
        assert_eq!(
            with(&|s| s.bounds.max[axis] = greatest.next_down()),
            Err(CellRefusal::Above)
        );
        for not in [f32::NAN, f32::NEG_INFINITY] {
            assert!(with(&|s| s.bounds.min[axis] = not).is_err());
        }
    }
    let refused = |r: Result<u64, CellRefusal>| matches!(r, Err(CellRefusal::Hidden { .. }));
    assert!(refused(with(&|s| s.bounds.min = Vec3::new(0.5, 0.25, 0.5))));
    assert!(refused(with(&|s| s.hidden[0].proofs.clear())));
    // Claims about surfaces are valid only for a cell, not for a box.
    let claimed = |target: Target| {
        with(&move |s| {
            let triangles = std::mem::take(&mut s.hidden[0].triangles);
            s.hidden[0] = HiddenGroup {
                target: target.clone(),
                triangles,
                proofs: Vec::new(),
            };
        })
    };
    assert!(refused(claimed(Target::Surfaces)) && refused(claimed(Target::Half)));
    // A triangle visible from the cell is claimed to be hidden.
    let seen = d.certificate.seen[0].0;
    assert!(matches!(
        with(&|s| s.hidden[0].triangles.push(seen)),
        Err(CellRefusal::Account(..))
    ));
    let beyond = triangles.len() as u32;
    assert!(matches!(
        with(&|s| s.hidden[0].triangles.push(beyond)),
        Err(CellRefusal::Account(..))
    ));
    // If the cell stores a group for other cells, the checker checks the group with the cell, regardless of
    // the group that the cell itself names.
    let mut own = d.certificate.clone();
    let mut kept = owners.clone();
    kept.hidden[0].proofs.clear();
    (own.shared, own.above) = (Some(kept), Some(0));
    assert!(refused(check(&triangles, cell, &d, &own, Some(&owners))));
    let visible = set(&d);
    let claims = CellClaims {
        cell,
        visible: &visible,
        undecided: &[],
        certificate: &own,
        above: Some(&owners),
    };
    let others = |claim: Claim| !matches!(claim, Claim::Shared(_));
    check_cell(&Triangles::new(&triangles), &claims, &others).unwrap();
    // A certificate names a group that is missing, or a group is present that no certificate names.
    let with = |certificate: &CellCertificate, above| {
        let claims = CellClaims {
            cell,
            visible: &visible,
            undecided: &[],
            certificate,
            above,
        };
        check_cell(&Triangles::new(&triangles), &claims, &|_| true)
    };
    assert_eq!(with(&own, None), Err(CellRefusal::Above));
    assert_eq!(with(&d.certificate, Some(&owners)), Err(CellRefusal::Above));
}

#[test]
fn certificate_without_group_keeps_its_bytes() {
    let (triangles, cell) = chambers();
    let d = solve(&exact_scene(&triangles), cell, &[], &|| false);
    let n = triangles.len() as u32;
    let raw = zstd::stream::decode_all(codec::encode(&d.certificate).unwrap().as_slice()).unwrap();
    let mut more = d.certificate.clone();
    more.above = Some(3);
    let longer = zstd::stream::decode_all(codec::encode(&more).unwrap().as_slice()).unwrap();
    assert!(longer.starts_with(&raw) && longer[raw.len()..] == [4]);
    assert_eq!(codec::decode_raw(&longer, n).unwrap(), more);
    assert_eq!(codec::decode_raw(&raw, n).unwrap(), d.certificate);
    assert!(
        codec::decode_raw(&[raw.as_slice(), &[0]].concat(), n).is_err(),
        "two forms for the same"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    /// On a coarse grid, nearly every triangle touches another or lies in one plane with it.
    ///
    /// The same holds for the faces of the box and the cells.
    #[test]
    fn cells_of_group_see_same_triangles_as_single_cells(
        triangles in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-4i8..5)), 1..14),
        corner in prop::array::uniform3(-3i8..4),
        size in prop::array::uniform3(1i8..3),
        guess in any::<u16>(),
    ) {
        let point = |p: [i8; 3]| Vec3::from(p.map(f32::from));
        let triangles: Vec<Corners> = triangles.iter().map(|t| t.map(point)).collect();
        let scene = exact_scene(&triangles);
        let cells = cells(Aabb::new(point(corner), point(corner) + 2.0 * point(size)));
        let guesses: Vec<u32> = (0..triangles.len() as u32).filter(|t| guess >> t & 1 == 1).collect();
        let guesses_for = |k| if k == guess as usize % 8 { guesses.as_slice() } else { &[] };
        let seen: Vec<&[u32]> = (0..8).map(guesses_for).collect();
        let (hidden, group) = shared(&scene, &cells, &seen, &|| false);
        for (cell, seen) in cells.iter().zip(seen) {
            let d = below(&scene, *cell, seen, &hidden);
            prop_assert!(d.undecided.is_empty());
            prop_assert_eq!(&d.visible, &solve(&scene, *cell, seen, &|| false).visible);
            if let Err(e) = check(&triangles, *cell, &d, &d.certificate, Some(&group)) {
                return Err(TestCaseError::fail(e.to_string()));
            }
        }
    }
}
