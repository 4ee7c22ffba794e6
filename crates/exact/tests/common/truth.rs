//! Assertions on scenes whose visibility is known by construction.

use glam::DVec3;

use super::{Draft, Place, World};

#[track_caller]
pub fn visible(world: &World, a: &[DVec3], b: &[DVec3], place: &Place) {
    assert!(world.mutual(a, b), "not seen at {place:?}");
}

#[track_caller]
pub fn hidden(world: &World, a: &[DVec3], b: &[DVec3], place: &Place) {
    assert!(!world.mutual(a, b), "seen at {place:?}");
}

/// Creates a scene of one triangle far from all queries.
pub fn empty(place: &Place) -> World {
    let mut draft = Draft::new(place);
    draft.triangle([[96.0, 96.0, 96.0], [97.0, 96.0, 96.0], [96.0, 97.0, 96.0]]);
    draft.done()
}

/// Creates walls that reach from −4 to 4 with one slit at 0.3.
///
/// `lo` and `hi` are the sides of the slit.
pub fn slit(place: &Place, lo: f32, hi: f32) -> World {
    let mut draft = Draft::new(place);
    let [least, most] = [-4.0, 4.0].map(|c| place.local(c));
    draft.placed(1.0, [least, lo], [least, most]);
    draft.placed(1.0, [hi, most], [least, most]);
    draft.done()
}
