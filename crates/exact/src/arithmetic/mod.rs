//! Numbers: double-doubles, big integers, signs, and random numbers.

pub(crate) mod double_double;
pub(crate) mod number;
pub(crate) mod random;
