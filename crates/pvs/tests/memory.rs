//! Tests of the memory that reading a result needs. The memory depends on the size of the file and not on the
//! counts in its header.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use sightline_pvs::{Builder, CellTree, Contribution, Header, Items, Node, Object, Pvs, PvsError};

/// The system's allocator, with counters of the bytes in use and of their maximum.
struct Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

#[allow(unsafe_code, reason = "an allocator is unsafe")]
// SAFETY: all calls go to the system's allocator, unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = IN_USE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(now, Ordering::Relaxed);
        // SAFETY: the caller fulfils the contract of this function, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller fulfils the contract of this function, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the maximum number of bytes that a function uses at once, in addition to the bytes in use before.
fn most_bytes(work: impl FnOnce()) -> usize {
    let before = IN_USE.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    work();
    MOST.load(Ordering::Relaxed) - before
}

const TRIANGLES: u32 = 4_000_000_000;
const SOME: usize = 64 << 10;

fn header() -> Header {
    let tree = CellTree::new([[0.0; 3], [1.0; 3]], vec![Node::Leaf]).unwrap();
    let object = Object {
        name: "all".into(),
        first: 0,
        count: TRIANGLES,
        source: None,
    };
    let (method, info_json) = ("aggressive".into(), "{}".into());
    Header {
        triangles: TRIANGLES,
        method,
        tree,
        objects: vec![object],
        info_json,
    }
}

/// Opens a file and reads all contents that need no list of ids.
fn read(file: &[u8]) -> Result<(u32, Vec<u32>), PvsError> {
    let pvs = Pvs::from_bytes(file.to_vec())?;
    let mut objects = Vec::new();
    pvs.visible_objects(0, &mut objects)?;
    pvs.undecided_objects(0, &mut objects)?;
    pvs.contributions(0)?;
    let mut runs = Vec::new();
    pvs.visible_runs(0, &mut runs)?;
    pvs.undecided_count(0)?;
    Ok((pvs.visible_count(0)?, pvs.visible_bounds(0)?))
}

/// Tests all cases in one function, because the whole process shares the counters.
#[test]
fn memory_follows_bytes_of_file() {
    // This file has all triangles of an object.
    let mut builder = Builder::new(header()).unwrap();
    builder
        .set_items(&Items::Objects { never: vec![7] })
        .unwrap();
    builder.push_cell(&[0], &[0], 0).unwrap();
    builder
        .push_contributions(&[Contribution::new(0.5, 0.5)])
        .unwrap();
    let mut objects = Vec::new();
    builder.finish(&mut objects).unwrap();
    // This file has a few triangles.
    let mut builder = Builder::new(header()).unwrap();
    builder.push_cell(&[5, 6, TRIANGLES - 1], &[6], 0).unwrap();
    let mut triangles = Vec::new();
    builder.finish(&mut triangles).unwrap();
    for (file, count, bounds) in [
        (objects, TRIANGLES - 1, vec![0, 7, 8, TRIANGLES]),
        (triangles, 3, vec![5, 7, TRIANGLES - 1, TRIANGLES]),
    ] {
        assert!(file.len() < 1000, "{} bytes", file.len());
        let mut found = None;
        let most = most_bytes(|| found = Some(read(&file).unwrap()));
        assert_eq!(found.unwrap(), (count, bounds));
        assert!(most < SOME, "reading {} bytes took {most}", file.len());
    }
}
