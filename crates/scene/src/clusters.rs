//! Clusters: neighbouring triangles of one object, at most [`MOST_TRIANGLES`] with at most [`MOST_VERTICES`]
//! vertices, as engines draw them (meshlets, as meshoptimizer builds them).
//!
//! A cluster grows by the triangle that needs the fewest new vertices; among these, by the one whose vertices
//! have the fewest triangles left, so that no single triangles remain; then by the least id. Without a
//! neighbour it goes on with the next triangle in Morton order, so that leaves of a tree share clusters. All
//! decisions are made on integers, so every machine makes the same clusters.

use std::collections::BTreeMap;

use crate::kinds::Kind;
use crate::scene::{Object, Scene};

/// Most triangles of a cluster.
pub const MOST_TRIANGLES: usize = 128;
/// Most vertices of a cluster.
pub const MOST_VERTICES: usize = 255;

/// Bits of a Morton code along each axis.
const BITS: u32 = 20;

/// The clusters of a scene, each as ascending triangle ids; in the order of the objects, and within one in
/// the order in which they grew. Triangles that can never be visible are in no cluster.
pub fn clusters(scene: &Scene) -> Vec<Vec<u32>> {
    scene
        .objects()
        .iter()
        .flat_map(|object| of_object(scene, object))
        .collect()
}

fn of_object(scene: &Scene, object: &Object) -> Vec<Vec<u32>> {
    let shows = |t: &u32| scene.kinds().kind(*t) != Kind::OccluderOnly && scene.shows(*t);
    let ids: Vec<u32> = (object.first..object.first + object.count)
        .filter(shows)
        .collect();
    if ids.is_empty() {
        return Vec::new();
    }
    let mesh = NumberedMesh::new(scene, &ids);
    let mut left = mesh.left();
    let mut taken = vec![false; ids.len()];
    // Of each vertex and each triangle, the cluster that has it, or considered it.
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

/// The triangles of an object with numbered vertices. Vertices are the same if their coordinates are.
struct NumberedMesh {
    corners: Vec<[u32; 3]>,
    /// The triangles around each vertex: those of vertex v are from `starts[v]` to `starts[v + 1]`.
    starts: Vec<u32>,
    around: Vec<u32>,
    /// The triangles in Morton order of their centres.
    morton: Vec<u32>,
}

impl NumberedMesh {
    fn new(scene: &Scene, ids: &[u32]) -> Self {
        let mut numbers = BTreeMap::new();
        let corners: Vec<[u32; 3]> = ids
            .iter()
            .map(|id| {
                scene.triangles()[*id as usize].v.map(|v| {
                    // Minus zero is zero.
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

    /// The number of triangles around each vertex.
    fn left(&self) -> Vec<u32> {
        self.starts.windows(2).map(|w| w[1] - w[0]).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::Triangle;

    /// A square of 2·n² triangles as one object, and n single triangles far apart as another.
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
        // Without area.
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
    fn clusters_hold_every_visible_triangle_once_and_are_few() {
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
        // A flat cluster of 128 triangles has about 81 vertices; 25 clusters would be the least.
        assert!((25..=32).contains(&square), "{square}");
        // Lone triangles share a cluster, and no cluster has triangles of two objects.
        assert_eq!(all.len() - square, 1);
        assert_eq!(all, clusters(&scene));
    }
}
