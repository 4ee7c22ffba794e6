//! The numbers of a job: a type for each, with its range, its default and the name of its option.
//!
//! A value outside its range cannot be made, so code that takes one of these types checks nothing.

use super::{FieldValue, OutOfRange, SpecError};

/// Defines the numbers: each a type that wraps a primitive one.
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
            /// The minimum.
            pub const LEAST: $type = $least;
            /// The maximum.
            pub const MOST: $type = $most;

            /// Checks a value.
            ///
            /// # Errors
            /// [`OutOfRange`] for a value that is not between [`Self::LEAST`] and [`Self::MOST`].
            pub fn new(value: $type) -> Result<Self, OutOfRange> {
                if !(Self::LEAST..=Self::MOST).contains(&value) {
                    let [value, least, most] = [value, Self::LEAST, Self::MOST].map(|v| v as f64);
                    return Err(OutOfRange { option: Self::OPTION, value, least, most });
                }
                // −0 has other bits than 0. Without this, one value would have two keys.
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
    /// The fraction of a cell's sight lines that the cell is expected to miss at most when it is finished. A
    /// cell that costs several times the work of the average cell has a larger tolerance.
    TargetError(f64) = "target-error", 1e-6, 1.0, default 1e-4;
    /// The maximum 95 % bound on a cell's fraction of missed sight lines.
    MaxError(f64) = "max-error", 1e-5, 1.0;
    /// The share of a cell's sight lines from which on an item is met by a uniform line with a probability of
    /// 95 %.
    MinShare(f64) = "min-share", 1e-6, 1.0;
    /// The number of guided rays of each cell.
    RayCount(u64) = "rays", 1, 1_000_000_000_000, default 200_000;
    /// The time after submission when sampling stops, in milliseconds: at most ten years.
    TimeBudget(u64) = "time-budget", 1, 10 * 366 * 24 * 3600 * 1000;
    /// A distance from the viewpoint, in the scene's units.
    Length(f64) = "far", f32::MIN_POSITIVE as f64, f32::MAX as f64;
    /// The maximum number of grid cells of a tile.
    TileCells(u32) = "block-cells", 1, sightline_viewcells::MOST_BLOCK_CELLS,
        default sightline_viewcells::USUAL_BLOCK_CELLS;
    /// The number of triangles visible from a cell of an adaptive tree above which the cell is halved.
    TriangleBudget(u32) = "triangle-budget", 1, u32::MAX;
    /// The side of a face of a visibility cube, in pixels.
    Resolution(u32) = "resolution", 8, 4096, default 256;
    /// The value of the error measure over exterior cubes above which a rectangle is split.
    ErrorThreshold(f64) = "error-threshold", 0.0, 1.0, default 0.1;
    /// The value of the error measure over cubes inside closed solids above which a rectangle is split
    /// (Nirenstein and Blake 2004, section 3.6).
    InteriorThreshold(f64) = "interior-threshold", 0.0, 1.0, default 0.5;
    /// The fraction of a view cell's size, which is the geometric mean of its three sides, from which on a
    /// rectangle within the cell is not split. The range ends where no use is known; a flat cell is halved
    /// further along its long sides, and the lattice still has points there.
    MinDistance(f64) = "min-distance", 1.0 / 1024.0, 4.0, default 0.5;
}

/// Work, in triangles divided by the target error, above which a tile has fewer cells, with the number of
/// cells. A guess at the work from which a lost worker, a pause and a second machine matter more than the
/// lines that are shared.
const HEAVY: [(f64, u32); 2] = [(5e10, 64), (5e9, 128)];

/// Fraction of a bound that the sampler lines aims at before it takes the first bound, so that few cells need
/// a second one.
pub const BOUND_AIM: f64 = 0.125;

impl TileCells {
    /// The cells of a tile that are decided exactly. Each takes seconds on real scenes; the time that
    /// sampling saves in large tiles is nothing compared with that.
    pub const EXACT: Self = Self(8);

    /// The cells of a tile that are seen through portals, about a tenth of a second each.
    pub const PORTALS: Self = Self(64);

    /// Returns the usual number of cells of a tile that lines sample, for a scene with this many triangles.
    pub fn of_lines(triangles: u32, error: TargetError, bound: Option<MaxError>) -> Self {
        // The sampler aims at a bound from well below it.
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
