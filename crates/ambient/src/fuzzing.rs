//! The bodies of the fuzz targets `points` and `lights`, which the tests also call.

use glam::{DVec3, Vec3};
use serde::de::DeserializeOwned;
use sightline_scene::{Object, Scene, Triangle, TriangleId};

use crate::fragments::Falloff;
use crate::lights::Light;
use crate::lines::{LightLine, PointLine};
use crate::receivers::Receiver;
use crate::solve::{AmbientScene, ReceiverResult, Solver, SolverSettings};

/// Maximum number of points or lights of one call, which bounds its duration.
const MOST: usize = 16;

/// The scene of the fuzz targets: a floor, a roof that crosses a wall, and triangles that share edges and
/// planes, also at the limits of single precision.
const TRIANGLES: [[[f32; 3]; 3]; 9] = [
    [[-4.0, -4.0, 0.0], [4.0, -4.0, 0.0], [4.0, 4.0, 0.0]],
    [[-4.0, -4.0, 0.0], [4.0, 4.0, 0.0], [-4.0, 4.0, 0.0]],
    [[-1.0, -1.0, 1.0], [3.0, -1.0, 1.0], [-1.0, 3.0, 1.0]],
    [[1.0, -2.0, -1.0], [1.0, 2.0, -1.0], [1.0, 0.0, 3.0]],
    [[1.0, -2.0, -1.0], [1.0, 2.0, -1.0], [1.0, 0.0, 3.0]],
    [[0.0, 0.0, 2.0], [0.0, 1.0, 2.0], [1.0e-30, 0.0, 2.0]],
    [[-2.0, 0.0, 0.0], [-2.0, 1.0, 0.0], [-2.0, 0.0, 1.0e-3]],
    [
        [1.0e30, 0.0, 5.0],
        [0.0, 1.0e30, 5.0],
        [-1.0e30, -1.0e30, 5.0],
    ],
    [[-3.0, -3.0, 0.5], [-3.0, 3.0, 0.5], [-3.5, 0.0, 4.0]],
];

/// Parses each line of `bytes`, and skips lines that are not valid.
fn lines<L: DeserializeOwned>(bytes: &[u8]) -> impl Iterator<Item = L> {
    bytes
        .split(|b| *b == b'\n')
        .filter_map(|line| serde_json::from_slice(line).ok())
}

/// Parses bytes as the lines of a points file, and checks the openness of the points. Returns true if the
/// file contains a point.
///
/// The checks use a finite distance, an infinite distance, and a falloff with fragments.
///
/// # Panics
/// If an answer is not finite or not between 0 and 1 within its bound, or if the fragments of a point cover
/// more than its hemisphere. No input may cause that.
pub fn points(bytes: &[u8]) -> bool {
    let receivers: Vec<Receiver> = lines(bytes)
        .filter_map(|line: PointLine| line.receiver(TRIANGLES.len()).ok())
        .take(MOST)
        .collect();
    let [near, far, first] = [
        SolverSettings::new(1.5),
        SolverSettings::new(f64::INFINITY),
        SolverSettings {
            falloff: Falloff::Sqrt,
            fragments: true,
            ..SolverSettings::new(2.5)
        },
    ];
    for settings in [near, far, first] {
        answers(&receivers, settings);
    }
    !receivers.is_empty()
}

/// Parses bytes as the lines of a lights file, and checks the form factors of the lights from three points.
/// Returns true if the file contains a light.
///
/// # Panics
/// If a factor is not finite, or not between 0 and 1 within its bound. No input may cause that.
pub fn lights(bytes: &[u8]) -> bool {
    let lights: Vec<Light> = lines(bytes)
        .filter_map(|line: LightLine| Some(line.light().ok()?.1))
        .take(MOST)
        .collect();
    let is_any = !lights.is_empty();
    let at = |point: [f64; 3], normal, triangle| Receiver {
        point: point.into(),
        normal,
        triangle,
    };
    let receivers = [
        at([0.25, 0.25, 0.0], DVec3::Z, Some(TriangleId(0))),
        at([0.5, 0.25, 0.0], DVec3::Z, Some(TriangleId(0))),
        at([-1.0, 2.0, 0.5], DVec3::new(0.6, 0.0, 0.8), None),
    ];
    answers(
        &receivers,
        SolverSettings {
            lights,
            ..SolverSettings::new(2.0)
        },
    );
    is_any
}

/// Computes the answers for `receivers`, and checks the answers.
fn answers(receivers: &[Receiver], settings: SolverSettings) {
    let corners = |t: &[[f32; 3]; 3]| Triangle {
        v: t.map(Vec3::from),
    };
    let object = Object {
        name: "fuzz".to_owned(),
        first: 0,
        count: TRIANGLES.len() as u32,
    };
    let scene = Scene::new(
        "fuzz",
        TRIANGLES.iter().map(corners).collect(),
        vec![object],
    );
    let prepared = scene.and_then(|scene| AmbientScene::new(&scene, settings.fragments));
    let solver = prepared
        .as_ref()
        .map(|prepared| Solver::new(prepared, settings.clone()));
    assert!(
        solver.is_ok(),
        "the scene of the fuzz targets must be valid"
    );
    let Ok(solver) = solver else { return };
    for (receiver, answer) in receivers.iter().zip(solver.solve(receivers, |_| {})) {
        let ReceiverResult {
            openness,
            lights,
            fragments,
            ..
        } = &answer;
        let bound = openness.bound;
        assert!(
            bound.is_finite() && bound >= 0.0,
            "{receiver:?}: {openness:?}"
        );
        for share in lights.iter().chain([&openness.open]) {
            // Rounding errors, which the bound includes, can move Lambert's formula out of the range.
            assert!(
                *share >= 0.0 && *share <= 1.0 + bound,
                "{receiver:?}: {share} within {bound}"
            );
        }
        assert_eq!(lights.len(), settings.lights.len(), "{receiver:?}");
        let factors: f64 = fragments.iter().map(|f| f.factor).sum();
        assert!(
            factors.is_finite() && factors <= 1.0 + bound,
            "{receiver:?}: the fragments cover {factors} of the hemisphere"
        );
    }
}
