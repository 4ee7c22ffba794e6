//! The points whose values are asked for, and the values.

use glam::DVec3;

/// A point of the surface whose value is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// The point, in world space.
    pub point: DVec3,
    /// The normal of its triangle, of length 1, on the side of its front: that from which it is wound
    /// counter-clockwise, or clockwise where a transform mirrors (glTF 2.0, section 3.7.4).
    pub normal: DVec3,
    /// The triangle of the scene.
    pub triangle: u32,
}

/// The value of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value {
    /// The value, from 0 to 1.
    pub open: f64,
    /// Whether the receiver is inside of a closed solid, where nobody can be: its value counts for nothing.
    pub inside: bool,
}
