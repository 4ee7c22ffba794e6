//! The bodies of the fuzz targets `soup` and `tets`, which the tests also call.

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};

use crate::build::build;
use crate::check::check;
use crate::file::layout::seal;
use crate::file::{Tets, write};
use crate::point_query::{Engine, Mode, Scratch, Target, View};
use crate::watch::Quiet;

/// Maximum number of triangles of one call, which bounds its duration.
const MOST: usize = 10;
/// Size of a point in single precision, in bytes.
const POINT: usize = 12;

/// Returns a `.tets` file of three triangles that overlap or cross, as a seed for mutations.
pub fn seed() -> Vec<u8> {
    let triangles = [
        [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
        [[1.0, 1.0, -2.0], [1.0, 1.0, 2.0], [3.0, 3.0, 1.0]],
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    ];
    file(&triangles).unwrap_or_default()
}

fn file(triangles: &[[[f32; 3]; 3]]) -> Option<Vec<u8>> {
    let all: Vec<Triangle> = triangles
        .iter()
        .map(|t| Triangle {
            v: t.map(Vec3::from_array),
        })
        .collect();
    let count = all.len() as u32;
    let scene = Scene::new(
        "fuzz",
        all,
        vec![Object {
            name: "all".into(),
            first: 0,
            count,
        }],
    )
    .ok()?;
    // `build` rejects points whose enclosing box exceeds single precision.
    let built = build(&scene, &Quiet).ok()?;
    assert_eq!(check(&built.contents()), Ok(()), "{triangles:?}");
    let mut file = Vec::new();
    write(&mut file, &built.contents()).ok()?;
    Some(file)
}

/// Builds and queries a scene whose viewpoint and triangle corners are read from bytes. Returns true if the
/// cells were built.
///
/// The bytes are coordinates in single precision. The function checks that the cells pass the checker, that
/// both engines return the same triangles, and that all solid angles add up to 4π.
///
/// # Panics
/// Panics if one of these checks fails. No input may cause a panic.
pub fn soup(bytes: &[u8]) -> bool {
    let mut points = bytes.chunks_exact(POINT).map(|c| -> [f32; 3] {
        std::array::from_fn(|k| {
            let x = f32::from_le_bytes(std::array::from_fn(|i| c[k * 4 + i]));
            if x.is_finite() { x } else { 0.0 }
        })
    });
    let Some(eye) = points.next() else {
        return false;
    };
    let mut triangles = Vec::new();
    while let (true, Some(a), Some(b), Some(c)) = (
        triangles.len() < MOST,
        points.next(),
        points.next(),
        points.next(),
    ) {
        triangles.push([a, b, c]);
    }
    let Some(tets) = file(&triangles).map(|file| Tets::from_bytes(&file)) else {
        return false;
    };
    let tets = tets.expect("a file that was just written is read");
    let mut scratch = Scratch::default();
    let eye = eye.map(f64::from);
    let [boxes, cells] = [Engine::Boxes, Engine::Cells].map(|engine| {
        let view = View {
            engine,
            witnesses: true,
            ..View::default()
        };
        tets.look(eye, &view, Mode::Exact, &mut scratch)
            .expect("a finite point")
            .clone()
    });
    assert_eq!(boxes.visible, cells.visible, "from {eye:?}: {triangles:?}");
    let whole = boxes.areas.iter().sum::<f64>() + boxes.sky + boxes.unseen;
    assert!(
        (whole - 4.0 * std::f64::consts::PI).abs() < 1e-9,
        "{whole} from {eye:?}: {triangles:?}"
    );
    true
}

/// Reads bytes as a `.tets` file after correcting the checksums, and queries the file. Returns true if
/// [`Tets::from_bytes`] accepts the file.
///
/// No input may cause a panic or an endless query.
pub fn tets(bytes: &[u8]) -> bool {
    // The first attempt uses the unchanged bytes, whose checksums may be wrong.
    let _ = Tets::from_bytes(bytes).is_ok();
    let mut bytes = bytes.to_vec();
    seal(&mut bytes);
    let Ok(tets) = Tets::from_bytes(&bytes) else {
        return false;
    };
    // The checker may report any fault.
    let _ = check(&tets.contents());
    let mut scratch = Scratch::default();
    for x in [[0.25, 0.5, 0.125], [0.0, 0.0, 0.0], [-1e6, 3.0, 1e6]] {
        let _ = tets.inside(x, &mut scratch);
        for engine in [Engine::Boxes, Engine::Cells] {
            let view = View {
                engine,
                ..View::default()
            };
            let _ = tets.look(x, &view, Mode::Exact, &mut scratch);
            let target = Target {
                low: [0.5; 3],
                high: [1.0; 3],
            };
            let _ = tets.sees_in(x, &target, &view, Mode::Aggressive(0.01), &mut scratch);
        }
    }
    true
}
