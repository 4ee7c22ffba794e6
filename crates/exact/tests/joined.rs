//! Occluder fusion: proofs for triangles behind curved surfaces do not grow with the number of facets.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, which may"
)]

mod common;

use common::{Draft, exact};
use sightline_exact::{Polygon, Verdict};

/// Places a sphere between two squares that are so much smaller that all lines pass its middle.
///
/// Facets are wider than the squares at first, then far smaller, and none of the small facets blocks much by
/// itself.
#[test]
fn proof_of_finer_sphere_needs_no_more_steps() {
    for place in exact() {
        let steps: Vec<usize> = (0..4)
            .map(|levels| {
                let mut scene = Draft::new(&place);
                scene.sphere([0.0, 0.0, 0.0], 1.0, levels);
                let world = scene.done();
                let square = |z| Polygon::checked(&place.square([0.0, 0.0, z], 0.5)).unwrap();
                match world.verdict(&square(-2.0), &square(2.0)).unwrap() {
                    Verdict::Hidden(proof) => proof.steps.len(),
                    other => panic!("{other:?}"),
                }
            })
            .collect();
        // The finest sphere has 1280 facets, half of which face in either direction.
        assert!(steps.iter().all(|s| *s <= 4), "{steps:?}");
    }
}
