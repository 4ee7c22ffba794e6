//! Tests of the sections of version 2: contents round-trip and damage is rejected. Files without these
//! sections have version 1, and a stored file of version 1 stays readable.
// Helpers of tests may unwrap as tests do. The exception in clippy's configuration covers only test
// functions.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use sightline_pvs::{
    Builder, CellPairs, CellTree, Contribution, Granularity, Header, Items, Node, Object, Pvs,
    PvsError, Relation, Source,
};

/// Creates a tree that halves a box `levels` times along the axes in turn.
fn tree(levels: u32) -> CellTree {
    fn nodes(lo: [f32; 3], hi: [f32; 3], left: u32, out: &mut Vec<Node>) {
        if left == 0 {
            out.push(Node::Leaf);
            return;
        }
        let a = (left % 3) as usize;
        let at = f32::midpoint(lo[a], hi[a]);
        out.push(Node::Split { axis: a as u8, at });
        let (mut below, mut above) = (hi, lo);
        (below[a], above[a]) = (at, at);
        nodes(lo, below, left - 1, out);
        nodes(above, hi, left - 1, out);
    }
    let mut out = Vec::new();
    nodes([0.0; 3], [8.0; 3], levels, &mut out);
    CellTree::new([[0.0; 3], [8.0; 3]], out).unwrap()
}

fn builder(levels: u32, sources: bool) -> Builder {
    let source = |node| {
        let instance = (node == 2).then_some(7);
        sources.then_some(Source {
            node,
            mesh: node + 1,
            primitive: 0,
            instance,
        })
    };
    let object = |i: u32, first, count| Object {
        name: format!("part {i}"),
        first,
        count,
        source: source(i),
    };
    let objects = vec![object(0, 0, 4), object(1, 4, 0), object(2, 4, 6)];
    let (method, info_json) = ("aggressive".into(), "{}".into());
    Builder::new(Header {
        triangles: 10,
        method,
        tree: tree(levels),
        objects,
        info_json,
    })
    .unwrap()
}

fn finished(builder: Builder) -> Vec<u8> {
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    file
}

fn relation(cells: u32, pairs: &[(u32, u32)]) -> Relation {
    let mut relation = Relation::empty(cells).unwrap();
    (0..cells).for_each(|c| relation.insert(c, c));
    pairs
        .iter()
        .for_each(|(a, b)| relation.insert(a % cells, b % cells));
    relation
}

/// Creates a file of two cells with all sections.
fn full(items: &Items) -> Vec<u8> {
    let mut b = builder(1, true);
    b.set_items(items).unwrap();
    b.push_cell(&[0, 2], &[2], 0).unwrap();
    b.push_cell(&[1], &[], 0).unwrap();
    b.push_contributions(&[Contribution::new(0.25, 0.5), Contribution::new(0.0, 0.0)])
        .unwrap();
    b.push_contributions(&[Contribution::new(0.001, 1.0)])
        .unwrap();
    let visible = relation(2, &[(0, 1)]);
    let mut undecided = Relation::empty(2).unwrap();
    undecided.insert(0, 1);
    b.set_pairs(&CellPairs {
        visible,
        undecided: Some(undecided),
    })
    .unwrap();
    finished(b)
}

fn clusters() -> Items {
    Items::Clusters(vec![vec![0, 3], vec![1], vec![4, 5, 9]])
}

fn ids(f: impl FnOnce(&mut Vec<u32>) -> Result<(), PvsError>) -> Vec<u32> {
    let mut ids = vec![99];
    f(&mut ids).unwrap();
    ids
}

#[test]
fn clusters_and_objects_round_trip_as_items_and_triangles() {
    let pvs = Pvs::from_bytes(full(&clusters())).unwrap();
    assert_eq!(
        (pvs.granularity(), pvs.item_count()),
        (Granularity::Clusters, 3)
    );
    assert_eq!(ids(|v| pvs.visible_items(0, v)), [0, 2]);
    assert_eq!(ids(|v| pvs.visible(0, v)), [0, 3, 4, 5, 9]);
    assert_eq!(ids(|v| pvs.undecided(0, v)), [4, 5, 9]);
    assert_eq!(ids(|v| pvs.visible_objects(0, v)), [0, 2]);
    assert_eq!(ids(|v| pvs.visible(1, v)), [1]);
    let mut runs = Vec::new();
    pvs.visible_runs(0, &mut runs).unwrap();
    assert_eq!(runs, [0..1, 3..6, 9..10]);
    let mut bits = [0];
    pvs.visible_bits(0, &mut bits).unwrap();
    assert_eq!(bits, [0b10_0011_1001]);
    let mut triangles = Vec::new();
    pvs.item_triangles(2, &mut triangles);
    assert_eq!(triangles, [4, 5, 9]);
    pvs.item_triangles(3, &mut triangles);
    assert!(triangles.is_empty());

    let pvs = Pvs::from_bytes(full(&Items::Objects { never: vec![1, 9] })).unwrap();
    assert_eq!(
        (pvs.granularity(), pvs.item_count()),
        (Granularity::Objects, 3)
    );
    assert_eq!(ids(|v| pvs.visible_objects(0, v)), [0, 2]);
    assert_eq!(ids(|v| pvs.visible(0, v)), [0, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(
        ids(|v| pvs.visible(1, v)),
        [0u32; 0],
        "an object without triangles"
    );
}

#[test]
fn contributions_pairs_and_sources_round_trip() {
    let pvs = Pvs::from_bytes(full(&clusters())).unwrap();
    let contributions = pvs.contributions(0).unwrap().unwrap();
    assert!(
        contributions[0].mean()[0] <= 0.25
            && 0.25 <= contributions[0].mean()[1]
            && contributions[1].mean() == [0.0, 0.0]
    );
    assert!(pvs.sees(0, 1).unwrap() && pvs.sees(1, 1).unwrap());
    assert!(
        pvs.cell_pairs()
            .unwrap()
            .unwrap()
            .undecided
            .as_ref()
            .unwrap()
            .has(1, 0)
    );
    assert!(matches!(pvs.sees(0, 2), Err(PvsError::NoCell { .. })));
    let source = pvs.objects()[2].source.unwrap();
    assert_eq!(
        (source.node, source.mesh, source.primitive, source.instance),
        (2, 3, 0, Some(7))
    );
    assert_eq!(pvs.objects()[0].source.unwrap().instance, None);
    // This file has none of these sections.
    let mut b = builder(1, false);
    b.push_cell(&[0], &[], 0).unwrap();
    b.push_cell(&[], &[], sightline_pvs::NOT_REACHED).unwrap();
    let file = finished(b);
    assert_eq!(file[8], 1, "nothing in it is newer than version 1");
    let pvs = Pvs::from_bytes(file).unwrap();
    assert!(matches!(pvs.sees(0, 1), Err(PvsError::NoPairs)));
    assert!(pvs.contributions(0).unwrap().is_none() && pvs.objects()[0].source.is_none());
    assert!(pvs.is_reached(0).unwrap() && !pvs.is_reached(1).unwrap());
}

#[test]
fn cells_without_viewpoints_count_as_visible() {
    let mut b = builder(1, false);
    b.set_pairs(&CellPairs {
        visible: relation(2, &[(0, 0), (1, 1)]),
        undecided: None,
    })
    .unwrap();
    b.push_cell(&[], &[], sightline_pvs::NOT_REACHED).unwrap();
    b.push_cell(&[0], &[], 0).unwrap();
    let pvs = Pvs::from_bytes(finished(b)).unwrap();
    let [lo, hi] = pvs.cell_bounds(0).unwrap();
    // Cell 1 has viewpoints, so it is known that it does not see cell 0.
    assert!(!pvs.sees(0, 1).unwrap() && pvs.sees(0, 0).unwrap());
    let middle = [0, 1, 2].map(|k| 0.5 * (lo[k] + hi[k]));
    assert!(!pvs.sees_box(1, middle, middle).unwrap());
    assert!(pvs.sees_box(0, middle, middle).unwrap());
}

#[test]
fn rejects_contradictory_input() {
    let mut b = builder(1, false);
    assert!(b.push_cell(&[0], &[], sightline_pvs::NOT_REACHED).is_err());
    assert!(b.set_items(&Items::Clusters(vec![vec![3, 1]])).is_err());
    assert!(b.set_items(&Items::Clusters(vec![vec![10]])).is_err());
    assert!(
        b.set_pairs(&CellPairs {
            visible: relation(3, &[]),
            undecided: None
        })
        .is_err()
    );
    for (cells, why) in [
        (3, "different numbers of cells"),
        (2, "undecided and not visible"),
    ] {
        let undecided = Some(relation(cells, &[(0, 1)]));
        let error = b
            .set_pairs(&CellPairs {
                visible: relation(2, &[]),
                undecided,
            })
            .unwrap_err();
        assert!(error.to_string().contains(why), "{error}");
    }
    b.set_items(&clusters()).unwrap();
    assert!(
        b.push_cell(&[3], &[], 0)
            .unwrap_err()
            .to_string()
            .contains("no item 3")
    );
    b.push_cell(&[0], &[], 0).unwrap();
    assert!(b.set_items(&clusters()).is_err());
    // These two clusters share a triangle.
    let shared = Items::Clusters(vec![vec![0, 3], vec![3], vec![4]]);
    assert!(Pvs::from_bytes(full(&shared)).is_err());
}

#[test]
fn rejects_every_altered_byte_and_truncation() {
    for file in [full(&clusters()), full(&Items::Objects { never: vec![0] })] {
        for at in 0..file.len() {
            for flip in [0x01, 0x0f, 0x80, 0xff] {
                let mut altered = file.clone();
                altered[at] ^= flip;
                assert!(
                    Pvs::from_bytes(altered).is_err(),
                    "byte {at} changed by {flip:#x}"
                );
            }
            assert!(Pvs::from_bytes(&file[..at]).is_err());
        }
    }
}

#[test]
fn reads_stored_file_of_version_1() {
    let pvs = Pvs::from_bytes(&include_bytes!("data/tiny-version-1.pvs")[..]).unwrap();
    assert_eq!(
        (pvs.cells(), pvs.triangle_count(), pvs.method()),
        (2, 5, "aggressive")
    );
    assert_eq!(
        [0, 1].map(|c| ids(|v| pvs.visible(c, v))),
        [vec![0, 1, 3, 4], vec![2, 3, 4]]
    );
    assert_eq!(ids(|v| pvs.visible_objects(1, v)), [1, 2]);
    assert_eq!(pvs.granularity(), Granularity::Triangles);
    let names: Vec<&str> = pvs.objects().iter().map(|o| o.name.as_str()).collect();
    assert_eq!(names, ["floor", "far", "wall"]);
    assert_eq!(pvs.cell_bounds(1), Some([[0.0, 0.0, 4.0], [4.0, 4.0, 8.0]]));
    assert_eq!(pvs.columns().unwrap()[0].values, [15936, 15936]);
}

proptest! {
    #[test]
    fn box_is_visible_if_cell_that_it_meets_is(
        levels in 1u32..9,
        pairs in proptest::collection::vec((any::<u32>(), any::<u32>()), 0..60),
        cell in any::<u32>(),
        corners in [[0u8..33, 0u8..33], [0u8..33, 0u8..33], [0u8..33, 0u8..33]],
    ) {
        let cells = 1 << levels;
        let mut b = builder(levels, false);
        (0..cells).for_each(|_| b.push_cell(&[], &[], 0).unwrap());
        let visible = relation(cells, &pairs);
        b.set_pairs(&CellPairs { visible: visible.clone(), undecided: None }).unwrap();
        let pvs = Pvs::from_bytes(finished(b)).unwrap();
        let cell = cell % cells;
        // The corners are multiples of a quarter, so that boxes end on planes.
        let [lo, hi]: [[f32; 3]; 2] = [0, 1].map(|k| {
            corners.map(|c| f32::from(if k == 0 { c[0].min(c[1]) } else { c[0].max(c[1]) }) / 4.0)
        });
        let seen = pvs.sees_box(cell, lo, hi).unwrap();
        if hi.iter().any(|c| *c > 8.0) {
            prop_assert!(seen, "nothing is known of places outside");
        } else {
            let meets = |b: u32| {
                let [min, max] = pvs.cell_bounds(b).unwrap();
                (0..3).all(|a| lo[a] <= max[a] && min[a] <= hi[a])
            };
            let expected = (0..cells).any(|b| meets(b) && visible.has(cell, b));
            prop_assert_eq!(seen, expected);
        }
        prop_assert!(pvs.sees_box(cell, [f32::NAN; 3], hi).unwrap());
    }
}
