//! Tests that the checker rejects altered cells whose lists still agree with each other.

#![allow(clippy::unwrap_used, reason = "tests")]

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};
use sightline_tetra::cells::{CellRecord, Cells, FaceRecord, NONE};
use sightline_tetra::check::{Fault, check};
use sightline_tetra::file::Contents;
use sightline_tetra::{Built, Quiet, build};

/// A face with separate lists of its vertices and triangles.
#[derive(Clone)]
struct Face {
    plane: u32,
    vertices: Vec<u32>,
    triangles: Vec<u32>,
    cells: [u32; 2],
}

/// The faces, and the faces of each cell as the file lists them.
#[derive(Clone)]
struct Loose {
    faces: Vec<Face>,
    cells: Vec<Vec<u32>>,
}

impl Loose {
    fn from_cells(cells: &Cells) -> Self {
        let view = cells.view();
        let face = |f: usize| Face {
            plane: view.faces[f].plane,
            vertices: view.face_loop(f).to_vec(),
            triangles: view.face_triangles(f).to_vec(),
            cells: view.faces[f].cells,
        };
        Self {
            faces: (0..view.face_count()).map(face).collect(),
            cells: (0..view.cell_count())
                .map(|c| view.faces_of(c).to_vec())
                .collect(),
        }
    }

    /// Joins the lists to cells in file form. Points, planes and vertices are copied from `base`.
    fn joined(self, base: &Cells) -> Cells {
        let mut out = Cells {
            faces: vec![],
            loops: vec![],
            triangles: vec![],
            ..base.clone()
        };
        (out.cells, out.cell_faces) = (vec![], vec![]);
        let end = Face {
            plane: NONE,
            vertices: vec![],
            triangles: vec![],
            cells: [NONE; 2],
        };
        for face in self.faces.into_iter().chain([end]) {
            out.faces.push(FaceRecord {
                plane: face.plane,
                loop_start: out.loops.len() as u32,
                triangles_start: out.triangles.len() as u32,
                cells: face.cells,
            });
            out.loops.extend(face.vertices);
            out.triangles.extend(face.triangles);
        }
        for (k, faces) in (0..).zip(self.cells) {
            out.cells.push(CellRecord {
                tetrahedron: k,
                faces_start: out.cell_faces.len() as u32,
            });
            out.cell_faces.extend(faces);
        }
        out.cells.push(CellRecord {
            tetrahedron: NONE,
            faces_start: out.cell_faces.len() as u32,
        });
        out
    }

    /// Returns an inner face without triangles whose cells have at least the given number of faces.
    fn inner(&self, faces: usize) -> u32 {
        let fits = |f: &Face| {
            f.triangles.is_empty()
                && f.cells
                    .iter()
                    .all(|c| *c != NONE && self.cells[*c as usize].len() >= faces)
        };
        self.faces.iter().position(fits).unwrap() as u32
    }
}

fn world() -> Built {
    let triangles = [
        [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
        [[1.0, 1.0, -2.0], [1.0, 1.0, 2.0], [3.0, 3.0, 1.0]],
        [[0.5, 2.0, -1.0], [3.5, -1.0, 1.0], [2.0, 2.0, 3.0]],
    ];
    let triangles: Vec<Triangle> = triangles
        .map(|t| Triangle {
            v: t.map(Vec3::from_array),
        })
        .into_iter()
        .collect();
    let object = Object {
        name: "all".into(),
        first: 0,
        count: 3,
    };
    build(
        &Scene::new("test", triangles, vec![object]).unwrap(),
        &Quiet,
    )
    .unwrap()
}

/// Returns the fault that the checker reports for altered cells.
fn fault(built: &Built, alter: impl Fn(&mut Loose)) -> Fault {
    let mut loose = Loose::from_cells(&built.cells);
    alter(&mut loose);
    let windings = vec![0; loose.cells.len()];
    let cells = loose.joined(&built.cells);
    check(&Contents {
        cells: cells.view(),
        windings: &windings,
        ..built.contents()
    })
    .unwrap_err()
}

#[test]
fn separated_and_joined_lists_pass_checker() {
    let built = world();
    let cells = Loose::from_cells(&built.cells).joined(&built.cells);
    assert_eq!(
        check(&Contents {
            cells: cells.view(),
            ..built.contents()
        }),
        Ok(())
    );
}

#[test]
fn checker_rejects_cell_of_another_tetrahedron() {
    let built = world();
    let last = built.cells.view().cell_count();
    for (cell, tetrahedron) in [(0, 1), (7, 5_000_000), (last - 1, 0), (last, 0)] {
        let mut cells = built.cells.clone();
        cells.cells[cell].tetrahedron = tetrahedron;
        let found = check(&Contents {
            cells: cells.view(),
            ..built.contents()
        })
        .unwrap_err();
        assert!(
            matches!(
                found,
                Fault::Number {
                    list: "tetrahedra of cells",
                    ..
                }
            ),
            "{found:?}"
        );
    }
}

#[test]
fn checker_rejects_inner_face_with_one_cell() {
    let built = world();
    let face = Loose::from_cells(&built.cells).inner(5);
    let found = fault(&built, |all| {
        let behind = all.faces[face as usize].cells[1];
        all.faces[face as usize].cells[1] = NONE;
        all.cells[behind as usize].retain(|f| f / 2 != face);
    });
    assert_eq!(found, Fault::Border(face));
}

#[test]
fn checker_rejects_cells_on_wrong_sides_of_face() {
    let built = world();
    let face = Loose::from_cells(&built.cells).inner(4);
    let found = fault(&built, |all| {
        for cell in all.faces[face as usize].cells {
            all.cells[cell as usize]
                .iter_mut()
                .filter(|f| **f / 2 == face)
                .for_each(|f| *f ^= 1);
        }
        all.faces[face as usize].cells.swap(0, 1);
    });
    assert!(
        matches!(found, Fault::Beyond { face: at, .. } if at == face),
        "{found:?}"
    );
}

#[test]
fn checker_rejects_cell_without_inside() {
    let built = world();
    // Two faces of one plane are duplicated. The new cell is between each face and its copy.
    let all = Loose::from_cells(&built.cells);
    let inner = |f: &Face| f.cells.iter().all(|c| *c != NONE);
    let pair = (0..all.faces.len()).find_map(|f| {
        let other = (f + 1..all.faces.len()).find(|g| all.faces[*g].plane == all.faces[f].plane)?;
        (inner(&all.faces[f]) && inner(&all.faces[other])).then_some([f, other])
    });
    let cell = all.cells.len() as u32;
    let found = fault(&built, |all| {
        let mut own = Vec::new();
        for face in pair.unwrap() {
            let copy = all.faces.len() as u32;
            let behind = all.faces[face].cells[1];
            all.faces[face].cells[1] = cell;
            all.faces.push(Face {
                triangles: vec![],
                cells: [cell, behind],
                ..all.faces[face].clone()
            });
            let listed = all.cells[behind as usize]
                .iter_mut()
                .find(|f| **f == face as u32 * 2 + 1);
            *listed.unwrap() = copy * 2 + 1;
            own.extend([face as u32 * 2 + 1, copy * 2]);
        }
        all.cells.push(own);
    });
    assert_eq!(found, Fault::Flat(cell));
}

#[test]
fn checker_rejects_hole_between_cells() {
    let built = world();
    let face = Loose::from_cells(&built.cells).inner(5);
    let cells = Loose::from_cells(&built.cells).faces[face as usize].cells;
    let found = fault(&built, |all| {
        all.faces.remove(face as usize);
        for faces in &mut all.cells {
            faces.retain(|f| f / 2 != face);
            faces
                .iter_mut()
                .filter(|f| **f / 2 > face)
                .for_each(|f| *f -= 2);
        }
    });
    assert!(
        matches!(found, Fault::Open(cell) if cells.contains(&cell)),
        "{found:?}"
    );
}

#[test]
fn checker_rejects_cells_that_fill_box_twice() {
    let built = world();
    let found = fault(&built, |all| {
        let (faces, cells) = (all.faces.len() as u32, all.cells.len() as u32);
        let moved = |c: u32| if c == NONE { NONE } else { c + cells };
        let copies: Vec<Face> = all
            .faces
            .iter()
            .map(|f| Face {
                cells: f.cells.map(moved),
                ..f.clone()
            })
            .collect();
        all.faces.extend(copies);
        let copies: Vec<Vec<u32>> = all
            .cells
            .iter()
            .map(|listed| listed.iter().map(|f| f + 2 * faces).collect())
            .collect();
        all.cells.extend(copies);
    });
    assert_eq!(found, Fault::Volume);
}
