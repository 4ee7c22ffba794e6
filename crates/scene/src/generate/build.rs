//! The solids of generated scenes: slabs with openings, boxes and tubes. All are closed and face outwards;
//! vertices at the same place have the same bits.

use glam::Vec3;

use super::random::turn;
use crate::{Object, Scene, SceneError, Triangle};

/// The triangles and objects of a scene that is being generated.
#[derive(Default)]
pub(super) struct Builder {
    triangles: Vec<Triangle>,
    objects: Vec<Object>,
}

impl Builder {
    /// The number of triangles so far.
    pub(super) fn len(&self) -> u64 {
        self.triangles.len() as u64
    }

    /// Makes the triangles that `parts` adds an object called `name`.
    pub(super) fn object(&mut self, name: String, parts: impl FnOnce(&mut Self)) {
        let first = self.triangles.len();
        parts(self);
        // Counts are little above MAX_TRIANGLES at most, which every kind checks before it builds.
        let count = (self.triangles.len() - first) as u32;
        self.objects.push(Object {
            name,
            first: first as u32,
            count,
        });
    }

    /// The finished scene.
    pub(super) fn finish(self, file: &str) -> Result<Scene, SceneError> {
        Scene::new(file, self.triangles, self.objects)
    }

    /// One triangle.
    pub(super) fn triangle(&mut self, a: Vec3, b: Vec3, c: Vec3) {
        self.triangles.push(Triangle { v: [a, b, c] });
    }

    /// Two triangles; `flip` reverses their winding.
    pub(super) fn quad(&mut self, p: [Vec3; 4], flip: bool) {
        let p = if flip { [p[0], p[3], p[2], p[1]] } else { p };
        self.triangle(p[0], p[1], p[2]);
        self.triangle(p[0], p[2], p[3]);
    }

    /// A box of twelve triangles.
    pub(super) fn cuboid(&mut self, min: Vec3, max: Vec3) {
        self.slab(
            [0, 1, 2],
            &[min.x, max.x],
            &[min.y, max.y],
            [min.z, max.z],
            |_, _| false,
        );
    }

    /// A flat slab cut into cells by the ascending coordinates `us` and `vs`, from `ns[0]` to `ns[1]` thick,
    /// without the cells for which `hole` holds. `axes` says which coordinate u, v and n are. Holes must not
    /// touch one another at a corner only, or the edge there is shared by four faces.
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

    /// A tube with flat ends through `rings` of (centre, radius > 0), `sides` ≥ 3 around; see [`tube_size`].
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

/// Triangles of a [`Builder::tube`] of `sides` and `segments` (one fewer than rings).
pub(super) fn tube_size(sides: u32, segments: u32) -> u64 {
    2 * u64::from(sides) * u64::from(segments) + 2 * u64::from(sides - 2)
}
