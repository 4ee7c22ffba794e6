//! Index types of triangles, objects, cells, tiles and phases.
//!
//! Each type contains a `u32` and has the memory layout of a `u32`. Visibility sets, bit tables, GPU buffers
//! and protocol messages contain plain `u32` values in place of these types.

use std::fmt;

/// Defines index types that hold a `u32`.
macro_rules! indices {
    ($($(#[$doc:meta])* $name:ident;)+) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(transparent))]
        #[repr(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// Returns the index as `usize`, for access to a list.
            pub const fn at(self) -> usize {
                self.0 as usize
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    )+};
}

indices! {
    /// The index of a triangle in its scene, from 0.
    TriangleId;
    /// The index of an object in its scene, from 0.
    ObjectId;
    /// The index of a view cell in a result, from 0.
    CellIndex;
    /// The index of a tile in its job's plan, from 0.
    TileIndex;
    /// The index of a phase in the computation of a tile, from 0.
    PhaseIndex;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_is_laid_out_and_printed_like_its_number() {
        assert_eq!(size_of::<CellIndex>(), size_of::<u32>());
        assert_eq!(format!("{:>4}|{}", CellIndex(7), TileIndex(8)), "   7|8");
        assert_eq!(TriangleId(u32::MAX).at(), u32::MAX as usize);
    }
}
