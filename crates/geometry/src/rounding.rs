//! The rounding unit in the error bounds of all filters.

/// The rounding unit u = 2⁻⁵³: the largest relative error of one rounded `f64` operation.
pub const UNIT: f64 = f64::EPSILON / 2.0;
