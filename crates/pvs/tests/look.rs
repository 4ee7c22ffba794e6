//! Tests of point queries through portals: doors, views that are not valid, damaged sections, and the absence
//! of allocations.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    unsafe_code,
    reason = "a test, with an allocator that counts"
)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use proptest::prelude::*;
use sightline_pvs::portals::{LEAF, NONE};
use sightline_pvs::{
    Builder, CellTree, Header, LookError, Looker, Node, Object, Portal, Portals, Pvs, View,
    ViewError,
};

struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: all calls go to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller fulfils the contract of this function, which is the same.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller fulfils the contract of this function, which is the same.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Creates four rooms at x = 0, 1, 2 and 3 with sides of 1. Each room contains one triangle, and neighbours
/// have an opening of half a side between them. The second opening has a door.
fn portals() -> Portals {
    let opening = |x: u32, door: u32| Portal {
        leaves: [x - 1, x],
        plane: x - 1,
        door,
        corners: [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]]
            .map(|[y, z]| [f64::from(x), y, z])
            .to_vec(),
    };
    Portals {
        size: 4.0,
        planes: (1..4).map(|x| [1.0, 0.0, 0.0, f64::from(x)]).collect(),
        nodes: vec![[1, 1, 2], [0, LEAF, LEAF + 1], [2, LEAF + 2, LEAF + 3]],
        doors: vec!["front".into()],
        portals: vec![opening(1, NONE), opening(2, 0), opening(3, NONE)],
        leaves: (0..4).map(|id| vec![id]).collect(),
    }
}

fn result(portals: &Portals) -> Pvs {
    let tree = CellTree::new([[0.0; 3], [4.0, 1.0, 1.0]], vec![Node::Leaf]).unwrap();
    let objects = vec![Object {
        name: "all".into(),
        first: 0,
        count: 4,
        source: None,
    }];
    let header = Header {
        triangles: 4,
        method: "portals".into(),
        tree,
        objects,
        info_json: "{}".into(),
    };
    let mut builder = Builder::new(header).unwrap();
    builder.set_portals(portals.encode()).unwrap();
    builder.push_cell(&[0, 1, 2, 3], &[], 0).unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    Pvs::from_bytes(file).unwrap()
}

fn view(eye: [f64; 3], direction: [f64; 3]) -> View {
    View {
        eye,
        direction,
        up: [0.0, 0.0, 1.0],
        fov: [90.0, 60.0],
    }
}

#[test]
fn doors_and_views_determine_visible_triangles() {
    let pvs = result(&portals());
    let mut looker = Looker::new(&pvs).unwrap().unwrap();
    let mut seen = |eye, direction, shut| {
        looker.shut(0, shut);
        assert_eq!(looker.look(&view(eye, direction)).unwrap(), Some(0));
        looker.visible().to_vec()
    };
    let (eye, ahead) = ([0.5, 0.25, 0.25], [1.0, 0.0, 0.0]);
    assert_eq!(seen(eye, ahead, false), [0, 1, 2, 3]);
    assert_eq!(seen(eye, ahead, true), [0, 1]);
    assert_eq!(seen(eye, [-1.0, 0.0, 0.0], false), [0]);
    // The eye is next to the opening, so the next opening is out of sight.
    assert_eq!(seen([0.9, 0.95, 0.25], [1.0, -2.0, 0.0], false), [0, 1]);
    // The eye is in the plane of an opening, so it is in both rooms. A glance along the plane shows both.
    assert_eq!(seen([2.0, 0.25, 0.25], [0.0, 1.0, 0.0], true), [1, 2]);
    assert_eq!(looker.look(&view([9.0, 0.0, 0.0], ahead)).unwrap(), None);
    let mut bad = |view: View| match looker.look(&view) {
        Err(LookError::View(e)) => e,
        other => panic!("{other:?}"),
    };
    assert_eq!(bad(view([f64::NAN; 3], ahead)), ViewError::Eye);
    assert_eq!(bad(view(eye, [0.0; 3])), ViewError::Directions);
    assert_eq!(bad(view(eye, [0.0, 0.0, -3.0])), ViewError::Directions);
    assert_eq!(
        bad(View {
            fov: [180.0, 60.0],
            ..view(eye, ahead)
        }),
        ViewError::Angles
    );
}

#[test]
fn look_allocates_nothing() {
    let pvs = result(&portals());
    let mut looker = Looker::new(&pvs).unwrap().unwrap();
    let first = view([0.5, 0.25, 0.25], [1.0, 0.0, 0.0]);
    looker.look(&first).unwrap();
    let before = COUNT.with(Cell::get);
    for k in 0..100 {
        looker.shut(0, k % 2 == 0);
        looker
            .look(&view([0.03 * f64::from(k), 0.25, 0.25], [1.0, 0.3, 0.1]))
            .unwrap();
    }
    assert_eq!(COUNT.with(Cell::get), before);
}

#[test]
fn result_without_portals_has_no_looker() {
    let tree = CellTree::new([[0.0; 3], [4.0, 1.0, 1.0]], vec![Node::Leaf]).unwrap();
    let objects = vec![Object {
        name: "all".into(),
        first: 0,
        count: 4,
        source: None,
    }];
    let header = Header {
        triangles: 4,
        method: "exact".into(),
        tree,
        objects,
        info_json: "{}".into(),
    };
    let mut builder = Builder::new(header).unwrap();
    builder.push_cell(&[0, 1, 2, 3], &[], 0).unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    assert!(
        Looker::new(&Pvs::from_bytes(file).unwrap())
            .unwrap()
            .is_none()
    );
}

proptest! {
    #[test]
    fn damaged_portals_are_rejected_or_harmless(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let good = portals().encode();
        prop_assert_eq!(Portals::decode(&good, 4).unwrap(), portals());
        prop_assert!(Portals::decode(&good[..cut.index(good.len())], 4).is_err());
        let mut bytes = good;
        for (at, with) in changes {
            let at = at.index(bytes.len());
            bytes[at] = with;
        }
        if let Ok(read) = Portals::decode(&bytes, 4) {
            let pvs = result(&read);
            let mut looker = Looker::new(&pvs).unwrap().unwrap();
            for x in 0..8 {
                let at = view([0.5 * f64::from(x), 0.25, 0.25], [1.0, 0.1, 0.0]);
                prop_assert_eq!(looker.look(&at).unwrap(), Some(0));
            }
        }
    }
}
