//! Tests of the checker on cells of known scenes, of soups, and on altered cells.

#![allow(clippy::unwrap_used, reason = "tests")]

mod shapes;

use glam::Vec3;
use proptest::prelude::*;
use shapes::{lattice_of_cubes, saddle, schonhardt};
use sightline_geometry::predicates::collinear;
use sightline_tetra::Quiet;
use sightline_tetra::cells::{CellCounts, Cells, NONE, Tetrahedra, cells};
use sightline_tetra::check::{Fault, check};
use sightline_tetra::file::Contents;
use sightline_tetra::point_query::Boxes;
use sightline_tetra::surfaces::{BLOCKS, CLOSED, FLAT, Surfaces};
use sightline_tetra::windings::windings;

const DIGEST: [u8; 32] = [11; 32];

fn surfaces(triangles: &[[[f32; 3]; 3]]) -> Surfaces {
    let mut out = Surfaces::default();
    for t in triangles {
        let corners = t.map(|p| {
            let p = p.map(|x| x + 0.0);
            out.points.iter().position(|q| *q == p).unwrap_or_else(|| {
                out.points.push(p);
                out.points.len() - 1
            }) as u32
        });
        let [a, b, c] = t.map(Vec3::from);
        out.triangles.push(corners);
        out.flags
            .push(if collinear(a, b, c) { FLAT } else { BLOCKS });
    }
    out
}

/// The corners or the neighbours of each tetrahedron.
type Four = Vec<[u32; 4]>;

/// Returns the points with the corners of a box, and six tetrahedra that fill the box.
///
/// The tetrahedra share a diagonal of the box.
fn box_of(surfaces: &Surfaces) -> (Vec<[f32; 3]>, Four, Four) {
    let mut points = surfaces.points.clone();
    let fold =
        |i: usize, pick: fn(f32, f32) -> f32| points.iter().map(|p| p[i]).reduce(pick).unwrap();
    let size = (0..3)
        .map(|i| fold(i, f32::max) - fold(i, f32::min))
        .fold(0.0, f32::max);
    let min: [f32; 3] = std::array::from_fn(|i| fold(i, f32::min) - size * 0.25);
    let max: [f32; 3] = std::array::from_fn(|i| fold(i, f32::max) + size * 0.25);
    let n = points.len() as u32;
    for k in 0..8 {
        points.push(std::array::from_fn(|i| {
            if k >> i & 1 == 1 { max[i] } else { min[i] }
        }));
    }
    let tetrahedra: Vec<[u32; 4]> = [
        [0, 1, 2],
        [1, 2, 0],
        [2, 0, 1],
        [0, 2, 1],
        [2, 1, 0],
        [1, 0, 2],
    ]
    .map(|[a, b, _]: [u32; 3]| [n, n + (1 << a), n + (1 << a) + (1 << b), n + 7])
    .to_vec();
    let face = |t: &[u32; 4], k: usize| {
        let mut f: Vec<u32> = (0..4).filter(|j| *j != k).map(|j| t[j]).collect();
        f.sort_unstable();
        f
    };
    let beyond = |i: usize, k: usize| {
        let own = face(&tetrahedra[i], k);
        let is_other = |j: &usize| *j != i && (0..4).any(|l| face(&tetrahedra[*j], l) == own);
        (0..tetrahedra.len())
            .find(is_other)
            .map_or(NONE, |j| j as u32)
    };
    let neighbours = (0..tetrahedra.len())
        .map(|i| std::array::from_fn(|k| beyond(i, k)))
        .collect();
    (points, tetrahedra, neighbours)
}

fn built(surfaces: &Surfaces) -> (Cells, CellCounts) {
    let (points, tetrahedra, neighbours) = box_of(surfaces);
    let all = Tetrahedra {
        points: &points,
        tetrahedra: &tetrahedra,
        neighbours: &neighbours,
    };
    cells(surfaces, &all, &Quiet).unwrap()
}

/// Returns the result of the checker.
fn checked(surfaces: &Surfaces, cells: &Cells, windings: &[i32]) -> Result<(), Fault> {
    let (surfaces, cells) = (surfaces.view(), cells.view());
    check(&Contents {
        digest: DIGEST,
        surfaces,
        cells,
        windings,
        boxes: Boxes::default(),
    })
}

fn passes(triangles: &[[[f32; 3]; 3]]) -> (Cells, CellCounts) {
    let surfaces = surfaces(triangles);
    let (cells, counts) = built(&surfaces);
    let around = windings(surfaces.view(), cells.view());
    assert_eq!(checked(&surfaces, &cells, &around), Ok(()));
    (cells, counts)
}

#[test]
fn cells_do_not_depend_on_thread_count() {
    let surfaces = surfaces(&CROSS);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| built(&surfaces))
    };
    assert_eq!(on(1), on(3));
}

const CROSS: [[[f32; 3]; 3]; 3] = [
    [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
    [[1.0, 1.0, -2.0], [1.0, 1.0, 2.0], [3.0, 3.0, 1.0]],
    [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
];

#[test]
fn faces_cover_one_triangle() {
    let (cells, counts) = passes(&CROSS[..1]);
    assert!(counts.cut > 0 && cells.view().cell_count() > 6);
    assert!(cells.triangles.iter().all(|id| *id == 0));
}

#[test]
fn crossing_and_overlapping_triangles_pass_checker() {
    let (cells, _) = passes(&CROSS);
    // The large triangle covers every face that the small triangle covers.
    let both = (0..cells.view().face_count())
        .filter(|f| cells.view().face_triangles(*f) == [0, 2])
        .count();
    assert!(both > 0);
    assert!((0..cells.view().face_count()).all(|f| cells.view().face_triangles(f) != [2]));
}

#[test]
fn empty_scene_has_one_cell_per_tetrahedron() {
    let surfaces = surfaces(&[[[0.0; 3], [1.0; 3], [2.0, 0.0, 0.0]]]);
    let surfaces = Surfaces {
        triangles: vec![],
        flags: vec![],
        ..surfaces
    };
    let (cells, _) = built(&surfaces);
    assert_eq!(
        (cells.view().cell_count(), cells.view().face_count()),
        (6, 18)
    );
    let around = windings(surfaces.view(), cells.view());
    assert_eq!(checked(&surfaces, &cells, &around), Ok(()));
}

#[test]
fn triangles_in_tetrahedron_faces_divide_them() {
    // The diagonal plane x = y of a cube is a face of some of the six tetrahedra.
    let t = [[1.0, 1.0, 0.0], [3.0, 3.0, 1.0], [1.0, 1.0, 4.0]];
    let corner = |x: f32| [[x, x, x], [x + 0.5, x, x], [x, x + 0.5, x]];
    let (_, counts) = passes(&[t, corner(0.0), corner(4.0)]);
    assert!(counts.meetings > 0);
}

#[test]
fn hard_shapes_pass_checker() {
    passes(&schonhardt());
    passes(&saddle());
    for (scale, shift) in [(1.0f32, 0.0f32), (0.1, 100.0), (1e-20, 0.0), (1e18, -3e18)] {
        passes(&lattice_of_cubes(scale, shift));
    }
}

#[test]
fn speck_in_large_box_passes_checker() {
    let far = [[-1e7, -1e7, -1e7], [1e7, -1e7, -1e7], [0.0, 1e7, 1e7]];
    let e = 1e-6;
    let speck = [[[0.3, 0.3, 0.3], [0.3 + e, 0.3, 0.3], [0.3, 0.3 + e, 0.3]]];
    let tiny = [[1e-30, 0.0, 0.0], [0.0, 1e-30, 0.0], [0.0, 0.0, 1e-30]];
    passes(&[far, speck[0], tiny]);
}

#[test]
fn checker_finds_every_kind_of_fault() {
    let surfaces = surfaces(&CROSS);
    let (good, _) = built(&surfaces);
    let around = windings(surfaces.view(), good.view());
    let fails = |alter: &dyn Fn(&mut Cells)| {
        let mut cells = good.clone();
        alter(&mut cells);
        checked(&surfaces, &cells, &around).unwrap_err()
    };
    let inner = (0..good.view().face_count())
        .find(|f| !good.faces[*f].cells.contains(&NONE))
        .unwrap();
    let around_less = |at: usize| {
        let mut other = around.clone();
        other[at] -= 1;
        other
    };
    assert!(matches!(
        checked(&surfaces, &good, &around_less(0)),
        Err(Fault::Solids(_))
    ));
    // If a triangle belongs to a closed surface, the cells on both sides of it cannot both be outside.
    let mut closed = surfaces.clone();
    closed.flags[0] |= CLOSED;
    assert!(matches!(
        checked(&closed, &good, &around),
        Err(Fault::Solids(_))
    ));
    let covered = (0..good.view().face_count())
        .find(|f| good.view().face_triangles(*f) == [0])
        .unwrap();
    let start = |f: usize| good.faces[f].loop_start as usize;
    assert_eq!(fails(&|c| c.points[0][0] += 1.0), Fault::Points);
    assert!(matches!(
        fails(&|c| c.loops[0] = 1 << 30),
        Fault::Number { .. }
    ));
    assert!(matches!(
        fails(&|c| c.cells[1].faces_start = u32::MAX),
        Fault::Number { .. }
    ));
    assert!(matches!(
        fails(&|c| c.planes[0].0[1] = c.planes[0].0[0]),
        Fault::Plane(0)
    ));
    assert!(matches!(
        fails(&|c| c.meets[0][1] = c.meets[0][0]),
        Fault::Vertex(_)
    ));
    let farther = |by: f64| move |c: &mut Cells| c.rounded[0][1] += by;
    // The width of the box is below 16, so the bound is 16 · 2⁻⁴⁴.
    assert!(matches!(fails(&farther(3e-12)), Fault::Place(_)));
    assert!(matches!(fails(&farther(-3e-12)), Fault::Place(_)));
    assert!(matches!(
        fails(&|c| c.loops[start(inner)] = 0),
        Fault::OffPlane { .. } | Fault::NotConvex(_)
    ));
    assert!(matches!(
        fails(&|c| c.loops.swap(start(inner), start(inner) + 1)),
        Fault::NotConvex(_)
    ));
    assert!(matches!(
        fails(&|c| c.faces[inner].cells.swap(0, 1)),
        Fault::Sides(_)
    ));
    assert!(matches!(
        fails(&|c| c.faces[inner].cells[0] = NONE),
        Fault::Sides(_)
    ));
    assert!(matches!(
        fails(&|c| {
            // The loop is reversed, as if its cells were on the other sides.
            let (a, b) = (start(inner), c.faces[inner + 1].loop_start as usize);
            c.loops[a..b].reverse();
        }),
        Fault::NotConvex(_)
    ));
    assert!(matches!(
        fails(&|c| c.triangles[c.faces[covered].triangles_start as usize] = 1),
        Fault::NotOf { .. }
    ));
    assert!(matches!(
        fails(&|c| {
            let at = c.faces[covered].triangles_start as usize;
            c.triangles.remove(at);
            c.faces[covered + 1..]
                .iter_mut()
                .for_each(|f| f.triangles_start -= 1);
        }),
        Fault::NotCovered(_)
    ));
}

fn lattice() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3((0i8..5).prop_map(f32::from))
}

fn floats() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3(-1.0f32..1.0)
}

fn wide() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3((-4i8..5, -30i32..30).prop_map(|(m, e)| f32::from(m) * 2f32.powi(e)))
}

fn soup(
    point: impl Strategy<Value = [f32; 3]>,
    most: usize,
) -> impl Strategy<Value = Vec<[[f32; 3]; 3]>> {
    prop::collection::vec(prop::array::uniform3(point), 1..most)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn lattice_soups_pass_checker(triangles in soup(lattice(), 10)) {
        prop_assume!(triangles.iter().flatten().any(|p| *p != triangles[0][0]));
        passes(&triangles);
    }

    #[test]
    fn float_soups_pass_checker(triangles in soup(floats(), 8)) {
        passes(&triangles);
    }

    #[test]
    fn soups_with_wide_exponents_pass_checker(triangles in soup(wide(), 5)) {
        prop_assume!(triangles.iter().flatten().any(|p| *p != triangles[0][0]));
        passes(&triangles);
    }
}
