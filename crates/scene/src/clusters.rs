//! Clusters of neighbouring triangles of one object, as engines draw them (meshlets, as built by
//! meshoptimizer). A cluster has at most [`MOST_TRIANGLES`] triangles with at most [`MOST_VERTICES`]
//! vertices.
//!
//! A cluster grows by the neighbouring triangle that needs the fewest new vertices. Among several such
//! triangles, the triangle whose vertices have the fewest remaining triangles is next, so that no single
//! triangles remain; then the triangle with the smallest id. If the cluster has no neighbour, the next
//! triangle in Morton order is added, so that separate leaves of a plant share clusters. All decisions use
//! integers, so every machine creates the same clusters.

use std::collections::BTreeMap;

use sightline_numbers::ids::TriangleId;

use crate::kinds::SurfaceKind;
use crate::scene::{Object, Scene};

/// Maximum number of triangles of a cluster.
pub const MOST_TRIANGLES: usize = 128;
/// Maximum number of vertices of a cluster.
pub const MOST_VERTICES: usize = 255;

/// The number of bits of a Morton code along each axis.
const BITS: u32 = 20;

/// Computes the clusters of a scene, each as ascending triangle ids.
///
/// The clusters are in the order of the objects, and in the order of growth within an object. Triangles that
/// can never be visible are in no cluster.
pub fn clusters(scene: &Scene) -> Vec<Vec<u32>> {
    scene
        .objects()
        .iter()
        .flat_map(|object| of_object(scene, object))
        .collect()
}

fn of_object(scene: &Scene, object: &Object) -> Vec<Vec<u32>> {
    let shows = |t: &u32| {
        scene.kinds().kind(TriangleId(*t)) != SurfaceKind::OccluderOnly
            && scene.shows(TriangleId(*t))
    };
    let ids: Vec<u32> = (object.first..object.first + object.count)
        .filter(shows)
        .collect();
    if ids.is_empty() {
        return Vec::new();
    }
    let mesh = NumberedMesh::new(scene, &ids);
    let mut left = mesh.left();
    let mut taken = vec![false; ids.len()];
    // For each vertex, the last cluster that contains it; for each triangle, the last cluster whose border
    // contained it.
    let mut vertex_in = vec![u32::MAX; left.len()];
    let mut considered = vec![u32::MAX; ids.len()];
    let mut order = mesh.morton.iter().copied();
    let mut clusters: Vec<Vec<u32>> = Vec::new();
    let (mut current, mut vertices, mut border) = (Vec::new(), 0, Vec::<u32>::new());
    loop {
        let number = clusters.len() as u32;
        let new = |t: u32, vertex_in: &[u32]| {
            mesh.corners(t)
                .iter()
                .filter(|v| vertex_in[**v as usize] != number)
                .count()
        };
        border.retain(|t| !taken[*t as usize]);
        let best = border.iter().copied().min_by_key(|t| {
            let lives: u32 = mesh.corners(*t).iter().map(|v| left[*v as usize]).sum();
            (new(*t, &vertex_in), lives, *t)
        });
        let next = best.or_else(|| order.by_ref().find(|t| !taken[*t as usize]));
        let Some(next) = next else { break };
        let more = new(next, &vertex_in);
        if current.len() == MOST_TRIANGLES || vertices + more > MOST_VERTICES {
            clusters.push(std::mem::take(&mut current));
            (vertices, border) = (0, vec![next]);
            continue;
        }
        taken[next as usize] = true;
        current.push(ids[next as usize]);
        vertices += more;
        for v in mesh.corners(next) {
            left[*v as usize] -= 1;
            if vertex_in[*v as usize] != number {
                vertex_in[*v as usize] = number;
                for t in mesh.around(*v) {
                    if !taken[*t as usize] && considered[*t as usize] != number {
                        considered[*t as usize] = number;
                        border.push(*t);
                    }
                }
            }
        }
    }
    if !current.is_empty() {
        clusters.push(current);
    }
    clusters.iter_mut().for_each(|c| c.sort_unstable());
    clusters
}

/// The triangles of an object with numbered vertices. Vertices with equal coordinates have the same number. A
/// triangle is its index in `corners`.
struct NumberedMesh {
    corners: Vec<[u32; 3]>,
    /// The positions in `around`: the triangles of vertex v are at `starts[v]` to `starts[v + 1]`
    /// (exclusive).
    starts: Vec<u32>,
    /// The triangles around each vertex, vertex by vertex.
    around: Vec<u32>,
    /// The triangles in Morton order of their centroids.
    morton: Vec<u32>,
}

impl NumberedMesh {
    fn new(scene: &Scene, ids: &[u32]) -> Self {
        let mut numbers = BTreeMap::new();
        let corners: Vec<[u32; 3]> = ids
            .iter()
            .map(|id| {
                scene.triangles()[*id as usize].v.map(|v| {
                    // Minus zero equals zero.
                    let key = v.to_array().map(|x| (x + 0.0).to_bits());
                    let next = numbers.len() as u32;
                    *numbers.entry(key).or_insert(next)
                })
            })
            .collect();
        let mut starts = vec![0u32; numbers.len() + 1];
        corners
            .iter()
            .flatten()
            .for_each(|v| starts[*v as usize + 1] += 1);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        let mut next = starts.clone();
        let mut around = vec![0; corners.len() * 3];
        for (t, own) in corners.iter().enumerate() {
            for v in own {
                around[next[*v as usize] as usize] = t as u32;
                next[*v as usize] += 1;
            }
        }
        let bounds = scene.bounds();
        let code = |id: &u32| {
            let v = scene.triangles()[*id as usize].v;
            let side = |a: usize| {
                let [low, high] = [bounds.min[a], bounds.max[a]].map(f64::from);
                let centre = (f64::from(v[0][a]) + f64::from(v[1][a]) + f64::from(v[2][a])) / 3.0;
                ((centre - low) / (high - low).max(f64::MIN_POSITIVE) * f64::from(1u32 << BITS))
                    as u64
            };
            (0..BITS).fold(0u64, |code, bit| {
                (0..3).fold(code, |code, a| {
                    code | (side(a) >> bit & 1) << (3 * bit + a as u32)
                })
            })
        };
        let mut morton: Vec<(u64, u32)> =
            ids.iter().zip(0..).map(|(id, t)| (code(id), t)).collect();
        morton.sort_unstable();
        Self {
            corners,
            starts,
            around,
            morton: morton.into_iter().map(|m| m.1).collect(),
        }
    }

    fn corners(&self, triangle: u32) -> &[u32; 3] {
        &self.corners[triangle as usize]
    }

    fn around(&self, vertex: u32) -> &[u32] {
        &self.around
            [self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }

    /// Returns the number of triangles around each vertex.
    fn left(&self) -> Vec<u32> {
        self.starts.windows(2).map(|w| w[1] - w[0]).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::Triangle;

    /// Creates a square of 2·n² triangles as one object, and n separate distant triangles as another object.
    fn scene(n: u32) -> Scene {
        let at = |x: u32, y: u32| Vec3::new(x as f32, y as f32, 0.0);
        let mut triangles: Vec<Triangle> = (0..n * n)
            .flat_map(|i| {
                let (x, y) = (i % n, i / n);
                let quad = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
                [[0, 1, 2], [0, 2, 3]].map(|c| Triangle {
                    v: c.map(|k: usize| quad[k]),
                })
            })
            .collect();
        let count = triangles.len() as u32;
        let lone = |i: u32| Triangle {
            v: [at(3 * i, 90), at(3 * i + 1, 90), at(3 * i, 91)],
        };
        triangles.extend((0..n).map(lone));
        // A triangle without area.
        triangles.push(Triangle { v: [at(0, 0); 3] });
        let object = |first: u32, count| Object {
            name: first.to_string(),
            first,
            count,
        };
        Scene::new(
            "test",
            triangles,
            vec![object(0, count), object(count, n + 1)],
        )
        .unwrap()
    }

    #[test]
    fn clusters_contain_every_visible_triangle_once_and_are_few() {
        let n = 40;
        let scene = scene(n);
        let all = clusters(&scene);
        let mut ids: Vec<u32> = all.iter().flatten().copied().collect();
        ids.sort_unstable();
        assert_eq!(ids, (0..scene.len() - 1).collect::<Vec<_>>());
        let square = all.iter().filter(|c| c[0] < 2 * n * n).count();
        assert!(
            all.iter()
                .all(|c| c.len() <= MOST_TRIANGLES && c.windows(2).all(|w| w[0] < w[1]))
        );
        // A flat cluster of 128 triangles has about 81 vertices. The minimum is 25 clusters.
        assert!((25..=32).contains(&square), "{square}");
        // The separate triangles share a cluster, and no cluster contains triangles of two objects.
        assert_eq!(all.len() - square, 1);
        assert_eq!(all, clusters(&scene));
    }
}
