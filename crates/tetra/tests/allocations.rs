//! A test that queries allocate memory only for integers after the first query.
//!
//! The file contains one test, because it counts the allocations of the whole process.
#![allow(clippy::unwrap_used, unsafe_code, reason = "a test of the allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};
use sightline_tetra::file::write;
use sightline_tetra::{Engine, Mode, Quiet, Scratch, Target, Tets, View, build};

struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: every call is handed to the system's allocator unchanged; counting touches no memory of the
// caller's.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Relaxed);
        // SAFETY: the caller keeps `alloc`'s contract, which is the system's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        // SAFETY: `p` came from `alloc` above with this layout.
        unsafe { System.dealloc(p, layout) }
    }
}

/// Runs every query twice, and checks the allocations of the second run.
///
/// Returns the number of signs that needed integers in the second runs.
fn check(triangles: Vec<Triangle>, x: [f64; 3], with_box: bool) -> u64 {
    let count = triangles.len() as u32;
    let object = Object {
        name: "all".into(),
        first: 0,
        count,
    };
    let built = build(
        &Scene::new("test", triangles, vec![object]).unwrap(),
        &Quiet,
    )
    .unwrap();
    let mut file = Vec::new();
    write(&mut file, &built.contents()).unwrap();
    let tets = Tets::from_bytes(&file).unwrap();
    let mut scratch = Scratch::default();
    let target = Target {
        low: [1.0; 3],
        high: [2.0; 3],
    };
    let mut all = 0;
    for engine in [Engine::Boxes, Engine::Cells] {
        for mode in [
            Mode::Exact,
            Mode::Aggressive(0.01),
            Mode::Conservative(0.01),
        ] {
            let view = View {
                engine,
                witnesses: true,
                ..View::default()
            };
            let mut ask = || {
                let mut of_box = 0;
                if with_box {
                    tets.sees_in(x, &target, &view, mode, &mut scratch).unwrap();
                    of_box = scratch.seen.integers;
                }
                tets.locate(x, None).unwrap();
                tets.inside(x, &mut scratch).unwrap();
                of_box + tets.look(x, &view, mode, &mut scratch).unwrap().integers
            };
            ask();
            let before = COUNT.load(Relaxed);
            let integers = ask();
            let allocated = COUNT.load(Relaxed) - before;
            // The sign of a determinant in integers needs dozens of allocations.
            assert!(
                allocated as u64 <= 200 * integers,
                "{engine:?} {mode:?}: {allocated}, {integers} integers"
            );
            all += integers;
        }
    }
    all
}

#[test]
fn repeated_queries_allocate_only_integers() {
    let mut state = 1u32;
    let mut unit = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut point = |size: f32| Vec3::new(unit(), unit(), unit()) * size;
    let scattered = |_| {
        let at = point(10.0);
        Triangle {
            v: [at, at + point(2.0), at + point(2.0)],
        }
    };
    check((0..120).map(scattered).collect(), [5.1, 4.9, 5.3], true);
    // These triangles are apart from each other, and there is no box whose sides are sides of octants. So
    // doubles decide every sign.
    let apart = |k: u32| {
        let at = Vec3::new(0.3 * (k % 5) as f32, 3.0 + k as f32, 1.7 * (k % 3) as f32);
        Triangle {
            v: [
                at,
                at + Vec3::new(0.11, 0.02, 0.0),
                at + Vec3::new(0.0, 0.03, 0.13),
            ],
        }
    };
    assert_eq!(
        check((0..15).map(apart).collect(), [0.1, 0.2, 0.3], false),
        0
    );
}
