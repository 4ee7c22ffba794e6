//! Test scenes of any size, byte-identical for the same arguments on every machine.
//!
//! Lengths are in metres, and y is up. The generators use only the operations + − × ÷ √ of IEEE arithmetic
//! and integer random numbers, so the result does not depend on the platform's mathematics library. Scenes
//! have neither materials nor texture coordinates. The seed determines all random numbers.

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
pub use params::{GenerateError, MAX_TRIANGLES, SceneKind, SceneParams};

use crate::Scene;

/// Generates a scene of `kind`.
///
/// # Errors
/// - [`GenerateError::OutOfRange`] if a parameter is out of range, for example zero or more than
///   [`MAX_TRIANGLES`].
/// - [`GenerateError::NotApplicable`] if an option does not apply to the kind, or contradicts other options.
pub fn generate(kind: SceneKind, params: &SceneParams) -> Result<Scene, GenerateError> {
    let foreign = [
        ("--trees", params.trees.is_some(), kind == SceneKind::Forest),
        (
            "--triangles-per-tree",
            params.triangles_per_tree.is_some(),
            kind == SceneKind::Forest,
        ),
        (
            "--grid",
            params.grid.is_some(),
            matches!(kind, SceneKind::Rooms | SceneKind::Maze | SceneKind::Slits),
        ),
        (
            "--slit-width",
            params.slit_width.is_some(),
            kind == SceneKind::Slits,
        ),
    ];
    for (option, given, applies) in foreign {
        if given && !applies {
            return Err(GenerateError::NotApplicable {
                kind: kind.name(),
                option,
                reason: "scenes of this kind do not use the option",
            });
        }
    }
    let mut b = Builder::default();
    match kind {
        SceneKind::Forest => forest::build(&mut b, params)?,
        SceneKind::Town => town::build(&mut b, params)?,
        SceneKind::Rooms => rooms::build(&mut b, params)?,
        SceneKind::Maze => maze::build(&mut b, params)?,
        SceneKind::Slits => slits::build(&mut b, params)?,
    }
    Ok(b.finish(kind.name())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::Solids;
    use sightline_numbers::ids::TriangleId;

    fn sized(kind: SceneKind, triangles: u64, seed: u64) -> Scene {
        generate(
            kind,
            &SceneParams {
                seed,
                triangles: Some(triangles),
                ..SceneParams::default()
            },
        )
        .unwrap()
    }

    #[test]
    fn bytes_depend_on_arguments_and_seed() {
        for kind in SceneKind::ALL {
            let digest = |seed| sized(kind, 5_000, seed).digest();
            assert_eq!(digest(7), digest(7), "{}", kind.name());
            assert_ne!(digest(7), digest(8), "{}", kind.name());
        }
    }

    #[test]
    fn bytes_are_equal_on_every_machine() {
        // Recorded digests. A change here changes scenes that existing measurements refer to.
        let digests =
            SceneKind::ALL.map(|kind| sized(kind, 5_000, 7).digest().to_string()[..16].to_owned());
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
    fn sizes_match_request_and_object_names_are_unique() {
        for kind in SceneKind::ALL {
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
    fn walls_houses_and_furniture_are_closed_and_face_outwards() {
        for kind in [
            SceneKind::Town,
            SceneKind::Rooms,
            SceneKind::Maze,
            SceneKind::Slits,
        ] {
            let s = sized(kind, 20_000, 3);
            let solids = Solids::find(&s).unwrap();
            for o in s.objects().iter().filter(|o| o.name != "ground") {
                let inside_out = (o.first..o.first + o.count)
                    .find(|id| solids.outward(TriangleId(*id)) != Some(1.0));
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
    fn rejects_invalid_parameters() {
        let with = |kind, p: SceneParams| generate(kind, &p).unwrap_err().to_string();
        let d = SceneParams::default();
        for kind in SceneKind::ALL {
            for bad in [0, 1, MAX_TRIANGLES + 1, u64::MAX] {
                let e = with(
                    kind,
                    SceneParams {
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
                SceneKind::Maze,
                SceneParams {
                    trees: Some(3),
                    ..d
                }
            )
            .contains("trees is not applicable")
        );
        assert!(
            with(
                SceneKind::Forest,
                SceneParams {
                    trees: Some(0),
                    ..d
                }
            )
            .contains("trees is 0")
        );
        let huge = SceneParams {
            trees: Some(u32::MAX),
            triangles_per_tree: Some(u32::MAX),
            ..d
        };
        assert!(with(SceneKind::Forest, huge).contains("must be from"));
        for kind in [SceneKind::Maze, SceneKind::Rooms, SceneKind::Slits] {
            assert!(
                with(
                    kind,
                    SceneParams {
                        grid: Some([0, 4]),
                        ..d
                    }
                )
                .contains("must be from")
            );
            assert!(
                with(
                    kind,
                    SceneParams {
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
                    SceneKind::Slits,
                    SceneParams {
                        slit_width: Some(w),
                        ..d
                    }
                )
                .contains("--slit-width is")
            );
        }
        assert!("castle".parse::<SceneKind>().is_err());
        assert_eq!("maze".parse::<SceneKind>().unwrap(), SceneKind::Maze);
    }
}
