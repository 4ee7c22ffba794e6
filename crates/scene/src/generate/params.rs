//! The kinds of generated scenes, their parameters, and the errors of invalid parameters.

use crate::SceneError;

/// Maximum number of triangles of a generated scene.
pub const MAX_TRIANGLES: u64 = 500_000_000;

/// The kinds of generated scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SceneKind {
    /// Trees on uneven ground, each with the same number of triangles (Nirenstein and Blake 2004, section 7).
    Forest,
    /// Streets of houses full of rooms. Detailed objects are visible through doors and windows (Nirenstein
    /// and Blake 2004, section 7).
    Town,
    /// One storey of furnished rooms joined by doors, under a ceiling.
    Rooms,
    /// The walls of a perfect maze: exactly one path joins any two cells.
    Maze,
    /// Parallel walls with narrow slits at known positions.
    Slits,
}

impl SceneKind {
    /// The list of all kinds, in the order of declaration.
    pub const ALL: [Self; 5] = [
        Self::Forest,
        Self::Town,
        Self::Rooms,
        Self::Maze,
        Self::Slits,
    ];

    /// Returns the kind's name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Forest => "forest",
            Self::Town => "town",
            Self::Rooms => "rooms",
            Self::Maze => "maze",
            Self::Slits => "slits",
        }
    }
}

impl std::str::FromStr for SceneKind {
    type Err = GenerateError;

    fn from_str(s: &str) -> Result<Self, GenerateError> {
        Self::ALL
            .into_iter()
            .find(|k| k.name() == s)
            .ok_or_else(|| GenerateError::UnknownKind { name: s.to_owned() })
    }
}

/// The parameters of a scene. If a parameter is `None`, the kind determines its value. A parameter that does
/// not apply to the kind is an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneParams {
    /// The seed of all random numbers. Different seeds give different scenes.
    pub seed: u64,
    /// All kinds: the approximate number of triangles. It is an error if other parameters already determine
    /// the number: `trees` together with `triangles_per_tree`, or `grid` of a maze or of slits.
    pub triangles: Option<u64>,
    /// Forest: the number of trees. Default: 200.
    pub trees: Option<u32>,
    /// Forest: the exact number of triangles of each tree. Default: 25 000.
    pub triangles_per_tree: Option<u32>,
    /// Rooms and maze: columns and rows of rooms or maze cells. Slits: the number of walls, and of slits in
    /// each wall.
    pub grid: Option<[u32; 2]>,
    /// Slits: the width of a slit as a fraction of the wall's side, from 1e-7 to 0.1. Default: 1e-3, or less
    /// for many slits.
    pub slit_width: Option<f32>,
}

/// The reason why a scene could not be generated.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// A name that no kind of generated scene has.
    #[error("the kind of scene {name:?} is unknown; choose forest, town, rooms, maze or slits")]
    UnknownKind {
        /// The name that the caller gave.
        name: String,
    },
    /// A number that is out of range.
    #[error("{kind}: {option} is {value}, but must be from {least} to {most}")]
    OutOfRange {
        /// The name of the kind of scene.
        kind: &'static str,
        /// The option at fault, as `sightline generate` names it, or a quantity that options determine.
        option: &'static str,
        /// The value of the option or quantity.
        value: String,
        /// The minimum valid value.
        least: String,
        /// The maximum valid value.
        most: String,
    },
    /// An option that does not apply to the kind of scene, or contradicts other options.
    #[error("{kind}: {option} is not applicable: {reason}; omit {option}")]
    NotApplicable {
        /// The name of the kind of scene.
        kind: &'static str,
        /// The option at fault, as `sightline generate` names it.
        option: &'static str,
        /// The reason why the option is not applicable.
        reason: &'static str,
    },
    /// Triangles that do not form a valid scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Returns `value` if it is from `least` to `most`, otherwise an error.
pub(super) fn within<T: PartialOrd + std::fmt::Display>(
    kind: SceneKind,
    option: &'static str,
    value: T,
    least: T,
    most: T,
) -> Result<T, GenerateError> {
    // The comparison also rejects NaN.
    if value >= least && value <= most {
        return Ok(value);
    }
    let (value, least, most) = (value.to_string(), least.to_string(), most.to_string());
    Err(GenerateError::OutOfRange {
        kind: kind.name(),
        option,
        value,
        least,
        most,
    })
}

/// Creates the error for `triangles` together with other options that determine the number of triangles.
pub(super) fn contradiction(kind: SceneKind, reason: &'static str) -> GenerateError {
    GenerateError::NotApplicable {
        kind: kind.name(),
        option: "--triangles",
        reason,
    }
}

/// Returns the largest integer whose square is not above `x`.
pub(super) fn isqrt(x: u64) -> u64 {
    x.isqrt()
}
