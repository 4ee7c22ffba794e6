//! The numbers of a job: a type for each number, with its range, its default and the name of its option.
//!
//! A value outside its range cannot be constructed, so code that accepts one of these types does not check
//! the value.

use super::{FieldValue, OutOfRange, SpecError};

/// Defines the types of numbers. Each type wraps a primitive type.
macro_rules! numbers {
    ($(
        $(#[$about:meta])+
        $name:ident($type:ty) = $option:literal, $least:expr, $most:expr $(, default $default:expr)?;
    )+) => { $(
        $(#[$about])+
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
        pub struct $name($type);

        impl $name {
            /// The option's name on the command line, without dashes.
            pub const OPTION: &'static str = $option;
            /// The minimum value.
            pub const LEAST: $type = $least;
            /// The maximum value.
            pub const MOST: $type = $most;

            /// Creates a number from a value in the range.
            ///
            /// # Errors
            /// [`OutOfRange`] if the value is not between [`Self::LEAST`] and [`Self::MOST`].
            pub fn new(value: $type) -> Result<Self, OutOfRange> {
                if !(Self::LEAST..=Self::MOST).contains(&value) {
                    let [value, least, most] = [value, Self::LEAST, Self::MOST].map(|v| v as f64);
                    return Err(OutOfRange { option: Self::OPTION, value, least, most });
                }
                // −0 has other bits than 0, so one value would have two keys.
                Ok(Self(if value == <$type>::default() { <$type>::default() } else { value }))
            }

            /// Returns the value.
            pub const fn get(self) -> $type {
                self.0
            }
        }

        impl FieldValue for $name {
            type Wire = $type;

            fn from_wire(wire: $type) -> Result<Self, SpecError> {
                Ok(Self::new(wire)?)
            }

            fn to_wire(self) -> $type {
                self.0
            }
        }

        $( impl Default for $name {
            fn default() -> Self {
                Self($default)
            }
        } )?
    )+ };
}

numbers! {
    /// The maximum fraction of a cell's sight lines that a finished cell is expected to miss. A cell that
    /// costs several times the work of the average cell has a larger tolerance.
    TargetError(f64) = "target-error", 1e-6, 1.0, default 1e-4;
    /// The maximum 95 % bound on a cell's fraction of missed sight lines.
    MaxError(f64) = "max-error", 1e-5, 1.0;
    /// The minimum share of an item in a cell's sight lines.
    ///
    /// A cell is finished when its uniform lines meet an item of this share with a probability of 95 %.
    MinShare(f64) = "min-share", 1e-6, 1.0;
    /// The number of guided rays of each cell.
    RayCount(u64) = "rays", 1, 1_000_000_000_000, default 200_000;
    /// The duration from submission until sampling stops, in milliseconds. At most ten years.
    TimeBudget(u64) = "time-budget", 1, 10 * 366 * 24 * 3600 * 1000;
    /// A distance from the viewpoint, in the scene's units.
    Length(f64) = "far", f32::MIN_POSITIVE as f64, f32::MAX as f64;
    /// The maximum number of grid cells of a tile.
    TileCells(u32) = "block-cells", 1, sightline_viewcells::MOST_BLOCK_CELLS,
        default sightline_viewcells::USUAL_BLOCK_CELLS;
    /// The maximum number of view cells with viewpoints that a job by cost chooses.
    CellCount(u64) = "cell-budget", 1, sightline_viewcells::division::MAX_CELLS;
    /// The maximum sum of the sizes of the sets of the cells that a job by cost chooses, in bytes.
    ByteCount(u64) = "byte-budget", 1, 1 << 50;
    /// The maximum number of visible triangles of a cell of an adaptive tree. A cell with more triangles is
    /// halved.
    TriangleBudget(u32) = "triangle-budget", 1, u32::MAX;
    /// The side length of a face of a visibility cube, in pixels.
    Resolution(u32) = "resolution", 8, 4096, default 256;
    /// The threshold for the error measure over exterior cubes. A rectangle above the threshold is split.
    ErrorThreshold(f64) = "error-threshold", 0.0, 1.0, default 0.1;
    /// The threshold for the error measure over cubes inside closed solids. A rectangle above the threshold
    /// is split (Nirenstein and Blake 2004, section 3.6).
    InteriorThreshold(f64) = "interior-threshold", 0.0, 1.0, default 0.5;
    /// The minimum size of a rectangle in a cell, as a fraction of the cell's size. A rectangle of this size
    /// is not split.
    ///
    /// The size of a cell is the geometric mean of its three sides. No use of values outside the range is
    /// known. A flat cell is halved further along its long sides, and the lattice contains the corners of
    /// these halves.
    MinDistance(f64) = "min-distance", 1.0 / 1024.0, 4.0, default 0.5;
}

/// Pairs of a minimum work and the default number of cells of a tile for at least this work.
///
/// Work is the number of triangles divided by the target error. The values are estimates of the work above
/// which a lost worker, a pause and a second machine matter more than shared lines.
const HEAVY: [(f64, u32); 2] = [(5e10, 64), (5e9, 128)];

/// The expected error that the sampler aims at before the first look, as a fraction of the requested bound.
/// Few cells then need a second look.
pub const BOUND_AIM: f64 = 0.125;

impl TileCells {
    /// The default number of cells of a tile that is decided exactly. A cell costs seconds in real scenes, so
    /// the sampling time that larger tiles save is negligible.
    pub const EXACT: Self = Self(8);

    /// The default number of cells of a tile of the method portals. A cell costs about a tenth of a second.
    pub const PORTALS: Self = Self(64);

    /// Returns the default number of cells of a tile that lines sample, for a scene with `triangles`
    /// triangles.
    pub fn of_lines(triangles: u32, error: TargetError, bound: Option<MaxError>) -> Self {
        // The sampler aims at an error well below the bound.
        let aim = bound.map_or(1.0, |most| most.get() * BOUND_AIM);
        let work = f64::from(triangles) / aim.min(error.get());
        let heavy = HEAVY.iter().find(|(least, _)| work >= *least);
        heavy.map_or(Self::default(), |(_, cells)| Self(*cells))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_outside_their_range_are_rejected_with_option_and_range() {
        let error = ErrorThreshold::new(f64::NAN).unwrap_err().to_string();
        assert!(
            error.starts_with("error-threshold is NaN, which is not between 0 and 1;"),
            "{error}"
        );
        assert_eq!(MaxError::new(0.0).unwrap_err().option, "max-error");
        assert!(TimeBudget::new(0).is_err() && TileCells::new(4097).is_err());
    }

    #[test]
    fn negative_zero_is_zero() {
        assert!(ErrorThreshold::new(-0.0).unwrap().get().is_sign_positive());
    }

    #[test]
    fn tiles_of_much_work_have_fewer_cells() {
        let error = TargetError::default();
        assert_eq!(TileCells::of_lines(100, error, None).get(), 512);
        assert_eq!(TileCells::of_lines(1_000_000, error, None).get(), 128);
        assert_eq!(TileCells::of_lines(10_000_000, error, None).get(), 64);
        let bound = MaxError::new(1e-5).unwrap();
        assert_eq!(TileCells::of_lines(10_000, error, Some(bound)).get(), 128);
    }
}
