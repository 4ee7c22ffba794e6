//! Tests of the division: tetrahedra meet face to face, fill the box, and cover each triangle.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_scene::{Object, Scene, Triangle};
use sightline_tetra::division::divide;
use sightline_tetra::{Quiet, build};

type T = [[f32; 3]; 3];

fn check(triangles: &[T]) -> Result<(), TestCaseError> {
    let all: Vec<Triangle> = triangles
        .iter()
        .map(|t| Triangle {
            v: t.map(Vec3::from_array),
        })
        .collect();
    let count = all.len() as u32;
    let object = Object {
        name: "all".into(),
        first: 0,
        count,
    };
    let built = build(&Scene::new("test", all, vec![object]).unwrap(), &Quiet).unwrap();
    let divided = divide(&built.contents());
    let place = |v: u32| DVec3::from(divided.places[v as usize]);
    let corners = &built.cells.points[built.cells.points.len() - 8..];
    let size = (Vec3::from(corners[7]) - Vec3::from(corners[0])).as_dvec3();
    let mut volume = 0.0;
    let mut faces: BTreeMap<[u32; 3], Vec<bool>> = BTreeMap::new();
    for [a, b, c, d] in &divided.tetrahedra {
        let [p, q, r, s] = [*a, *b, *c, *d].map(place);
        let part = (q - p).cross(r - p).dot(s - p) / 6.0;
        prop_assert!(part > -1e-12 * size.element_product(), "turned: {}", part);
        volume += part;
        for face in [[*a, *b, *c], [*a, *d, *b], [*b, *d, *c], [*c, *d, *a]] {
            let mut sorted = face;
            sorted.sort_unstable();
            prop_assert!(
                sorted[0] < sorted[1] && sorted[1] < sorted[2],
                "flat: {:?}",
                face
            );
            let at = (0..3).find(|k| face[*k] == sorted[0]).unwrap();
            faces
                .entry(sorted)
                .or_default()
                .push(face[(at + 1) % 3] == sorted[1]);
        }
    }
    prop_assert!(
        (volume / size.element_product() - 1.0).abs() < 1e-12,
        "{} of {}",
        volume,
        size
    );
    for (face, sides) in &faces {
        // The places of the corners are rounded.
        let is_at = |v: &u32, k: usize, c: &[f32; 3]| {
            (place(*v)[k] - f64::from(c[k])).abs() < 1e-12 * size[k]
        };
        let on_box = (0..3).any(|k| {
            [corners[0], corners[7]]
                .iter()
                .any(|c| face.iter().all(|v| is_at(v, k, c)))
        });
        match sides[..] {
            [_] => prop_assert!(on_box, "{:?} has one tetrahedron", face),
            [one, other] => prop_assert!(one != other && !on_box, "{:?}", face),
            _ => prop_assert!(false, "{:?} has {} tetrahedra", face, sides.len()),
        }
    }
    let mut covered = vec![0.0; triangles.len()];
    for (face, triangle) in divided.faces.iter().zip(&divided.triangles) {
        let mut sorted = *face;
        sorted.sort_unstable();
        prop_assert!(faces.contains_key(&sorted));
        let [p, q, r] = face.map(place);
        covered[*triangle as usize] += (q - p).cross(r - p).length();
    }
    for (t, covered) in triangles.iter().zip(covered) {
        let [p, q, r] = t.map(|v| Vec3::from(v).as_dvec3());
        let whole = (q - p).cross(r - p).length();
        prop_assert!(
            (covered - whole).abs() < 1e-9 * size.length_squared(),
            "{} of {}",
            covered,
            whole
        );
    }
    Ok(())
}

#[test]
fn known_scenes_divide_face_to_face() {
    // The scene has a T-junction, triangles that cross one another, and a triangle in another's plane.
    check(&[
        [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
        [[1.0, 0.0, -2.0], [2.0, 0.0, 2.0], [3.0, 0.0, 0.0]],
        [[1.0, 1.0, -2.0], [1.0, 1.0, 2.0], [3.0, 3.0, 1.0]],
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    ])
    .unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn lattice_soups_divide_face_to_face(
        soup in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-3i8..4)), 1..10)
    ) {
        let soup: Vec<T> = soup.into_iter().map(|t| t.map(|p| p.map(f32::from))).collect();
        check(&soup)?;
    }

    #[test]
    fn float_soups_divide_face_to_face(
        soup in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-1.0f32..1.0)), 1..7)
    ) {
        check(&soup)?;
    }
}
