//! Test scenes of any size, byte-identical for the same arguments on every machine.
//!
//! Lengths are in metres, and y is up. The generators use only the operations + − × ÷ √ of IEEE arithmetic
//! and integer random numbers, so nothing depends on the platform's mathematics library. Scenes have no
//! materials and no texture coordinates, and all randomness comes from the seed.

mod build;
mod forest;
mod furniture;
mod maze;
mod plan;
mod random;
mod rooms;
pub mod slits;
mod town;

use build::Builder;

use crate::{Scene, SceneError};

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
    pub const ALL: [Self; 5] = [Self::Forest, Self::Town, Self::Rooms, Self::Maze, Self::Slits];

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

/// Generates a scene of `kind`.
///
/// # Errors
/// [`GenerateError::OutOfRange`] for zero, more than [`MAX_TRIANGLES`] and other values out of range;
/// [`GenerateError::NotApplicable`] for options that do not apply to the kind.
pub fn generate(kind: Kind, params: &Params) -> Result<Scene, GenerateError> {
    let foreign = [
        ("--trees", params.trees.is_some(), kind == Kind::Forest),
        ("--triangles-per-tree", params.triangles_per_tree.is_some(), kind == Kind::Forest),
        ("--grid", params.grid.is_some(), matches!(kind, Kind::Rooms | Kind::Maze | Kind::Slits)),
        ("--slit-width", params.slit_width.is_some(), kind == Kind::Slits),
    ];
    for (option, given, applies) in foreign {
        if given && !applies {
            return Err(GenerateError::NotApplicable {
                kind: kind.name(),
                option,
                reason: "this kind has no such thing",
            });
        }
    }
    let mut b = Builder::default();
    match kind {
        Kind::Forest => forest::build(&mut b, params)?,
        Kind::Town => town::build(&mut b, params)?,
        Kind::Rooms => rooms::build(&mut b, params)?,
        Kind::Maze => maze::build(&mut b, params)?,
        Kind::Slits => slits::build(&mut b, params)?,
    }
    Ok(b.finish(kind.name())?)
}

/// `value` when it is from `least` to `most`, else an error.
fn within<T: PartialOrd + std::fmt::Display>(
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
    Err(GenerateError::OutOfRange { kind: kind.name(), option, value, least, most })
}

/// Refuses `triangles` together with options that determine the number.
fn contradiction(kind: Kind, reason: &'static str) -> GenerateError {
    GenerateError::NotApplicable { kind: kind.name(), option: "--triangles", reason }
}

/// The greatest integer whose square is not above `x`.
fn isqrt(x: u64) -> u64 {
    x.isqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::Solids;

    fn sized(kind: Kind, triangles: u64, seed: u64) -> Scene {
        generate(kind, &Params { seed, triangles: Some(triangles), ..Params::default() }).unwrap()
    }

    #[test]
    fn the_same_arguments_give_the_same_bytes_and_other_seeds_others() {
        for kind in Kind::ALL {
            let digest = |seed| sized(kind, 5_000, seed).digest();
            assert_eq!(digest(7), digest(7), "{}", kind.name());
            assert_ne!(digest(7), digest(8), "{}", kind.name());
        }
    }

    #[test]
    fn the_bytes_are_those_of_every_other_machine() {
        // Recorded digests. A change here changes scenes on which others have measured.
        let digests = Kind::ALL.map(|kind| sized(kind, 5_000, 7).digest().to_string()[..16].to_owned());
        assert_eq!(
            digests,
            [
                "eccb804bce6d222e",
                "61b189b695c561de",
                "d3c4e6943f072115",
                "d1e353b580b2808e",
                "c6bc79391f338a57"
            ]
        );
    }

    #[test]
    fn sizes_are_about_what_was_asked_and_objects_have_names_of_their_own() {
        for kind in Kind::ALL {
            for target in [2_000u64, 30_000, 200_000] {
                let s = sized(kind, target, 1);
                let n = f64::from(s.len()) / target as f64;
                assert!((0.75..1.25).contains(&n), "{} {target}: {} triangles", kind.name(), s.len());
                let mut names: Vec<&str> = s.objects().iter().map(|o| o.name.as_str()).collect();
                names.sort_unstable();
                assert!(names.windows(2).all(|w| w[0] != w[1]), "{}", kind.name());
                assert!(s.objects().iter().all(|o| o.count > 0));
                let flat = s.triangles().iter().filter(|t| t.is_degenerate()).count();
                assert_eq!(flat, 0, "{} {target} has triangles without area", kind.name());
            }
        }
    }

    #[test]
    fn walls_houses_and_furniture_are_closed_and_face_out() {
        for kind in [Kind::Town, Kind::Rooms, Kind::Maze, Kind::Slits] {
            let s = sized(kind, 20_000, 3);
            let solids = Solids::of(&s).unwrap();
            for o in s.objects().iter().filter(|o| o.name != "ground") {
                let inside_out = (o.first..o.first + o.count).find(|id| solids.outward(*id) != Some(1.0));
                assert_eq!(inside_out, None, "{}, {}", kind.name(), o.name);
            }
            assert!(crate::topology::duplicates(&s).unwrap().is_empty(), "{}", kind.name());
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let with = |kind, p: Params| generate(kind, &p).unwrap_err().to_string();
        let d = Params::default();
        for kind in Kind::ALL {
            for bad in [0, 1, MAX_TRIANGLES + 1, u64::MAX] {
                let e = with(kind, Params { triangles: Some(bad), ..d });
                assert!(e.contains("triangles is") && e.contains("must be from"), "{e}");
            }
        }
        assert!(with(Kind::Maze, Params { trees: Some(3), ..d }).contains("trees cannot be given"));
        assert!(with(Kind::Forest, Params { trees: Some(0), ..d }).contains("trees is 0"));
        let huge = Params { trees: Some(u32::MAX), triangles_per_tree: Some(u32::MAX), ..d };
        assert!(with(Kind::Forest, huge).contains("must be from"));
        for kind in [Kind::Maze, Kind::Rooms, Kind::Slits] {
            assert!(with(kind, Params { grid: Some([0, 4]), ..d }).contains("must be from"));
            assert!(with(kind, Params { grid: Some([u32::MAX; 2]), ..d }).contains("must be from"));
        }
        for w in [0.0, -1.0, f32::NAN, 1.0, 1e-9] {
            assert!(with(Kind::Slits, Params { slit_width: Some(w), ..d }).contains("--slit-width is"));
        }
        assert!("castle".parse::<Kind>().is_err());
        assert_eq!("maze".parse::<Kind>().unwrap(), Kind::Maze);
    }
}
