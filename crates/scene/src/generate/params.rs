//! The kinds of generated scenes, their parameters, and the errors of wrong ones.

use crate::SceneError;

/// Most triangles of a generated scene.
pub const MAX_TRIANGLES: u64 = 500_000_000;

/// The kinds of generated scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Trees on uneven ground, each of the same number of triangles (Nirenstein and Blake 2004, section 7).
    Forest,
    /// Streets of houses full of rooms; detailed objects are visible through doors and windows (the same
    /// paper, section 7).
    Town,
    /// One storey of furnished rooms joined by doors, under a ceiling.
    Rooms,
    /// The walls of a perfect maze: exactly one path joins any two places.
    Maze,
    /// Parallel walls with narrow slits at known places.
    Slits,
}

impl Kind {
    /// All kinds, in the order of declaration.
    pub const ALL: [Self; 5] = [
        Self::Forest,
        Self::Town,
        Self::Rooms,
        Self::Maze,
        Self::Slits,
    ];

    /// The kind's name on the command line.
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

impl std::str::FromStr for Kind {
    type Err = GenerateError;

    fn from_str(s: &str) -> Result<Self, GenerateError> {
        Self::ALL
            .into_iter()
            .find(|k| k.name() == s)
            .ok_or_else(|| GenerateError::UnknownKind { name: s.to_owned() })
    }
}

/// Parameters of a scene. With `None` the kind chooses the value; a parameter that does not apply to the kind
/// is an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Params {
    /// The seed; each seed gives another scene of the kind.
    pub seed: u64,
    /// All kinds: the approximate number of triangles. It is an error where `trees`, `triangles_per_tree` and
    /// `grid` determine the number already.
    pub triangles: Option<u64>,
    /// Forest: the number of trees (default 200).
    pub trees: Option<u32>,
    /// Forest: the exact number of triangles of each tree (default 25 000).
    pub triangles_per_tree: Option<u32>,
    /// Rooms and maze: columns and rows of rooms or maze cells; slits: walls and slits in each.
    pub grid: Option<[u32; 2]>,
    /// Slits: width of a slit as a fraction of the wall's side, 1e-7 to 0.1 (1e-3).
    pub slit_width: Option<f32>,
}

/// Why a scene could not be generated.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// There is no kind of this name.
    #[error("there is no kind of scene called {name:?}; choose forest, town, rooms, maze or slits")]
    UnknownKind {
        /// The name that was given.
        name: String,
    },
    /// A number is out of range.
    #[error("{kind}: {option} is {value}; it must be from {least} to {most}")]
    OutOfRange {
        /// Name of the kind.
        kind: &'static str,
        /// The option at fault, as `sightline generate` calls it.
        option: &'static str,
        /// The value that was given, or that follows from other options.
        value: String,
        /// The least value accepted.
        least: String,
        /// The greatest value accepted.
        most: String,
    },
    /// An option does not apply to the kind, or contradicts other options.
    #[error("{kind}: {option} cannot be given here: {reason}; leave it out")]
    NotApplicable {
        /// Name of the kind.
        kind: &'static str,
        /// The option at fault, as `sightline generate` calls it.
        option: &'static str,
        /// The reason.
        reason: &'static str,
    },
    /// The triangles do not form a valid scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// `value` when it is from `least` to `most`, else an error.
pub(super) fn within<T: PartialOrd + std::fmt::Display>(
    kind: Kind,
    option: &'static str,
    value: T,
    least: T,
    most: T,
) -> Result<T, GenerateError> {
    // Written so that NaN is refused too.
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

/// Refuses `triangles` together with options that determine the number.
pub(super) fn contradiction(kind: Kind, reason: &'static str) -> GenerateError {
    GenerateError::NotApplicable {
        kind: kind.name(),
        option: "--triangles",
        reason,
    }
}

/// The greatest integer whose square is not above `x`.
pub(super) fn isqrt(x: u64) -> u64 {
    x.isqrt()
}
