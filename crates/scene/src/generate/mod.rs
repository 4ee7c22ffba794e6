//! Test scenes of any size, byte-identical for the same arguments on every machine.
//!
//! Lengths are in metres, and y is up. The generators use only the operations + − × ÷ √ of IEEE arithmetic
//! and integer random numbers, so nothing depends on the platform's mathematics library. Scenes have no
//! materials and no texture coordinates, and all randomness comes from the seed.

mod build;
mod forest;
mod furniture;
mod maze;
mod params;
mod plan;
mod random;
mod rooms;
pub mod slits;
mod town;

use build::Builder;
pub use params::{GenerateError, Kind, MAX_TRIANGLES, Params};

use crate::Scene;

/// Generates a scene of `kind`.
///
/// # Errors
/// [`GenerateError::OutOfRange`] for zero, more than [`MAX_TRIANGLES`] and other values out of range;
/// [`GenerateError::NotApplicable`] for options that do not apply to the kind.
pub fn generate(kind: Kind, params: &Params) -> Result<Scene, GenerateError> {
    let foreign = [
        ("--trees", params.trees.is_some(), kind == Kind::Forest),
        (
            "--triangles-per-tree",
            params.triangles_per_tree.is_some(),
            kind == Kind::Forest,
        ),
        (
            "--grid",
            params.grid.is_some(),
            matches!(kind, Kind::Rooms | Kind::Maze | Kind::Slits),
        ),
        (
            "--slit-width",
            params.slit_width.is_some(),
            kind == Kind::Slits,
        ),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::Solids;

    fn sized(kind: Kind, triangles: u64, seed: u64) -> Scene {
        generate(
            kind,
            &Params {
                seed,
                triangles: Some(triangles),
                ..Params::default()
            },
        )
        .unwrap()
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
        let digests =
            Kind::ALL.map(|kind| sized(kind, 5_000, 7).digest().to_string()[..16].to_owned());
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
                assert!(
                    (0.75..1.25).contains(&n),
                    "{} {target}: {} triangles",
                    kind.name(),
                    s.len()
                );
                let mut names: Vec<&str> = s.objects().iter().map(|o| o.name.as_str()).collect();
                names.sort_unstable();
                assert!(names.windows(2).all(|w| w[0] != w[1]), "{}", kind.name());
                assert!(s.objects().iter().all(|o| o.count > 0));
                let flat = s.triangles().iter().filter(|t| t.is_degenerate()).count();
                assert_eq!(
                    flat,
                    0,
                    "{} {target} has triangles without area",
                    kind.name()
                );
            }
        }
    }

    #[test]
    fn walls_houses_and_furniture_are_closed_and_face_out() {
        for kind in [Kind::Town, Kind::Rooms, Kind::Maze, Kind::Slits] {
            let s = sized(kind, 20_000, 3);
            let solids = Solids::of(&s).unwrap();
            for o in s.objects().iter().filter(|o| o.name != "ground") {
                let inside_out =
                    (o.first..o.first + o.count).find(|id| solids.outward(*id) != Some(1.0));
                assert_eq!(inside_out, None, "{}, {}", kind.name(), o.name);
            }
            assert!(
                crate::topology::duplicates(&s).unwrap().is_empty(),
                "{}",
                kind.name()
            );
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let with = |kind, p: Params| generate(kind, &p).unwrap_err().to_string();
        let d = Params::default();
        for kind in Kind::ALL {
            for bad in [0, 1, MAX_TRIANGLES + 1, u64::MAX] {
                let e = with(
                    kind,
                    Params {
                        triangles: Some(bad),
                        ..d
                    },
                );
                assert!(
                    e.contains("triangles is") && e.contains("must be from"),
                    "{e}"
                );
            }
        }
        assert!(
            with(
                Kind::Maze,
                Params {
                    trees: Some(3),
                    ..d
                }
            )
            .contains("trees cannot be given")
        );
        assert!(
            with(
                Kind::Forest,
                Params {
                    trees: Some(0),
                    ..d
                }
            )
            .contains("trees is 0")
        );
        let huge = Params {
            trees: Some(u32::MAX),
            triangles_per_tree: Some(u32::MAX),
            ..d
        };
        assert!(with(Kind::Forest, huge).contains("must be from"));
        for kind in [Kind::Maze, Kind::Rooms, Kind::Slits] {
            assert!(
                with(
                    kind,
                    Params {
                        grid: Some([0, 4]),
                        ..d
                    }
                )
                .contains("must be from")
            );
            assert!(
                with(
                    kind,
                    Params {
                        grid: Some([u32::MAX; 2]),
                        ..d
                    }
                )
                .contains("must be from")
            );
        }
        for w in [0.0, -1.0, f32::NAN, 1.0, 1e-9] {
            assert!(
                with(
                    Kind::Slits,
                    Params {
                        slit_width: Some(w),
                        ..d
                    }
                )
                .contains("--slit-width is")
            );
        }
        assert!("castle".parse::<Kind>().is_err());
        assert_eq!("maze".parse::<Kind>().unwrap(), Kind::Maze);
    }
}
