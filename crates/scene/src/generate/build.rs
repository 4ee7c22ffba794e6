//! The solids of generated scenes: slabs with openings, boxes and tubes. All solids are closed and face
//! outwards, and vertices at the same position have the same bits.

use glam::Vec3;

use super::random::turn;
use crate::{Object, Scene, SceneError, Triangle};

/// The triangles and objects of a scene under construction.
#[derive(Default)]
pub(super) struct Builder {
    triangles: Vec<Triangle>,
    objects: Vec<Object>,
}

impl Builder {
    /// Returns the current number of triangles.
    pub(super) fn len(&self) -> u64 {
        self.triangles.len() as u64
    }

    /// Adds an object called `name` that consists of the triangles that `parts` adds.
    pub(super) fn object(&mut self, name: String, parts: impl FnOnce(&mut Self)) {
        let first = self.triangles.len();
        parts(self);
        // Every generator checks the number of triangles before it adds them, so counts exceed MAX_TRIANGLES
        // only slightly.
        let count = (self.triangles.len() - first) as u32;
        self.objects.push(Object {
            name,
            first: first as u32,
            count,
        });
    }

    /// Returns the finished scene.
    pub(super) fn finish(self, file: &str) -> Result<Scene, SceneError> {
        Scene::new(file, self.triangles, self.objects)
    }

    /// Adds a triangle.
    pub(super) fn triangle(&mut self, a: Vec3, b: Vec3, c: Vec3) {
        self.triangles.push(Triangle { v: [a, b, c] });
    }

    /// Adds the two triangles of the quadrilateral `p`. If `flip` is true, the order of their vertices is
    /// reversed.
    pub(super) fn quad(&mut self, p: [Vec3; 4], flip: bool) {
        let p = if flip { [p[0], p[3], p[2], p[1]] } else { p };
        self.triangle(p[0], p[1], p[2]);
        self.triangle(p[0], p[2], p[3]);
    }

    /// Adds a box of twelve triangles.
    pub(super) fn cuboid(&mut self, min: Vec3, max: Vec3) {
        self.slab(
            [0, 1, 2],
            &[min.x, max.x],
            &[min.y, max.y],
            [min.z, max.z],
            |_, _| false,
        );
    }

    /// Adds a flat slab without the cells for which `hole` returns true.
    ///
    /// The ascending coordinates `us` and `vs` divide the slab into cells. The slab extends from `ns[0]` to
    /// `ns[1]` along its normal. `axes` contains the coordinate axes of u, v and n. Two holes must not touch
    /// at only a corner, because four faces would share the edge there.
    pub(super) fn slab(
        &mut self,
        axes: [usize; 3],
        us: &[f32],
        vs: &[f32],
        ns: [f32; 2],
        hole: impl Fn(usize, usize) -> bool,
    ) {
        let flip = (axes[1] + 3 - axes[0]) % 3 == 2;
        let p = |i: usize, j: usize, k: usize| {
            let mut p = Vec3::ZERO;
            (p[axes[0]], p[axes[1]], p[axes[2]]) = (us[i], vs[j], ns[k]);
            p
        };
        let filled = |i: usize, j: usize| i + 1 < us.len() && j + 1 < vs.len() && !hole(i, j);
        for j in 0..vs.len() - 1 {
            for i in (0..us.len() - 1).filter(|i| filled(*i, j)) {
                let (i1, j1) = (i + 1, j + 1);
                self.quad([p(i, j, 1), p(i1, j, 1), p(i1, j1, 1), p(i, j1, 1)], flip);
                self.quad([p(i, j, 0), p(i, j1, 0), p(i1, j1, 0), p(i1, j, 0)], flip);
                if i == 0 || !filled(i - 1, j) {
                    self.quad([p(i, j, 0), p(i, j, 1), p(i, j1, 1), p(i, j1, 0)], flip);
                }
                if !filled(i1, j) {
                    self.quad([p(i1, j, 0), p(i1, j1, 0), p(i1, j1, 1), p(i1, j, 1)], flip);
                }
                if j == 0 || !filled(i, j - 1) {
                    self.quad([p(i, j, 0), p(i1, j, 0), p(i1, j, 1), p(i, j, 1)], flip);
                }
                if !filled(i, j1) {
                    self.quad([p(i, j1, 0), p(i, j1, 1), p(i1, j1, 1), p(i1, j1, 0)], flip);
                }
            }
        }
    }

    /// Adds a tube with flat ends through `rings` of (centre, radius > 0), with `sides` ≥ 3 corners per ring.
    /// [`tube_size`] returns the number of triangles.
    pub(super) fn tube(&mut self, rings: &[(Vec3, f32)], sides: u32) {
        let [(first, _), .., (last, _)] = rings else {
            return;
        };
        let along = (*last - *first).normalize_or(Vec3::Y);
        let aside = if along.y.abs() < 0.9 {
            Vec3::Y
        } else {
            Vec3::X
        };
        let u = along.cross(aside).normalize_or(Vec3::Z);
        let v = along.cross(u);
        let corners: Vec<Vec<Vec3>> = rings
            .iter()
            .map(|(centre, radius)| {
                (0..sides)
                    .map(|k| turn(k as f32 / sides as f32))
                    .map(|(c, s)| *centre + (u * c + v * s) * *radius)
                    .collect()
            })
            .collect();
        let n = sides as usize;
        for (low, high) in corners.iter().zip(corners.iter().skip(1)) {
            for k in 0..n {
                let next = (k + 1) % n;
                self.quad([low[k], low[next], high[next], high[k]], false);
            }
        }
        let (bottom, top) = (&corners[0], &corners[corners.len() - 1]);
        for k in 1..n - 1 {
            self.triangle(bottom[0], bottom[k + 1], bottom[k]);
            self.triangle(top[0], top[k], top[k + 1]);
        }
    }
}

/// Returns the number of triangles of a [`Builder::tube`] with `sides` sides and `segments` segments (the
/// number of rings minus one).
pub(super) fn tube_size(sides: u32, segments: u32) -> u64 {
    2 * u64::from(sides) * u64::from(segments) + 2 * u64::from(sides - 2)
}
