//! Tests of properties of the lattice, the splitting rule and the plan.

use glam::Vec3;
use proptest::prelude::*;
use sightline_viewcells::{CellBox, Division, DivisionError, Plan, TileKind, UNITS_PER_CELL};

fn leaves(
    d: &Division,
    l: &sightline_viewcells::Lattice,
    c: CellBox,
    depth: u32,
    out: &mut Vec<CellBox>,
) {
    match d.split(l, &c, depth) {
        Some(s) => c
            .children(s)
            .into_iter()
            .for_each(|k| leaves(d, l, k, depth + 1, out)),
        None => out.push(c),
    }
}

proptest! {
    #[test]
    fn grid_has_cells_of_one_unit_box_each(x in 1u32..9, y in 1u32..9, z in 1u32..9) {
        let d = Division::Grid([x, y, z]);
        let l = d.lattice(Vec3::splat(-1.5), Vec3::new(2.0, 3.0, 1e6)).unwrap();
        let mut cells = Vec::new();
        leaves(&d, &l, d.root(&l), 0, &mut cells);
        prop_assert_eq!(cells.len() as u32, x * y * z);
        let mut corners: Vec<_> = cells.iter().map(|c| {
            assert!((0..3).all(|a| c.hi[a] - c.lo[a] == UNITS_PER_CELL));
            c.lo.map(|u| u / UNITS_PER_CELL)
        }).collect();
        corners.sort_unstable();
        corners.dedup();
        prop_assert_eq!(corners.len() as u32, x * y * z);
    }

    #[test]
    fn blocks_cover_every_cell_once_within_size_limit(
        cells in prop_oneof![[1u32..20, 1u32..20, 1u32..6], [1u32..600, 1u32..2, 1u32..3]],
        most in prop_oneof![Just(1u32), Just(8), Just(64), Just(512), 1u32..=512],
    ) {
        let d = Division::Grid(cells);
        let l = d.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let plan = Plan::new(&d, &l, sightline_viewcells::Layout::Blocks(most));
        let total: u64 = cells.map(u64::from).iter().product();
        prop_assert_eq!(plan.tiles.iter().map(|t| t.cells).sum::<u64>(), total);
        prop_assert!(plan.tiles.iter().all(|t| t.kind == TileKind::Leaf && t.needs.is_empty()));
        prop_assert!(plan.tiles.iter().all(|t| (1..=u64::from(most)).contains(&t.cells)));
        // Halving makes no block smaller than half the maximum size, except for odd sides.
        prop_assert!(total > u64::from(most) || plan.tiles.len() == 1);
    }

    #[test]
    fn plans_cover_every_cell_once_and_need_only_earlier_tiles(x in 1u32..20, y in 1u32..20, z in 1u32..6) {
        let d = Division::Grid([x, y, z]);
        let l = d.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let plan = Plan::new(&d, &l, sightline_viewcells::Layout::Samples);
        let mut cells = 0;
        for (i, t) in plan.tiles.iter().enumerate() {
            prop_assert!(t.needs.iter().all(|n| (*n as usize) < i));
            if t.kind == TileKind::Leaf { cells += t.cells; }
        }
        prop_assert_eq!(cells, u64::from(x * y * z));
        // Every corner of a leaf tile lies on a rectangle that some needed tile samples.
        for n in plan.leaves() {
            let t = &plan.tiles[n as usize];
            for f in 0..6 {
                let face = t.cell.face(f);
                let covered = t.needs.iter().any(|k| {
                    let other = &plan.tiles[*k as usize];
                    match other.kind {
                        TileKind::Face(g) => g == f,
                        TileKind::Separator(s) => {
                            let r = other.cell.cut(s);
                            r.axis == face.axis && r.at == face.at
                                && (0..2).all(|i| r.lo[i] <= face.lo[i] && face.hi[i] <= r.hi[i])
                        }
                        TileKind::Leaf => false,
                    }
                });
                prop_assert!(covered, "tile {n} face {f}");
            }
        }
    }

    #[test]
    fn octants_of_a_split_add_up(x in 0u32..5, y in 0u32..5, z in 0u32..5, axis in 0usize..3) {
        let cell = CellBox { lo: [0; 3], hi: [4; 3] };
        let [a, b] = cell.children(sightline_viewcells::Split { axis, at: 2 });
        let p = [x, y, z];
        prop_assert_eq!(a.octants(p) + b.octants(p), cell.octants(p));
    }

    #[test]
    fn rectangle_splits_without_gap_or_overlap(
        u in 1u32..7, v in 1u32..7, du in 0u32..17, dv in 0u32..17, axis in 0usize..3,
    ) {
        let d = Division::Grid([8, 8, 8]);
        let l = d.lattice(Vec3::ZERO, Vec3::new(1.0, 5.0, 0.3)).unwrap();
        let r = sightline_viewcells::Rect {
            axis, at: 3, lo: [0, UNITS_PER_CELL],
            hi: [(u * UNITS_PER_CELL) >> du, UNITS_PER_CELL + ((v * UNITS_PER_CELL) >> dv)],
        };
        prop_assume!(r.hi[0] > r.lo[0] && r.hi[1] > r.lo[1]);
        let side = |r: &sightline_viewcells::Rect, i: usize| u64::from(r.hi[i] - r.lo[i]);
        let area = |r: &sightline_viewcells::Rect| side(r, 0) * side(r, 1);
        let parts = r.split(&l);
        if !parts.is_empty() {
            prop_assert_eq!(parts.iter().map(area).sum::<u64>(), area(&r));
            prop_assert!(parts.iter().all(|p| area(p) > 0));
        }
    }
}

#[test]
fn neighbours_agree_on_positions_to_the_bit() {
    let d = Division::Grid([7, 3, 5]);
    let l = d
        .lattice(Vec3::new(-0.1, 1e-6, 3.3), Vec3::new(0.7, 1e6, 3.4))
        .unwrap();
    let mut cells = Vec::new();
    leaves(&d, &l, d.root(&l), 0, &mut cells);
    for c in &cells {
        let (lo, hi) = c.world(&l);
        assert!((0..3).all(|a| lo[a] < hi[a]));
        for other in &cells {
            for a in 0..3 {
                if other.lo[a] == c.hi[a] {
                    assert_eq!(other.world(&l).0[a].to_bits(), hi[a].to_bits());
                }
            }
        }
    }
}

#[test]
fn lattice_errors_report_invalid_values() {
    let box_error = Division::Grid([1; 3])
        .lattice(Vec3::ZERO, Vec3::new(1.0, 0.0, 1.0))
        .unwrap_err();
    assert!(matches!(box_error, DivisionError::Box { axis: 1, .. }));
    let far = Division::Grid([4096, 1, 1])
        .lattice(Vec3::splat(500_000.0), Vec3::splat(500_100.0))
        .unwrap_err();
    assert!(matches!(
        far,
        DivisionError::TooFine {
            axis: 0,
            cells: 4096
        }
    ));
    assert!(
        Division::Grid([0, 1, 1])
            .lattice(Vec3::ZERO, Vec3::ONE)
            .is_err()
    );
    assert!(
        Division::Grid([32768, 32768, 1])
            .lattice(Vec3::ZERO, Vec3::ONE)
            .is_err()
    );
    assert!(
        Division::Adaptive {
            budget: 0,
            max_depth: 3
        }
        .lattice(Vec3::ZERO, Vec3::ONE)
        .is_err()
    );
    assert!(
        Division::Grid([1; 3])
            .lattice(Vec3::NAN, Vec3::ONE)
            .is_err()
    );
}
