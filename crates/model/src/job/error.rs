//! The errors of a specification that is rejected.

use sightline_viewcells::cheapest::FineGridError;
use sightline_viewcells::{DivisionError, PartMaskError, RegionError, TreeError};

/// A number outside the range of its option.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{option} is {value}, which is not between {least} and {most}; choose a value in that range"
)]
pub struct OutOfRange {
    /// The option's name on the command line, without dashes.
    pub option: &'static str,
    /// The given value.
    pub value: f64,
    /// The minimum value.
    pub least: f64,
    /// The maximum value.
    pub most: f64,
}

/// A name or number that is not a value of its parameter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no {parameter} {given}; give {}", one_of(names))]
pub struct UnknownValue {
    /// The parameter's name.
    pub parameter: &'static str,
    /// The unknown value, as text.
    pub given: String,
    /// The names of the parameter's values.
    pub names: Vec<&'static str>,
}

fn one_of(names: &[&str]) -> String {
    match names {
        [all @ .., last] if !all.is_empty() => format!("{} or {last}", all.join(", ")),
        names => names.join(", "),
    }
}

/// A reason why a specification is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A value is missing, malformed, or does not fit: the option's name without dashes, and the fault.
    #[error("the job's {0} cannot be used: {1}")]
    Value(&'static str, &'static str),
    /// Two values cannot be combined, because jobs with both values are not implemented.
    #[error("{0} cannot be combined with {1}; omit one of them")]
    Combination(&'static str, &'static str),
    /// A number is outside its range.
    #[error(transparent)]
    Range(#[from] OutOfRange),
    /// The name of a value, or its number in a message, is unknown.
    #[error(transparent)]
    Name(#[from] UnknownValue),
    /// The view box cannot be divided.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// The grid is too fine for a search of cells by cost.
    #[error(transparent)]
    Fine(#[from] FineGridError),
    /// The boxes do not form a tree.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// The marks of viewpoints cannot be read.
    #[error(transparent)]
    Viewpoints(#[from] PartMaskError),
    /// The region of viewpoints cannot be read.
    #[error(transparent)]
    Region(#[from] RegionError),
}

impl SpecError {
    /// The error of a message whose view box does not have six coordinates. A message without coordinates has
    /// it only if the bounds of the scene are unknown.
    pub const NO_VIEW_BOX: Self = Self::new(
        "view-box",
        "the six coordinates are missing; give x0,y0,z0,x1,y1,z1",
    );

    pub(crate) const fn new(option: &'static str, remedy: &'static str) -> Self {
        Self::Value(option, remedy)
    }

    pub(crate) const fn combination(option: &'static str, other: &'static str) -> Self {
        Self::Combination(option, other)
    }

    /// Returns the name of the option that caused the error, without dashes, or `None` if no option did.
    pub fn option(&self) -> Option<&'static str> {
        match self {
            Self::Value(option, _) | Self::Combination(option, _) => Some(option),
            Self::Range(e) => Some(e.option),
            Self::Name(e) => Some(e.parameter),
            Self::Viewpoints(_) | Self::Region(_) => Some("viewpoints"),
            Self::Tree(_) => Some("cells"),
            Self::Fine(_) => Some("fine"),
            Self::Division(e) => Some(match e {
                DivisionError::Box { .. } => "view-box",
                DivisionError::Cells { .. }
                | DivisionError::TooFine { .. }
                | DivisionError::TooThin { .. }
                | DivisionError::Plane(_) => "cells",
                DivisionError::Adaptive { .. } => "max-depth",
            }),
        }
    }
}
