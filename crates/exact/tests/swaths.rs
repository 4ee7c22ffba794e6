//! Tests of the antipenumbra of sequences of polygons: known sequences, counts, and brute force.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use glam::{DVec3, Quat};
use proptest::prelude::*;
use sightline_exact::{
    Antipenumbra, NoAntipenumbra, PointOrigin, Polygon, QueryLimits, Stabbed, Surface,
    antipenumbra, stab,
};

fn polygon(corners: &[DVec3]) -> Polygon {
    Polygon::exact(corners.iter().map(|p| PointOrigin::Given(*p)).collect()).unwrap()
}

/// Creates a regular triangle about an axis with rounded corners, which is exactly flat as a triangle.
fn triangle(centre: DVec3, size: f64, turn: f64, tilt: f64) -> Polygon {
    let turn_by = Quat::from_euler(
        glam::EulerRot::ZYX,
        turn as f32,
        tilt as f32,
        0.6 * tilt as f32,
    )
    .as_dquat();
    let corner = |k: f64| {
        let angle = std::f64::consts::TAU * k / 3.0;
        // The corners are on a grid of 2⁻²⁰, so that exact numbers stay short.
        ((centre + turn_by * DVec3::new(size * angle.cos(), size * angle.sin(), 0.0)) * 1_048_576.0)
            .round()
            / 1_048_576.0
    };
    polygon(&[corner(0.0), corner(1.0), corner(2.0)])
}

fn found(portals: &[Polygon]) -> Antipenumbra {
    assert!(matches!(
        stab(portals, &QueryLimits::default(), &|| false).0,
        Stabbed::Line(_)
    ));
    antipenumbra(portals, &QueryLimits::default()).unwrap()
}

#[test]
fn two_triangles_have_nine_lines_and_six_boundary_planes() {
    let portals = [
        triangle(DVec3::ZERO, 1.0, 0.1, 0.05),
        triangle(DVec3::new(0.1, 0.2, 2.0), 0.8, 0.7, -0.1),
    ];
    let found = found(&portals);
    // The polytope is the product of two triangles.
    assert_eq!(found.polytope, [9, 18, 15]);
    assert_eq!(found.lines, 9);
    assert_eq!(found.swaths.len(), 18);
    let boundary: Vec<_> = found.swaths.iter().filter(|s| s.is_boundary).collect();
    assert_eq!(boundary.len(), 6, "a + b of them");
    assert!(
        boundary
            .iter()
            .all(|s| matches!(s.surface, Surface::Plane(_)) && s.in_loop == Some(0))
    );
    assert!(
        found
            .swaths
            .iter()
            .all(|s| s.edges.len() == 3 && s.is_boundary == s.in_loop.is_some())
    );
}

#[test]
fn edges_along_hyperbolic_paraboloid_have_its_quadric() {
    let thin = 1.0 / 128.0;
    // The slits are x from 3 to 5, y = xz ± 2⁻⁷ at z = 0, 1, 2.
    let slit = |z: f64| {
        let at = |x: f64, by: f64| DVec3::new(x, x * z + by, z);
        polygon(&[at(3.0, -thin), at(5.0, -thin), at(5.0, thin), at(3.0, thin)])
    };
    let found = found(&[slit(0.0), slit(1.0), slit(2.0)]);
    let quadrics: Vec<_> = found
        .swaths
        .iter()
        .filter_map(|s| {
            if let Surface::Quadric(q) = s.surface {
                Some((q, &s.edges))
            } else {
                None
            }
        })
        .collect();
    // The lower edges have y = xz − 2⁻⁷, so 2C = 1, 2G = −1, J = −2⁻⁷ up to a factor.
    let lower = |edges: &Vec<[usize; 2]>| edges.iter().all(|e| e[1] == 0);
    let (q, _) = quadrics.iter().find(|(_, edges)| lower(edges)).unwrap();
    let scale = 0.5 / q[2];
    let scaled = q.map(|c| c * scale);
    let wanted = [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0, -thin];
    assert!(
        scaled
            .iter()
            .zip(wanted)
            .all(|(a, b)| (a - b).abs() < 1e-12),
        "{scaled:?}"
    );
}

#[test]
fn single_polygon_has_no_antipenumbra() {
    let square = polygon(&[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]);
    assert_eq!(
        antipenumbra(&[square], &QueryLimits::default()),
        Err(NoAntipenumbra::Single)
    );
}

/// Evaluates the equation of a surface at a point.
fn height(surface: &Surface, p: DVec3) -> f64 {
    let DVec3 { x, y, z } = p;
    match surface {
        Surface::Plane([a, b, c, d]) => a * x + b * y + c * z + d,
        Surface::Quadric(q) => {
            let [a, b, c, d, e, f, g, h, i, j] = *q;
            a * x * x
                + 2.0 * (b * x * y + c * x * z + d * x)
                + e * y * y
                + 2.0 * (f * y * z + g * y)
                + h * z * z
                + 2.0 * i * z
                + j
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn polytopes_are_simple_and_planes_bound_light(
        turns in prop::array::uniform4(0.0f64..6.3),
        tilts in prop::array::uniform4(-0.3f64..0.3),
        offs in prop::array::uniform4((-0.3f64..0.3, -0.3f64..0.3)),
        n in 2usize..5,
    ) {
        let portals: Vec<Polygon> = (0..n)
            .map(|k| triangle(DVec3::new(offs[k].0, offs[k].1, 2.0 * k as f64), 1.0, turns[k], tilts[k]))
            .collect();
        prop_assume!(matches!(stab(&portals, &QueryLimits::default(), &|| false).0, Stabbed::Line(_)));
        let found = antipenumbra(&portals, &QueryLimits::default()).unwrap();
        let [v, e, f2] = found.polytope;
        // In general position, five facets meet at a vertex (four in the quotient by the line in which two
        // planes meet). The number of 2-faces follows from the number f of facets.
        if n == 2 {
            prop_assert_eq!([v, e, f2], [9, 18, 15]);
        } else {
            prop_assert_eq!(2 * e, 5 * v);
            let two_faces = |f: usize| 10 + 6 * (f - 5) + 4 * (v / 2 + 4 - f);
            prop_assert!(
                (6..=3 * n).any(|f| v / 2 + 4 >= f && two_faces(f) == f2),
                "{v} vertices, {f2} 2-faces"
            );
        }
        prop_assert_eq!(found.swaths.len(), 2 * found.lines);
        let boundary: Vec<_> = found.swaths.iter().filter(|s| s.is_boundary).collect();
        prop_assert!(boundary.len() >= 3);
        // Beyond the last polygon, stabbing lines are on only one side of each boundary plane.
        let mut random = sightline_numbers::random::SplitMix64::new((turns[0] * 1e6) as u64);
        let mut unit = || random.unit_f64();
        let inside = |p: &Polygon, at: DVec3| {
            let c = p.rounded();
            let normal = (c[1] - c[0]).cross(c[2] - c[0]);
            (0..3).all(|k| (c[(k + 1) % 3] - c[k]).cross(at - c[k]).dot(normal) > 0.0)
        };
        let mut sides = vec![[false; 2]; boundary.len()];
        for _ in 0..3000 {
            let mut on = |p: &Polygon| {
                let c = p.rounded();
                let (s, t) = (unit().sqrt(), unit());
                c[0] * (1.0 - s) + c[1] * (s * (1.0 - t)) + c[2] * (s * t)
            };
            let (a, b) = (on(&portals[0]), on(&portals[n - 1]));
            let through = |p: &Polygon| {
                let c = p.rounded();
                let normal = (c[1] - c[0]).cross(c[2] - c[0]);
                let t = normal.dot(c[0] - a) / normal.dot(b - a);
                inside(p, a + (b - a) * t)
            };
            if portals[1..n - 1].iter().all(through) {
                for (swath, sides) in boundary.iter().zip(&mut sides) {
                    if matches!(swath.surface, Surface::Plane(_)) {
                        let at = height(&swath.surface, b + (b - a) * 0.5);
                        sides[0] |= at > 1e-9;
                        sides[1] |= at < -1e-9;
                    }
                }
            }
        }
        prop_assert!(sides.iter().all(|s| *s != [true, true]), "lit on both sides of a boundary plane");
    }
}
