//! Tests of the rule: all traversals and instruction sets have the hits of a search through all triangles,
//! and no ray leaves a closed surface.

use std::sync::Arc;

use fearless_simd::Level;
use glam::{DVec3, Vec3};
use sightline_scene::{Object, Scene, Side, Sides, Triangle};

use super::*;
use crate::cube::{SKY, Strata};
use crate::packet::{Halves, LANES, Packet};
use crate::sequence::Hashed;

const SPEC: CubeSpec = CubeSpec {
    resolution: 16,
    strata: Strata::One,
    keep_pixels: false,
};

/// Returns the instruction sets of this machine.
pub(crate) fn levels() -> Vec<Level> {
    let best = Level::new();
    #[cfg(target_arch = "x86_64")]
    {
        let lower = [
            best.as_sse2().map(Level::Sse2),
            best.as_sse4_2().map(Level::Sse4_2),
            best.as_avx2().map(Level::Avx2),
            best.as_avx512().map(Level::Avx512),
        ];
        lower.into_iter().flatten().collect()
    }
    #[cfg(not(target_arch = "x86_64"))]
    vec![best]
}

fn scene(triangles: Vec<Triangle>, sides: Option<Vec<Side>>) -> Arc<Scene> {
    let count = triangles.len() as u32;
    let objects = vec![Object {
        name: "all".to_owned(),
        first: 0,
        count,
    }];
    let scene = Scene::new("test", triangles, objects).unwrap();
    Arc::new(match sides {
        Some(sides) => {
            let runs = Sides::from_runs(sides.into_iter().map(|side| (1, side)));
            scene.with_sides("test", runs).unwrap()
        }
        None => scene,
    })
}

/// The scale of a scene, and the position to which it is moved after the scaling.
#[derive(Clone, Copy)]
struct Place {
    scale: f32,
    moved: Vec3,
}

/// The place of a scene that is not scaled and not moved.
const HERE: Place = Place {
    scale: 1.0,
    moved: Vec3::ZERO,
};

/// Returns triangles of very different sizes. Half have vertices on a lattice, so that many are coplanar,
/// share vertices and edges, or are equal.
fn soup(count: u32, scale: f32, random: &mut Hashed) -> Vec<Triangle> {
    (0..count)
        .map(|i| {
            let centre = random.point() * 32.0;
            let size = (random.unit() * 8.0 - 5.0).exp2();
            let mut corner = || centre + (random.point() - 0.5) * size * 8.0;
            let v = [corner(), corner(), corner()];
            let v = if i.is_multiple_of(2) {
                v.map(Vec3::round)
            } else {
                v
            };
            Triangle {
                v: v.map(|v| v * scale),
            }
        })
        .collect()
}

/// Returns packets of rays: from lattice points to lattice points, from one origin in similar directions, and
/// along axes. Some packets are not full. The scene is scaled and then moved.
fn packets(count: u32, place: Place, random: &mut Hashed) -> Vec<Packet> {
    (0..count)
        .map(|i| {
            let mut packet = Packet::default();
            let origin = random.point() * 40.0 - 4.0;
            let towards = random.point() - 0.5;
            for lane in 0..1 + (random.bits() % LANES as u64) as u32 {
                let (from, direction) = match i % 4 {
                    0 => {
                        let [a, b] = [0; 2].map(|_| (random.point() * 32.0).round());
                        (a, b - a)
                    }
                    1 => (origin, towards + (random.point() - 0.5) * 0.2),
                    2 => (
                        origin.round(),
                        Vec3::AXES[lane as usize % 3] * (lane as f32 - 7.5),
                    ),
                    _ => (origin, random.point() - 0.5),
                };
                let origin = from * place.scale + place.moved;
                packet.push(origin.to_array(), (direction * place.scale).to_array());
            }
            packet
        })
        .collect()
}

/// A separate implementation of the rule, which searches through all triangles.
struct Search<'a> {
    triangles: &'a [Triangle],
    sides: &'a [Side],
    moved: DVec3,
    scale: f64,
}

impl Search<'_> {
    /// Returns the distances along a ray of all triangles that it meets beyond `from`.
    fn hits(
        &self,
        origin: [f32; 3],
        direction: [f32; 3],
        from: f32,
        back: bool,
    ) -> Vec<(f64, f32, u32)> {
        let largest = direction.iter().fold(0.0f32, |m, d| m.max(d.abs()));
        if largest < f32::MIN_POSITIVE {
            return Vec::new();
        }
        let shorten = (-f64::from(largest).log2().floor()).exp2();
        let d = direction.map(|d| (f64::from(d) * shorten) as f32);
        let convert = |v: Vec3| ((v.as_dvec3() - self.moved) * self.scale).as_vec3();
        let o = convert(origin.into()).to_array();
        let main = (0..3)
            .rev()
            .max_by(|a, b| d[*a].abs().total_cmp(&d[*b].abs()))
            .unwrap();
        let [x, y, z] = [(main + 1) % 3, (main + 2) % 3, main];
        let shear = [d[x] / d[z], d[y] / d[z]];
        let forward = f64::from(if back { -d[z] } else { d[z] });
        let unit = self.scale / shorten;
        let mut met = Vec::new();
        for (id, triangle) in (0..).zip(self.triangles) {
            let mut v = triangle.v.map(|v| convert(v).to_array());
            let side = self.sides.get(id as usize).copied().unwrap_or(Side::Both);
            if side == Side::Clockwise {
                v.swap(1, 2);
            }
            let [a, b, c] = v.map(|v| {
                let depth = v[z] - o[z];
                let sheared = [
                    (v[x] - o[x]) - shear[0] * depth,
                    (v[y] - o[y]) - shear[1] * depth,
                ];
                DVec3::new(
                    f64::from(sheared[0]),
                    f64::from(sheared[1]),
                    f64::from(depth),
                )
            });
            let edge = |p: DVec3, q: DVec3| p.x * q.y - p.y * q.x;
            let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
            let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
            let area = (u + v) + w;
            let front = side == Side::Both || area * forward > 0.0;
            if !inside || area == 0.0 || !front {
                continue;
            }
            let exact = ((u * a.z + v * b.z) + w * c.z) / (area * forward);
            let t = exact as f32;
            if t > (f64::from(from) * unit) as f32 {
                met.push((exact, (f64::from(t) / unit) as f32, id));
            }
        }
        // Both zeros are equal distances.
        met.sort_by(|a, b| a.0.partial_cmp(&b.0).unwrap().then(a.2.cmp(&b.2)));
        met
    }
}

/// Returns the bits of all hits, and the passed triangles of each line.
fn hit_bits(packets: &[Packet], passed: &[(u32, u32, f32)]) -> (Vec<u32>, Vec<[u32; 2]>) {
    let lanes = packets.iter().flat_map(|packet| {
        (0..packet.count).flat_map(|lane| [packet.distance[lane].to_bits(), packet.triangle[lane]])
    });
    let mut passed: Vec<[u32; 2]> = passed.iter().map(|hit| [hit.0, hit.1]).collect();
    passed.sort_unstable();
    passed.dedup();
    (lanes.collect(), passed)
}

/// Compares one traversal on a scene with the search, and the others and all instruction sets with it.
fn compare(
    triangles: Vec<Triangle>,
    sides: Option<Vec<Side>>,
    passed: bool,
    place: Place,
    count: u32,
    random: &mut Hashed,
) {
    let scene = scene(triangles, sides.clone());
    let degenerate = |id: &u32| scene.triangles()[*id as usize].is_degenerate();
    let ids: Vec<u32> = (0..scene.len()).collect();
    let (ending, see_through): (Vec<u32>, Vec<u32>) =
        ids.iter().partition(|id| !passed || **id % 3 != 0);
    let backend = CpuBackend::new(Arc::clone(&scene), SPEC).unwrap();
    let built = backend.build_lines(&ending, &see_through).unwrap();
    let search = Search {
        triangles: scene.triangles(),
        sides: sides.as_deref().unwrap_or(&[]),
        moved: built.hierarchy.units.origin.as_dvec3(),
        scale: f64::from(built.hierarchy.units.scale),
    };
    let near = built.near;
    let mut built = Arc::into_inner(built).unwrap();
    let step = 1e-4 * place.scale;
    let mut rays = packets(count, place, random);
    for packet in rays.iter_mut().step_by(3) {
        packet.distance = std::array::from_fn(|_| random.unit() * 2.0);
    }
    // Both halves: each packet, then the same packet reversed.
    let mut halves: Vec<Packet> = Vec::new();
    for packet in &rays {
        let mut behind = packet.reversed(step);
        behind.distance = packet.distance;
        halves.extend([packet.clone(), behind]);
    }
    let (mut met, mut free) = (0, 0);
    let mut of_first_level = Vec::new();
    for (number, level) in levels().into_iter().enumerate() {
        built.level = level;
        let tracer = CpuTracer(Arc::new(built));
        let ways = [
            (Halves::Rays, false),
            (Halves::Rays, true),
            (Halves::Lines { step }, false),
            (Halves::Lines { step }, true),
        ];
        for (way, (kind, coherent)) in ways.into_iter().enumerate() {
            let is_pair = kind != Halves::Rays;
            let given = if is_pair { &halves } else { &rays };
            let mut traced = given.clone();
            let mut found = Vec::new();
            tracer.trace_packets(&mut traced, kind, coherent, Some(&mut found));
            assert!(found.is_sorted_by_key(|f| f.0 / LANES as u32));
            let bits = hit_bits(&traced, &found);
            if number > 0 || coherent {
                let is_equal = bits == of_first_level[way / 2];
                assert!(is_equal, "{level:?} {kind:?} {coherent}");
                continue;
            }
            of_first_level.push(bits);
            for (k, packet) in traced.iter().enumerate() {
                let back = is_pair && k % 2 == 1;
                let first = &given[if back { k - 1 } else { k }];
                for lane in 0..packet.count {
                    let (origin, direction) = first.ray(lane);
                    let advance = if back { first.advance(lane, step) } else { 0.0 };
                    let until = given[k].distance[lane];
                    let hits = search.hits(origin, direction, near - advance, back);
                    let hits = hits.into_iter().filter(|h| !degenerate(&h.2));
                    let end = hits.clone().find(|h| !passed || h.2 % 3 != 0);
                    let end = end.filter(|h| h.1 <= until - advance);
                    let own = (packet.distance[lane].to_bits(), packet.triangle[lane]);
                    let at = |distance: f32| if back { distance + advance } else { distance };
                    let expected = match end {
                        Some((_, distance, id)) => (at(distance).to_bits(), id),
                        None => (until.to_bits(), SKY),
                    };
                    let why = format!("{level:?} {kind:?} {coherent} {k} {lane} {packet:?}");
                    assert_eq!(own, expected, "{why}");
                    met += u32::from(end.is_some());
                    free += u32::from(end.is_none());
                    let line = (k * LANES + lane) as u32;
                    let mut own: Vec<u32> =
                        found.iter().filter(|f| f.0 == line).map(|f| f.1).collect();
                    own.sort_unstable();
                    own.dedup();
                    let is_before =
                        |h: &(f64, f32, u32)| end.map_or(h.1 <= until - advance, |e| h.1 <= e.1);
                    let mut seen: Vec<u32> = hits
                        .filter(|h| passed && h.2 % 3 == 0 && is_before(h))
                        .map(|h| h.2)
                        .collect();
                    seen.sort_unstable();
                    assert_eq!(own, seen, "{why}");
                }
            }
        }
        built = Arc::into_inner(tracer.0).unwrap();
    }
    let is_dense = scene.len() >= 60;
    assert!(
        (met > count || !is_dense) && free > count / 4,
        "{met} {free}"
    );
}

#[test]
fn traversals_have_hits_of_search() {
    let mut random = Hashed::new(&[1]);
    for (count, rays) in [(1, 40), (9, 60), (60, 80), (700, 100)] {
        compare(
            soup(count, 1.0, &mut random),
            None,
            false,
            HERE,
            rays.max(count / 2),
            &mut random,
        );
    }
}

/// Compares as many rays as `SIGHTLINE_RAYS` names, of each kind, in scenes of 2000 triangles, or in the
/// scene file that `SIGHTLINE_SCENE` names.
#[test]
#[ignore = "takes as long as SIGHTLINE_RAYS requires; scripts/nightly.sh runs it"]
fn many_rays_have_hits_of_search() {
    let rays: u64 = std::env::var("SIGHTLINE_RAYS").map_or(10_000_000, |n| n.parse().unwrap());
    let file = std::env::var_os("SIGHTLINE_SCENE").map(|path| {
        let scene = sightline_scene::load(path.as_ref()).unwrap();
        let bounds = scene.bounds();
        let place = Place {
            scale: (bounds.max - bounds.min).max_element() / 32.0,
            moved: bounds.min,
        };
        (scene.triangles().to_vec(), place)
    });
    // The mean packet has 8.5 rays.
    (0..rays.div_ceil(8 * 500))
        .into_par_iter()
        .for_each(|part| {
            let mut random = Hashed::new(&[20, part]);
            let (triangles, place) = match &file {
                Some((triangles, place)) => (triangles.clone(), *place),
                None => (soup(2000, 1.0, &mut random), HERE),
            };
            compare(triangles, None, false, place, 500, &mut random);
        });
}

/// Checks hits against a digest that all kinds of processors have.
#[test]
fn hits_have_digest_of_all_processors() {
    let mut random = Hashed::new(&[21]);
    // The scene depends on exact operations only.
    let triangles: Vec<Triangle> = (0..2000)
        .map(|_| {
            let centre = random.point() * 32.0;
            let size = f32::from_bits((122 + (random.bits() % 8) as u32) << 23);
            let mut corner = || centre + (random.point() - 0.5) * size;
            Triangle {
                v: [corner(), corner(), corner()],
            }
        })
        .collect();
    let rays = packets(600, HERE, &mut random);
    let ids: Vec<u32> = (0..2000).collect();
    let backend = CpuBackend::new(scene(triangles, None), SPEC).unwrap();
    let mut built = Arc::into_inner(backend.build_lines(&ids, &[]).unwrap()).unwrap();
    for level in levels() {
        built.level = level;
        let tracer = CpuTracer(Arc::new(built));
        for coherent in [false, true] {
            let mut traced = rays.clone();
            tracer.trace_packets(&mut traced, Halves::Rays, coherent, None);
            let (bits, _) = hit_bits(&traced, &[]);
            let digest = bits.iter().fold(0u64, |digest, bits| {
                sightline_numbers::random::mix(digest ^ u64::from(*bits))
            });
            assert_eq!(digest, 15_884_073_926_614_975_362, "{level:?} {coherent}");
        }
        built = Arc::into_inner(tracer.0).unwrap();
    }
}

#[test]
fn passed_and_one_sided_triangles_have_hits_of_search() {
    let mut random = Hashed::new(&[2]);
    let sides = |count: u32, random: &mut Hashed| -> Vec<Side> {
        (0..count)
            .map(|_| Side::ALL[(random.bits() % 3) as usize])
            .collect()
    };
    compare(
        soup(400, 1.0, &mut random),
        None,
        true,
        HERE,
        60,
        &mut random,
    );
    let one_sided = sides(400, &mut random);
    compare(
        soup(400, 1.0, &mut random),
        Some(one_sided),
        false,
        HERE,
        60,
        &mut random,
    );
    let one_sided = sides(400, &mut random);
    compare(
        soup(400, 1.0, &mut random),
        Some(one_sided),
        true,
        HERE,
        60,
        &mut random,
    );
}

#[test]
fn scale_of_scene_does_not_matter() {
    let mut random = Hashed::new(&[3]);
    for scale in [1e-17, 1e-9, 1e7] {
        let place = Place { scale, ..HERE };
        compare(
            soup(200, scale, &mut random),
            None,
            false,
            place,
            40,
            &mut random,
        );
    }
}

#[test]
fn place_of_scene_does_not_matter() {
    let mut random = Hashed::new(&[5]);
    for moved in [
        Vec3::new(1e5, -3e5, 4e3),
        Vec3::new(-1e5, 0.0, 7e6),
        Vec3::splat(20.0),
    ] {
        let mut triangles = soup(200, 1.0, &mut random);
        for triangle in &mut triangles {
            triangle.v = triangle.v.map(|v| v + moved);
        }
        compare(
            triangles,
            None,
            false,
            Place { scale: 1.0, moved },
            40,
            &mut random,
        );
    }
}

/// Checks rays from a plane in which many triangles overlap: the distance to all is zero, of either sign.
#[test]
fn least_triangle_counts_at_distance_zero() {
    // More leaves contain the origin than the tracer lists. The sizes are in no order of the ids.
    let triangles: Vec<Triangle> = (0..2000)
        .map(|id| {
            let x = 4.0 + (id * 797 + 1000) as f32 % 2000.0;
            let corner = |y: f32| Vec3::new(x, y, 0.0);
            Triangle {
                v: [Vec3::new(-4.0, 0.0, 0.0), corner(-x), corner(x)],
            }
        })
        .collect();
    let ids: Vec<u32> = (0..2000).collect();
    let backend = CpuBackend::new(scene(triangles, None), SPEC).unwrap();
    let tracer = backend.lines(LineSet::Blocking, &ids).unwrap();
    let step = 1e-4;
    for [x, y, z] in [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [0.25, -0.5, 1.0],
        [-0.5, 0.25, -1.0],
    ] {
        let mut ahead = Packet::default();
        ahead.push([1.0, 0.0, 0.0], [x, y, z]);
        let behind = ahead.reversed(step);
        for coherent in [false, true] {
            let mut traced = [ahead.clone(), behind.clone()];
            tracer
                .trace(&mut traced, Halves::Lines { step }, coherent)
                .unwrap();
            assert_eq!(traced[1].triangle[0], 0, "{x} {y} {z} {coherent}");
        }
    }
}

#[test]
fn rays_without_direction_or_position_meet_nothing() {
    let wall = [
        Vec3::new(-9.0, -9.0, 1.0),
        Vec3::new(9.0, -9.0, 1.0),
        Vec3::new(0.0, 9.0, 1.0),
    ];
    let scene = scene(vec![Triangle { v: wall }], None);
    let backend = CpuBackend::new(scene, SPEC).unwrap();
    let tracer = backend.lines(LineSet::Blocking, &[0]).unwrap();
    let mut packet = Packet::default();
    let nan = f32::NAN;
    for direction in [
        [0.0; 3],
        [nan; 3],
        [0.0, nan, 1.0],
        [f32::INFINITY, 0.0, 1.0],
        [1e-40, 0.0, 0.0],
    ] {
        packet.push([0.0; 3], direction);
    }
    for origin in [[nan; 3], [0.0, f32::INFINITY, 0.0], [1e30, 0.0, 0.0]] {
        packet.push(origin, [0.0, 0.0, 1.0]);
    }
    packet.push([0.0; 3], [0.0, 0.0, 1.0]);
    for coherent in [false, true] {
        let mut traced = [packet.clone()];
        tracer.trace(&mut traced, Halves::Rays, coherent).unwrap();
        let [traced] = traced;
        assert_eq!(traced.triangle[..8], [SKY; 8]);
        assert_eq!((traced.triangle[8], traced.distance[8]), (0, 1.0));
    }
    // A scene without triangles.
    let none = backend.lines(LineSet::Masked, &[]).unwrap();
    none.trace(&mut [packet], Halves::Rays, true).unwrap();
}

/// Checks rays from inside closed surfaces at their vertices and at points of their edges. The surfaces are
/// stretched and moved, so that single precision is short.
#[test]
fn no_ray_leaves_closed_surface() {
    let mut random = Hashed::new(&[4]);
    // A sphere by subdivision of an octahedron.
    let mut faces = Vec::new();
    for [x, y, z] in [0, 1, 2, 3, 4, 5, 6, 7].map(|k| [k & 1, k >> 1 & 1, k >> 2 & 1]) {
        let sign = |bit: i32| f64::from(1 - 2 * bit);
        faces.push([DVec3::X * sign(x), DVec3::Y * sign(y), DVec3::Z * sign(z)]);
    }
    for _ in 0..4 {
        faces = faces
            .into_iter()
            .flat_map(|[a, b, c]| {
                let middle = |p: DVec3, q: DVec3| (p + q).normalize();
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    for (scale, moved) in [
        (DVec3::ONE, DVec3::ZERO),
        (DVec3::ONE, DVec3::new(1000.0, -700.0, 300.0)),
        (DVec3::new(1000.0, 1.0, 1000.0), DVec3::ZERO),
        (
            DVec3::new(1.0, 1.0, 1000.0),
            DVec3::new(5000.0, 3000.0, 100.0),
        ),
    ] {
        let vertex = |v: DVec3| (v * scale + moved).as_vec3();
        let triangles: Vec<Triangle> = faces
            .iter()
            .map(|f| Triangle { v: f.map(vertex) })
            .collect();
        let ids: Vec<u32> = (0..triangles.len() as u32).collect();
        let mut packets = Vec::new();
        for _ in 0..6 {
            let inside = (random.point().as_dvec3() - 0.5) * scale + moved;
            let origin = inside.as_vec3();
            for triangle in &triangles {
                let mut packet = Packet::default();
                for k in 0..3 {
                    let (a, b) = (triangle.v[k], triangle.v[(k + 1) % 3]);
                    let share = random.unit();
                    for target in [a, a + (b - a) * share] {
                        packet.push(origin.to_array(), (target - origin).to_array());
                    }
                }
                packets.push(packet);
            }
        }
        let backend = CpuBackend::new(scene(triangles, None), SPEC).unwrap();
        let tracer = backend.lines(LineSet::Blocking, &ids).unwrap();
        for coherent in [false, true] {
            let mut pairs: Vec<Packet> = Vec::new();
            for packet in &packets {
                pairs.extend([packet.clone(), packet.reversed(0.0)]);
            }
            tracer
                .trace(&mut pairs, Halves::Lines { step: 0.0 }, coherent)
                .unwrap();
            let met = pairs.iter().map(|p| &p.triangle[..p.count]);
            let leaks = met.flatten().filter(|t| **t == SKY).count();
            assert_eq!(leaks, 0, "{scale} {moved} {coherent}");
        }
    }
}
