//! Tests of the file format: files are read as they were written, and altered files are rejected.

#![allow(clippy::unwrap_used, reason = "tests")]

use proptest::prelude::*;
use sightline_tetra::cells::{NONE, Tetrahedra, cells};
use sightline_tetra::file::{Layout, Section, TetsError, write};
use sightline_tetra::point_query::Hierarchy;
use sightline_tetra::surfaces::{BLOCKS, SHOWS, Surfaces};
use sightline_tetra::windings::windings;
use sightline_tetra::{Built, Quiet, Tets};

const DIGEST: [u8; 32] = [5; 32];

/// Builds one triangle in a box of five tetrahedra.
fn built() -> Built {
    let surfaces = Surfaces {
        points: vec![[0.25, 0.25, 0.25], [0.75, 0.25, 0.5], [0.25, 0.75, 0.75]],
        triangles: vec![[0, 1, 2]],
        flags: vec![BLOCKS | SHOWS],
    };
    let mut points = surfaces.points.clone();
    points.extend((0..8).map(|k| [0, 1, 2].map(|i| (k >> i & 1) as f32)));
    let tetrahedra = [
        [3, 4, 5, 7],
        [6, 4, 5, 10],
        [8, 4, 7, 10],
        [9, 5, 7, 10],
        [4, 5, 7, 10],
    ];
    let inner = 4;
    let neighbours = [
        [inner, NONE, NONE, NONE],
        [inner, NONE, NONE, NONE],
        [inner, NONE, NONE, NONE],
        [inner, NONE, NONE, NONE],
        [3, 2, 1, 0],
    ];
    let all = Tetrahedra {
        points: &points,
        tetrahedra: &tetrahedra,
        neighbours: &neighbours,
    };
    let (cells, counts) = cells(&surfaces, &all, &Quiet).unwrap();
    assert!(counts.cut > 0);
    let windings = windings(surfaces.view(), cells.view());
    let hierarchy = Hierarchy::new(surfaces.view());
    Built {
        digest: DIGEST,
        surfaces,
        cells,
        windings,
        hierarchy,
        tetrahedra: 5,
        counts,
    }
}

fn bytes(built: &Built) -> Vec<u8> {
    let mut out = Vec::new();
    write(&mut out, &built.contents()).unwrap();
    out
}

#[test]
fn file_round_trip_keeps_contents() {
    let built = built();
    let file = bytes(&built);
    assert_eq!(
        Tets::from_bytes(&file).unwrap().contents(),
        built.contents()
    );
    let layout = Layout::parse(&file).unwrap();
    assert!(
        Section::ALL
            .iter()
            .all(|s| layout.range(*s).start.is_multiple_of(8))
    );
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.tets");
    std::fs::write(&path, &file).unwrap();
    let opened = Tets::open(&path).unwrap();
    assert_eq!(opened.contents(), built.contents());
    // A mapped file would end this process with SIGBUS at the next access.
    std::fs::File::create(&path).unwrap();
    assert_eq!(opened.contents(), built.contents());
    assert!(matches!(Tets::open(&path), Err(TetsError::NotTets)));
    assert!(matches!(
        Tets::open(directory.path().join("b").as_path()),
        Err(TetsError::Open { .. })
    ));
}

#[test]
fn rejects_every_cut_and_every_altered_byte() {
    let file = bytes(&built());
    for end in 0..file.len() {
        let error = Tets::from_bytes(&file[..end]).unwrap_err();
        let is_told = if end == 0 {
            matches!(error, TetsError::NotTets)
        } else {
            matches!(error, TetsError::CutShort { .. })
        };
        assert!(is_told, "{end}: {error}");
    }
    for at in 0..file.len() {
        let mut altered = file.clone();
        altered[at] ^= 0x10;
        assert!(Tets::from_bytes(&altered).is_err(), "byte {at}");
    }
}

#[test]
fn rejects_file_of_another_scene() {
    let built = built();
    built.contents().expect_scene(&DIGEST).unwrap();
    let error = built.contents().expect_scene(&[6; 32]).unwrap_err();
    assert!(error.to_string().contains("another scene"), "{error}");
}

proptest! {
    /// Alters words under a right checksum: the file is rejected, or all its indices are in range.
    #[test]
    fn tampered_numbers_are_rejected_or_harmless(
        list in 0usize..10, at in any::<prop::sample::Index>(), to in any::<u32>(),
    ) {
        let mut built = built();
        let c = &mut built.cells;
        match list {
            0 => { let i = at.index(c.loops.len()); c.loops[i] = to }
            1 => { let i = at.index(c.faces.len()); c.faces[i].loop_start = to }
            2 => { let i = at.index(c.cells.len()); c.cells[i].faces_start = to }
            3 => { let i = at.index(c.planes.len()); c.planes[i].0[i % 3] = to }
            4 => { let i = at.index(c.cell_faces.len()); c.cell_faces[i] = to }
            5 => { let i = at.index(c.faces.len()); c.faces[i].cells[i % 2] = to }
            6 => { let i = at.index(built.hierarchy.nodes.len()); built.hierarchy.nodes[i].first = to }
            7 => { let i = at.index(built.hierarchy.nodes.len()); built.hierarchy.nodes[i].count = to }
            8 => { let i = at.index(built.hierarchy.order.len()); built.hierarchy.order[i] = to }
            _ => { let i = at.index(built.windings.len()); built.windings[i] = to as i32 }
        }
        if let Ok(read) = Tets::from_bytes(&bytes(&built)) {
            // The checker may report any fault but must not panic.
            let contents = read.contents();
            let _ = sightline_tetra::check::check(&contents);
            for f in 0..contents.cells.face_count() {
                contents.cells.face_loop(f).iter().for_each(|v| { contents.cells.place(*v); });
            }
        }
    }
}
