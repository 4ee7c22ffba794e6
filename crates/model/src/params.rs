//! The parameters of sampling: each with its default, its range and its place on the wire.
//!
//! A parameter is defined here once. A new one needs three places: a field of the message `Sampling` in the
//! .proto file, an entry here, and a flag of the command line.

use serde::{Deserialize, Serialize};
use sightline_proto::v1;

use crate::choice::{
    CellToCell, Choice, ErrorMeasure, Granularity, Sampler, SupersetChoice, UnknownChoice,
};

/// Smallest and largest bound on missed sight lines.
const BOUNDS: (f64, f64) = (1e-5, 1.0);

/// Least and greatest value of a parameter that has no range.
const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// A parameter's type: how a value is written to the wire, read from it and checked against a range. An
/// absent field stands for the parameter's default.
trait Value: Sized {
    type Wire;
    fn to_wire(&self) -> Option<Self::Wire>;
    fn from_wire(wire: Self::Wire) -> Result<Self, UnknownChoice>;
    /// The number that has to lie in the parameter's range.
    fn number(&self) -> Option<f64>;
}

/// A type that is on the wire as it is.
macro_rules! plain {
    ($type:ty, $number:expr) => {
        impl Value for $type {
            type Wire = Self;
            fn to_wire(&self) -> Option<Self> {
                Some(*self)
            }
            fn from_wire(wire: Self) -> Result<Self, UnknownChoice> {
                Ok(wire)
            }
            fn number(&self) -> Option<f64> {
                let number: fn($type) -> Option<f64> = $number;
                number(*self)
            }
        }
    };
}

plain!(u64, |value| Some(value as f64));
plain!(u32, |value| Some(f64::from(value)));
plain!(bool, |_| None);

impl Value for f64 {
    type Wire = Self;
    fn to_wire(&self) -> Option<Self> {
        Some(*self)
    }
    fn from_wire(wire: Self) -> Result<Self, UnknownChoice> {
        // −0 has other bits than 0. Without this, one value would have two keys.
        Ok(if wire == 0.0 { 0.0 } else { wire })
    }
    fn number(&self) -> Option<f64> {
        Some(*self)
    }
}

/// A parameter that is off when it is absent.
impl Value for Option<f64> {
    type Wire = f64;
    fn to_wire(&self) -> Self {
        *self
    }
    fn from_wire(wire: f64) -> Result<Self, UnknownChoice> {
        f64::from_wire(wire).map(Some)
    }
    fn number(&self) -> Option<f64> {
        *self
    }
}

impl<C: Choice> Value for C {
    type Wire = i32;
    fn to_wire(&self) -> Option<i32> {
        Some(Choice::to_wire(*self))
    }
    fn from_wire(wire: i32) -> Result<Self, UnknownChoice> {
        Choice::from_wire(wire)
    }
    fn number(&self) -> Option<f64> {
        None
    }
}

/// Defines the parameters: fields, defaults, ranges, and the conversions from and to the wire.
macro_rules! parameters {
    (
        $(#[$about:meta])*
        $params:ident, wire $wire:ident {
            $( $(#[$doc:meta])+ $field:ident: $type:ty = $default:expr, $range:expr; )+
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub struct $params {
            $( $(#[$doc])+ pub $field: $type, )+
        }

        impl Default for $params {
            fn default() -> Self {
                Self { $($field: $default),+ }
            }
        }

        impl $params {
            /// Returns the parameters as a message with every field set, defaults included.
            pub fn to_proto(&self) -> v1::$wire {
                v1::$wire { $($field: Value::to_wire(&self.$field)),+ }
            }

            /// Reads the parameters of a message; an absent field has its default. [`Self::check`] checks
            /// the ranges.
            ///
            /// # Errors
            /// [`UnknownChoice`] for a value that this program does not know.
            pub fn from_proto(wire: &v1::$wire) -> Result<Self, UnknownChoice> {
                let usual = Self::default_for(wire);
                Ok(Self { $($field: wire.$field.map_or(Ok(usual.$field), Value::from_wire)?),+ })
            }

            /// Checks every parameter's range.
            ///
            /// # Errors
            /// [`ParamsError`] for the first parameter that is outside its range or not a number.
            pub fn check(&self) -> Result<(), ParamsError> {
                $(
                    let (least, most): (f64, f64) = $range;
                    if let Some(value) = self.$field.number()
                        && !(least..=most).contains(&value)
                    {
                        return Err(ParamsError { name: stringify!($field), value, least, most });
                    }
                )+
                Ok(())
            }
        }
    };
}

parameters! {
    /// Parameters of sampling. All of them are part of a job's key.
    SamplingParams, wire Sampling {
        /// The sampler. `target_error` and `max_error` belong to lines, `rays` to guided, the others to
        /// cubes.
        sampler: Sampler = Sampler::Lines, ANY;
        /// Lines: a cell is done when it is expected to miss at most this fraction of its sight lines. A cell
        /// that takes several times the work of the average cell has a larger tolerance.
        target_error: f64 = 1e-4, (1e-6, 1.0);
        /// Lines: refine each cell until the 95 % bound on its missed sight lines is at most this fraction.
        max_error: Option<f64> = None, BOUNDS;
        /// Guided: rays of each cell.
        rays: u64 = 200_000, (1.0, 1e12);
        /// Side of one item buffer in pixels.
        resolution: u32 = 256, (8.0, 4096.0);
        /// The error measure.
        measure: ErrorMeasure = ErrorMeasure::Strata, ANY;
        /// A rectangle is split while the measure over its exterior samples exceeds this.
        error_threshold: f64 = 0.1, (0.0, 1.0);
        /// The same for its samples inside closed solids (Nirenstein and Blake 2004, section 3.6).
        interior_threshold: f64 = 0.5, (0.0, 1.0);
        /// A rectangle within one cell is never split when its longer side is at most this fraction of a view
        /// cell's size, the geometric mean of the cell's three sides. The range ends where no use is known; a
        /// flat cell is halved further along its long sides, and the lattice still has points there.
        min_distance: f64 = 0.5, (1.0 / 1024.0, 4.0);
        /// Whether samples inside closed solids are judged apart (Nirenstein and Blake 2004, section 3.6).
        solids: bool = true, ANY;
        /// Whether superset simplification is used.
        superset: SupersetChoice = SupersetChoice::Auto, ANY;
        /// What the sets name.
        granularity: Granularity = Granularity::Triangles, ANY;
        /// Lines: an item with at least this share of a cell's sight lines is met by a uniform line with a
        /// probability of 95 %. Replaces `target_error`.
        min_share: Option<f64> = None, (1e-6, 1.0);
        /// Sight lines end at this distance from the viewpoint, in the scene's units.
        far: Option<f64> = None, (f32::MIN_POSITIVE as f64, f32::MAX as f64);
        /// Whether the result says which cells see which.
        cell_to_cell: CellToCell = CellToCell::Auto, ANY;
        /// Whether the share of the view that each visible item takes is measured.
        contributions: bool = false, ANY;
    }
}

impl SamplingParams {
    /// Returns the defaults of a message: a bound is the target, too, as on the command line.
    fn default_for(wire: &v1::Sampling) -> Self {
        let usual = Self::default();
        // A bound outside its range must not be reported as a target.
        let bound = wire
            .max_error
            .filter(|bound| (BOUNDS.0..=BOUNDS.1).contains(bound));
        Self {
            target_error: bound.unwrap_or(usual.target_error),
            ..usual
        }
    }
}

/// A parameter outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{} is {value}, which is not between {least} and {most}; choose a value in that range",
    flag(name)
)]
pub struct ParamsError {
    /// The field of [`SamplingParams`].
    pub name: &'static str,
    /// The value given.
    pub value: f64,
    /// Least allowed value.
    pub least: f64,
    /// Greatest allowed value.
    pub most: f64,
}

/// A field as the command line names it.
fn flag(field: &str) -> String {
    field.replace('_', "-")
}

/// Fraction of `max_error` that the sampler lines aims at before it takes the first bound, so that few cells
/// need a second one.
pub const BOUND_AIM: f64 = 0.125;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_in_range_and_every_field_comes_back_from_the_wire() {
        let standard = SamplingParams::default();
        assert_eq!(standard.check(), Ok(()));
        let other = SamplingParams {
            sampler: Sampler::Cubes,
            target_error: 0.25,
            max_error: Some(0.5),
            rays: 7,
            resolution: 64,
            measure: ErrorMeasure::Pixels,
            error_threshold: 0.75,
            interior_threshold: 0.125,
            min_distance: 2.0,
            solids: false,
            superset: SupersetChoice::Off,
            granularity: Granularity::Objects,
            min_share: Some(0.01),
            far: Some(100.0),
            cell_to_cell: CellToCell::Off,
            contributions: true,
        };
        for params in [standard, other] {
            assert_eq!(SamplingParams::from_proto(&params.to_proto()), Ok(params));
        }
    }

    #[test]
    fn absent_fields_have_defaults() {
        let absent = |wire: v1::Sampling| SamplingParams::from_proto(&wire);
        assert_eq!(
            absent(v1::Sampling::default()),
            Ok(SamplingParams::default())
        );
        let bounded = v1::Sampling {
            max_error: Some(0.01),
            ..v1::Sampling::default()
        };
        let expected = SamplingParams {
            max_error: Some(0.01),
            target_error: 0.01,
            ..SamplingParams::default()
        };
        assert_eq!(absent(bounded), Ok(expected));
        // The key is made of the message, so that −0 must not differ from 0.
        let negative = v1::Sampling {
            error_threshold: Some(-0.0),
            ..v1::Sampling::default()
        };
        assert!(absent(negative).unwrap().error_threshold.is_sign_positive());
    }

    #[test]
    fn a_value_outside_its_range_is_refused_with_the_flag_and_the_range() {
        let wrong = SamplingParams {
            error_threshold: f64::NAN,
            ..SamplingParams::default()
        };
        let said = wrong.check().unwrap_err().to_string();
        assert!(
            said.starts_with("error-threshold is NaN, which is not between 0 and 1;"),
            "{said}"
        );
        let wrong = SamplingParams {
            max_error: Some(0.0),
            ..SamplingParams::default()
        };
        assert_eq!(wrong.check().unwrap_err().name, "max_error");
        let unknown = v1::Sampling {
            sampler: Some(9),
            ..SamplingParams::default().to_proto()
        };
        assert!(
            SamplingParams::from_proto(&unknown)
                .unwrap_err()
                .to_string()
                .contains("sampler")
        );
    }
}
