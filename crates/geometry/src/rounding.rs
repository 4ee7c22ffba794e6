//! The unit of rounding errors, in which the bounds of all filters are given.

/// Half a unit in the last place of 1: the largest relative error of one rounded `f64` operation.
pub const UNIT: f64 = f64::EPSILON / 2.0;
