//! Neighbourhoods of triangles: neighbours across edges or close by, and the Morton order of the centres.
//! Triangles that are close in this order are mostly close in space.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use glam::Vec3;
use rayon::prelude::*;
use sightline_numbers::random::mix;
use sightline_scene::topology::{hash, position};
use sightline_scene::{Scene, Triangle, TriangleId};

use crate::cube::SKY;
use crate::sequence::Hashed;

/// The facts about a scene's triangles that do not depend on a job.
pub struct Surface {
    /// For each edge (v0v1, v1v2, v2v0) the next triangle around the edge. If the edge has no other triangle,
    /// a triangle close by, or [`SKY`].
    pub neighbours: Vec<[u32; 3]>,
    /// The triangles with area in Morton order of their centres.
    pub morton: Vec<u32>,
}

impl Surface {
    /// Analyses the triangles `ids` of `scene`. These are the triangles that lines can meet, so no neighbour
    /// is a duplicate, which no line meets. Two vertices are equal if their coordinates are equal, bit for
    /// bit.
    pub fn new(scene: &Scene, ids: &[u32]) -> Self {
        let (mut neighbours, morton) =
            rayon::join(|| neighbours(scene, ids), || morton(scene, ids));
        add_substitutes(scene, &morton, &mut neighbours);
        Self { neighbours, morton }
    }
}

fn neighbours(scene: &Scene, ids: &[u32]) -> Vec<[u32; 3]> {
    let all = scene.triangles();
    // Edges are identified by a 64-bit hash of their two ends: equal edges have equal hashes. Two different
    // edges with the same hash would only make the sampler aim at the wrong neighbour.
    let end = |v: Vec3| hash(position(v));
    let mut edges = vec![(0u64, 0u32); 3 * ids.len()];
    edges
        .par_chunks_exact_mut(3)
        .zip(ids)
        .for_each(|(own, id)| {
            let ends = all[*id as usize].v.map(end);
            for (k, edge) in own.iter_mut().enumerate() {
                let (a, b) = (ends[k], ends[(k + 1) % 3]);
                *edge = (
                    mix(a ^ b).wrapping_add(a.wrapping_add(b)),
                    3 * id + k as u32,
                );
            }
        });
    edges.par_sort_unstable();
    // Each edge is in one group, so each place is written once.
    let mut places: Vec<AtomicU32> = Vec::new();
    places.resize_with(3 * all.len(), || AtomicU32::new(SKY));
    edges.par_chunk_by(|a, b| a.0 == b.0).for_each(|group| {
        for (i, (_, edge)) in group.iter().enumerate() {
            let next = group[(i + 1) % group.len()].1;
            if next / 3 != edge / 3 {
                places[*edge as usize].store(next / 3, Relaxed);
            }
        }
    });
    places
        .par_chunks_exact(3)
        .map(|own| [0, 1, 2].map(|k: usize| own[k].load(Relaxed)))
        .collect()
}

/// Assigns a triangle close by in Morton order to each edge without another triangle. Leaves of a tree, or
/// walls that meet without common vertices, are then flooded as if they were connected.
fn add_substitutes(scene: &Scene, morton: &[u32], neighbours: &mut [[u32; 3]]) {
    /// The offsets in Morton order to try, for the first, second and third edge.
    const STEPS: [isize; 3] = [1, -1, 2];
    /// The number of offsets that are tried: the nearest triangles may already share an edge.
    const LOOKS: usize = 4;
    /// The square of the maximum distance of a substitute, in lengths of the larger of both triangles.
    const NEAR: f32 = 16.0;
    let v = |t: u32| scene.triangles()[t as usize].v;
    let centre = |t: u32| v(t).iter().sum::<Vec3>() / 3.0;
    let size = |t: u32| {
        v(t)[0]
            .distance_squared(v(t)[1])
            .max(v(t)[0].distance_squared(v(t)[2]))
    };
    let before = &*neighbours;
    let with_substitutes: Vec<[u32; 3]> = (0..morton.len())
        .into_par_iter()
        .map(|place| {
            let t = morton[place];
            let mut own = before[t as usize];
            for (edge, step) in STEPS
                .into_iter()
                .enumerate()
                .filter(|(edge, _)| before[t as usize][*edge] == SKY)
            {
                let places =
                    (0..LOOKS as isize).map(|look| place as isize + step + look * step.signum());
                let next = places
                    .filter_map(|p| usize::try_from(p).ok().and_then(|p| morton.get(p)))
                    .find(|next| !own.contains(next));
                own[edge] = next
                    .filter(|n| {
                        centre(**n).distance_squared(centre(t)) <= NEAR * size(t).max(size(**n))
                    })
                    .map_or(SKY, |n| *n);
            }
            own
        })
        .collect();
    for (t, own) in morton.iter().zip(with_substitutes) {
        neighbours[*t as usize] = own;
    }
}

fn morton(scene: &Scene, ids: &[u32]) -> Vec<u32> {
    let bounds = scene.bounds();
    let scale = Vec3::splat(1023.0) / (bounds.max - bounds.min).max(Vec3::splat(f32::MIN_POSITIVE));
    let spread = |x: u32| {
        let x = (x | x << 16) & 0x0300_00ff;
        let x = (x | x << 8) & 0x0300_f00f;
        let x = (x | x << 4) & 0x030c_30c3;
        (x | x << 2) & 0x0924_9249
    };
    let code = |t: &Triangle| {
        let c = ((t.v[0] + t.v[1] + t.v[2]) / 3.0 - bounds.min) * scale;
        spread(c.x as u32) | spread(c.y as u32) << 1 | spread(c.z as u32) << 2
    };
    let key = |id: &u32| u64::from(code(&scene.triangles()[*id as usize])) << 32 | u64::from(*id);
    let mut keyed: Vec<u64> = ids.par_iter().map(key).collect();
    keyed.par_sort_unstable();
    keyed.into_par_iter().map(|key| key as u32).collect()
}

/// Returns a random point of a triangle, uniform over its area up to rounding.
pub fn point_on(scene: &Scene, triangle: TriangleId, random: &mut Hashed) -> [f32; 3] {
    let v = scene.triangles()[triangle.at()].v;
    let (mut a, mut b) = (random.unit(), random.unit());
    if a + b > 1.0 {
        (a, b) = (1.0 - a, 1.0 - b);
    }
    (v[0] + (v[1] - v[0]) * a + (v[2] - v[0]) * b).to_array()
}

#[cfg(test)]
mod tests {
    use sightline_scene::Object;

    use super::*;

    #[test]
    fn edges_have_neighbours_or_near_substitutes() {
        let at = |x: f32| {
            let p = |u: f32, v: f32| Vec3::new(x + u, v, 0.0);
            [
                Triangle {
                    v: [p(0.0, 0.0), p(1.0, 0.0), p(0.0, 1.0)],
                },
                Triangle {
                    v: [p(1.0, 0.0), p(1.0, 1.0), p(0.0, 1.0)],
                },
            ]
        };
        // Two squares of two triangles each near each other, and one triangle far away.
        let triangles = [at(0.0), at(2.0), at(1000.0)].concat()[..5].to_vec();
        let objects = vec![Object {
            name: "all".to_owned(),
            first: 0,
            count: 5,
        }];
        let scene = Scene::new("test", triangles, objects).unwrap();
        let surface = Surface::new(&scene, &[0, 1, 2, 3, 4]);
        for (t, own) in surface.neighbours.iter().enumerate() {
            assert!(!own.contains(&(t as u32)), "{t} is beside itself");
        }
        // Across the diagonal v1v2 of the first triangle and v2v0 of the second triangle.
        assert_eq!([surface.neighbours[0][1], surface.neighbours[1][2]], [1, 0]);
        assert_eq!([surface.neighbours[2][1], surface.neighbours[3][2]], [3, 2]);
        let substitutes = |t: usize| {
            surface.neighbours[t]
                .iter()
                .filter(|n| **n != SKY && **n / 2 != t as u32 / 2)
                .count()
        };
        assert!(
            (0..4).all(|t| substitutes(t) > 0),
            "{:?}",
            surface.neighbours
        );
        assert_eq!(surface.neighbours[4], [SKY; 3]);
        assert!(surface.neighbours[..4].iter().all(|n| !n.contains(&4)));
    }
}
