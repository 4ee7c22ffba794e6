//! Receivers: the surface points that need a value, and their values.

use glam::DVec3;
use sightline_scene::TriangleId;

/// A point of the surface for which the caller computes a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// The position of the receiver in world space, in units of the scene.
    pub point: DVec3,
    /// The unit normal of the triangle, on the side of its front. The front is the side from which the
    /// triangle is wound counter-clockwise, or clockwise if a transform mirrors (glTF 2.0, section 3.7.4).
    pub normal: DVec3,
    /// The id of the triangle in the scene.
    pub triangle: TriangleId,
}

/// The value of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverValue {
    /// The value, from 0 (dark) to 1 (bright).
    pub open: f64,
    /// True if the receiver is inside a closed solid, where no viewer can be. The value is then ignored.
    pub inside: bool,
}
