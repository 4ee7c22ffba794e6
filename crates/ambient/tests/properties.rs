//! Properties that hold in every scene: scenes with crossing, doubled, touching and degenerate triangles on a
//! small grid, and with random triangles.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use sightline_ambient::{AmbientScene, Falloff, Receiver, ReceiverResult, Solver, SolverSettings};
use sightline_scene::{Object, Scene, Triangle};

fn scene(triangles: &[[Vec3; 3]]) -> Scene {
    let triangles: Vec<Triangle> = triangles.iter().map(|v| Triangle { v: *v }).collect();
    let object = Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    Scene::new("test", triangles, vec![object]).unwrap()
}

fn solve(
    triangles: &[[Vec3; 3]],
    settings: &SolverSettings,
    receivers: &[Receiver],
) -> Vec<ReceiverResult> {
    let prepared = AmbientScene::new(&scene(triangles), settings.fragments).unwrap();
    Solver::new(&prepared, settings.clone()).solve(receivers, |_| {})
}

fn settings(distance: f64) -> SolverSettings {
    SolverSettings::new(distance)
}

/// Generates triangles on a small grid of whole numbers. Many of them share planes, edges and corners, and
/// some planes contain receivers.
fn on_grid(most: usize) -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    let corner = prop::array::uniform3(-3i32..4).prop_map(|c| Vec3::from(c.map(|x| x as f32)));
    prop::collection::vec(prop::array::uniform3(corner), 1..most)
}

/// Generates random triangles in a box.
fn anywhere(most: usize) -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    let corner = prop::array::uniform3(-3.0f32..3.0).prop_map(Vec3::from);
    prop::collection::vec(prop::array::uniform3(corner), 1..most)
}

fn triangles(most: usize) -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    prop_oneof![on_grid(most), anywhere(most)]
}

/// Generates receivers near the middle that look in any direction. Some of them are in planes of the grid.
fn receivers(most: usize) -> impl Strategy<Value = Vec<Receiver>> {
    let at = prop_oneof![
        prop::array::uniform3(-1.5f64..1.5),
        Just([0.5, 0.25, 0.0]),
        Just([0.0, 0.3, 0.1])
    ];
    let normal = prop_oneof![prop::array::uniform3(-1.0f64..1.0), Just([0.0, 0.0, 1.0])];
    let one = (at, normal).prop_filter_map("a direction", |(at, normal)| {
        let normal = DVec3::from(normal).try_normalize()?;
        Some(Receiver {
            point: DVec3::from(at),
            normal,
            triangle: None,
        })
    });
    prop::collection::vec(one, 1..most)
}

fn distances() -> impl Strategy<Value = f64> {
    prop_oneof![Just(f64::INFINITY), 0.3f64..6.0]
}

/// Returns true if a ray meets a triangle closer than a distance. Returns `None` if the ray passes too near
/// an edge to decide.
fn meets(t: &[Vec3; 3], x: DVec3, ray: DVec3, distance: f64) -> Option<bool> {
    let [a, b, c] = t.map(|v| v.as_dvec3() - x);
    let normal = (b - a).cross(c - a);
    if normal.length() == 0.0 || normal.dot(a).abs() < 1e-9 * normal.length() {
        return Some(false);
    }
    let sides = [a.cross(b), b.cross(c), c.cross(a)].map(|m| m.dot(ray));
    let far = normal.dot(a) / normal.dot(ray);
    let inside = sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0);
    let near_edge = sides.iter().any(|s| s.abs() < 1e-9) || (far - distance).abs() < 1e-9;
    if near_edge && far > -1e-9 {
        None
    } else {
        Some(inside && far > 0.0 && far < distance)
    }
}

/// Configures more cases than the default, because most cases take only a millisecond.
fn cases() -> ProptestConfig {
    let usual = ProptestConfig::default();
    ProptestConfig {
        cases: usual.cases.max(400),
        ..usual
    }
}

proptest! {
    #![proptest_config(cases())]

    /// Jittered rays agree with the computed openness, within five of their standard deviations.
    #[test]
    fn rays_agree_with_openness(soup in triangles(24), at in receivers(2), distance in distances()) {
        let answer = &solve(&soup, &settings(distance), &at)[0];
        let r = at[0];
        let (u, v) = r.normal.any_orthonormal_pair();
        let (side, mut free) = (96u32, 0u32);
        for i in 0..side * side {
            // Jitter with a fixed sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom
            // sequences").
            let [a, b] = [0.7548776662466927, 0.5698402909980532].map(|step| (f64::from(i) * step) % 1.0);
            let s = (f64::from(i / side) + a) / f64::from(side);
            let (y, x) = ((f64::from(i % side) + b) / f64::from(side) * TAU).sin_cos();
            let ray = (u * x + v * y) * s.sqrt() + r.normal * (1.0 - s).sqrt();
            free += u32::from(!soup.iter().any(|t| meets(t, r.point, ray, distance) == Some(true)));
        }
        let n = f64::from(side * side);
        let sampled = f64::from(free) / n;
        // Jitter cells that no border crosses have no variance.
        let deviation = (sampled * (1.0 - sampled) / n).sqrt().max(1.0 / n);
        let off = (sampled - answer.openness.open).abs();
        prop_assert!(off < 5.0 * deviation, "{} by rays, {} by parts", sampled, answer.openness.open);
    }

    /// Fragments and the free part add up to the whole, each fragment is visible, and both methods agree.
    #[test]
    fn fragments_add_up_and_are_visible(soup in triangles(16), at in receivers(4), distance in distances()) {
        let plain = solve(&soup, &settings(distance), &at);
        let all = solve(&soup, &SolverSettings { fragments: true, ..settings(distance) }, &at);
        for ((r, plain), answer) in at.iter().zip(&plain).zip(&all) {
            let sum: f64 = answer.fragments.iter().map(|f| f.factor).sum();
            prop_assert!((sum + answer.openness.open - 1.0).abs() < 1e-9 + answer.openness.bound, "{}", sum);
            let bound = 1e-9 + plain.openness.bound + answer.openness.bound;
            prop_assert!((plain.openness.open - answer.openness.open).abs() < bound);
            for f in answer.fragments.iter().filter(|f| f.factor > 1e-7) {
                let middle = f.directions.iter().sum::<DVec3>().normalize();
                let met = |t: &[Vec3; 3]| meets(t, r.point, middle, distance);
                let own = soup[f.polygon as usize];
                prop_assert!(met(&own) != Some(false), "triangle {} is not met", f.polygon);
                let way = |t: &[Vec3; 3]| {
                    let [a, b, c] = t.map(|v| v.as_dvec3() - r.point);
                    let n = (b - a).cross(c - a);
                    n.dot(a) / n.dot(middle)
                };
                for t in soup.iter().filter(|t| met(t) == Some(true)) {
                    prop_assert!(way(t) > way(&own) - 1e-6, "{:?} is nearer than {}", t, f.polygon);
                }
            }
        }
    }

    /// An additional triangle never increases the openness.
    #[test]
    fn additional_triangle_never_increases_openness(
        soup in triangles(16), at in receivers(3), distance in distances(), sqrt: bool,
    ) {
        prop_assume!(!sqrt || distance.is_finite());
        let falloff = if sqrt { Falloff::Sqrt } else { Falloff::None };
        let settings = SolverSettings { falloff, ..settings(distance) };
        // A triangle that is too far away to count replaces the first triangle.
        let far = [[1e6, 0.0, 0.0], [1e6, 1e-3, 0.0], [1e6, 0.0, 1e-3]].map(Vec3::from);
        let less = &[&[far], &soup[1..]].concat();
        for (with, without) in solve(&soup, &settings, &at).iter().zip(solve(less, &settings, &at)) {
            let bound = 1e-9 + with.openness.bound + without.openness.bound;
            let (with, without) = (with.openness.open, without.openness.open);
            prop_assert!(with <= without + bound, "{} after {}", with, without);
        }
    }

    /// The division of triangles does not affect the openness. Corners are on a grid, so midpoints are exact.
    #[test]
    fn division_does_not_change_openness(
        soup in on_grid(10), at in receivers(3), distance in distances(), sqrt: bool,
    ) {
        prop_assume!(!sqrt || distance.is_finite());
        let falloff = if sqrt { Falloff::Sqrt } else { Falloff::None };
        let settings = SolverSettings { falloff, ..settings(distance) };
        let divided: Vec<[Vec3; 3]> = soup
            .iter()
            .flat_map(|[a, b, c]| {
                let [d, e, f] = [(*a + *b) * 0.5, (*b + *c) * 0.5, (*c + *a) * 0.5];
                [[*a, d, f], [d, *b, e], [f, e, *c], [e, f, d]]
            })
            .collect();
        for (one, four) in solve(&soup, &settings, &at).iter().zip(solve(&divided, &settings, &at)) {
            let off = (one.openness.open - four.openness.open).abs();
            prop_assert!(off < 1e-9 + one.openness.bound + four.openness.bound, "off by {}", off);
        }
    }

    /// The division into blocks changes answers only within their bounds.
    #[test]
    fn blocks_do_not_change_openness(soup in triangles(20), at in receivers(20), distance in distances()) {
        let alone = SolverSettings { block: (1, 1.0), ..settings(distance) };
        let together = SolverSettings { block: (64, 100.0), ..settings(distance) };
        for (one, many) in solve(&soup, &alone, &at).iter().zip(solve(&soup, &together, &at)) {
            let off = (one.openness.open - many.openness.open).abs();
            prop_assert!(off < 1e-9 + one.openness.bound + many.openness.bound, "off by {}", off);
        }
    }
}
