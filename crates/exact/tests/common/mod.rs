//! Helpers of the tests of queries: scenes that check every verdict, places for constructions, and random
//! numbers.

#![allow(
    dead_code,
    clippy::panic,
    clippy::unwrap_used,
    reason = "helpers of tests, each of which uses some"
)]

pub mod cells;
pub mod truth;

use glam::{DMat3, DQuat, DVec3, Vec3};
use sightline_certificate::checker;
use sightline_certificate::checker::Refusal;
use sightline_exact::predicates::integers;
use sightline_exact::{Occluders, Polygon, QueryLimits, Verdict, sightlines};
use sightline_numbers::random::SplitMix64;
use sightline_scene::{Object, Scene, Triangle};

pub type Corners = [Vec3; 3];

/// A scene for queries.
pub struct World {
    pub triangles: Vec<Corners>,
    occluders: Occluders,
}

impl World {
    pub fn new(triangles: Vec<Corners>) -> Self {
        let objects = vec![Object {
            name: "test".into(),
            first: 0,
            count: triangles.len() as u32,
        }];
        let scene = Scene::new(
            "test",
            triangles.iter().map(|v| Triangle { v: *v }).collect(),
            objects,
        )
        .unwrap();
        let occluders = Occluders::new(&scene).unwrap();
        Self {
            triangles,
            occluders,
        }
    }

    /// Returns the verdict on lists of parts, or the reason why the checker rejects it.
    pub fn verdict(&self, a: &[Polygon], b: &[Polygon]) -> Result<Verdict, String> {
        let (verdict, _) = sightlines(&self.occluders, a, b, &QueryLimits::default());
        match check(&self.triangles, a, b, &verdict) {
            Ok(()) => Ok(verdict),
            Err(refusal) => Err(format!(
                "refused: {refusal}\n{verdict:?}\n{}",
                self.described(a, b)
            )),
        }
    }

    /// Returns true if parts of `b` are visible from parts of `a`, or the reason why this is unknown.
    pub fn try_parts(&self, a: &[Polygon], b: &[Polygon]) -> Result<bool, String> {
        match self.verdict(a, b)? {
            Verdict::Visible(_) => Ok(true),
            Verdict::Hidden(_) => Ok(false),
            Verdict::Undecided(reason) => {
                Err(format!("undecided: {reason}\n{}", self.described(a, b)))
            }
        }
    }

    /// Returns true if the convex polygon `b` is visible from `a`, or the reason why this is unknown.
    pub fn try_sees(&self, a: &[DVec3], b: &[DVec3]) -> Result<bool, String> {
        let polygon = |p: &[DVec3]| Polygon::checked(p).map_err(|e| format!("{e}: {p:?}"));
        self.try_parts(&polygon(a)?, &polygon(b)?)
    }

    /// Returns true if the convex polygon `b` is visible from `a`. The query must be decided.
    pub fn sees(&self, a: &[DVec3], b: &[DVec3]) -> bool {
        self.try_sees(a, b).unwrap_or_else(|why| panic!("{why}"))
    }

    /// Returns the result of [`World::sees`] and checks that both directions agree.
    pub fn mutual(&self, a: &[DVec3], b: &[DVec3]) -> bool {
        let seen = self.sees(a, b);
        assert_eq!(
            self.sees(b, a),
            seen,
            "not the same both ways: {a:?} {b:?} {:?}",
            self.triangles
        );
        seen
    }

    /// Formats the numbers of a failing case exactly, so that the case can be reproduced.
    fn described(&self, a: &[Polygon], b: &[Polygon]) -> String {
        let points = |parts: &[Polygon]| parts.iter().map(|p| p.rounded()).collect::<Vec<_>>();
        format!(
            "a = {:?}\nb = {:?}\ntriangles = {:?}",
            points(a),
            points(b),
            self.triangles
        )
    }
}

/// Checks the witness or the proof of a verdict.
pub fn check(
    scene: &[Corners],
    a: &[Polygon],
    b: &[Polygon],
    verdict: &Verdict,
) -> Result<(), Refusal> {
    let corners = |parts: &[Polygon]| -> Vec<checker::Corners> {
        parts
            .iter()
            .map(|p| p.points().iter().map(integers).collect())
            .collect()
    };
    match verdict {
        Verdict::Visible(ends) => {
            let [p, q] = [0, 1].map(|i| integers(&ends[i]));
            checker::check_witness(scene, &corners(a), &corners(b), &p, &q)
        }
        Verdict::Hidden(proof) => checker::check_hidden(scene, &corners(a), &corners(b), proof),
        Verdict::Undecided(_) => Ok(()),
    }
}

/// The place of a construction.
///
/// Coordinates are scaled and shifted alike and rounded to single precision, then turned.
///
/// Until a construction is turned, equal coordinates stay equal, and the order of coordinates never reverses.
/// Turns by permutations of the axes are exact.
#[derive(Clone, Debug)]
pub struct Place {
    pub scale: f64,
    pub shift: f64,
    pub turn: DMat3,
}

impl Place {
    /// Places one coordinate, without the turn.
    pub fn local(&self, c: f64) -> f32 {
        (c * self.scale + self.shift) as f32
    }

    /// Places a point, without the turn.
    pub fn point(&self, p: [f64; 3]) -> Vec3 {
        p.map(|c| self.local(c)).into()
    }

    pub fn turned(&self, p: Vec3) -> Vec3 {
        (self.turn * p.as_dvec3()).as_vec3()
    }

    /// Places a polygon of a query. A turned polygon is flat up to the rounding of doubles.
    pub fn polygon(&self, corners: &[[f64; 3]]) -> Vec<DVec3> {
        corners
            .iter()
            .map(|p| self.turn * self.point(*p).as_dvec3())
            .collect()
    }

    /// Places a rectangle of a query in a plane z.
    pub fn rectangle(&self, z: f64, x: [f64; 2], y: [f64; 2]) -> Vec<DVec3> {
        self.polygon(&[
            [x[0], y[0], z],
            [x[1], y[0], z],
            [x[1], y[1], z],
            [x[0], y[1], z],
        ])
    }

    /// Places a square of a query in a plane z.
    pub fn square(&self, [x, y, z]: [f64; 3], half: f64) -> Vec<DVec3> {
        self.rectangle(z, [x - half, x + half], [y - half, y + half])
    }
}

/// Returns permutations of the axes with flips, some of which mirror.
pub fn permutations() -> Vec<DMat3> {
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    [[x, y, z], [y, z, x], [z, -y, x], [-x, -z, -y]]
        .map(|[a, b, c]| DMat3::from_cols(a, b, c))
        .to_vec()
}

fn places(scales: &[f64], shifts: &[f64], turns: &[DMat3]) -> Vec<Place> {
    let mut out = Vec::new();
    for scale in scales {
        for shift in shifts {
            out.extend(turns.iter().map(|t| Place {
                scale: *scale,
                shift: shift * scale,
                turn: *t,
            }));
        }
    }
    out
}

/// Returns places that do not round multiples of small powers of two.
pub fn exact() -> Vec<Place> {
    let scales = [-60, -20, 0, 20, 60].map(|e| 2f64.powi(e));
    places(&scales, &[0.0], &permutations())
}

/// Returns places that keep the order of coordinates, and equal coordinates equal.
pub fn ordered() -> Vec<Place> {
    places(
        &[1e-30, 1e-6, 1.0, 1e6, 1e30],
        &[0.0, 1e3],
        &permutations()[..3],
    )
}

/// Returns places that round all coordinates.
pub fn rounded() -> Vec<Place> {
    let turns = [(0.3, 0.7, -0.2), (2.1, -1.0, 0.5), (-0.9, 0.1, 3.0)].map(|(x, y, z)| {
        let turn =
            DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
        DMat3::from_quat(turn)
    });
    places(&[1e-6, 1.0, 1e6], &[0.0, 10.0], &turns)
}

/// A scene during its construction in a place.
pub struct Draft<'a> {
    pub place: &'a Place,
    /// The triangles, without the turn.
    pub triangles: Vec<Corners>,
}

impl<'a> Draft<'a> {
    pub fn new(place: &'a Place) -> Self {
        Self {
            place,
            triangles: Vec::new(),
        }
    }

    pub fn triangle(&mut self, corners: [[f64; 3]; 3]) {
        self.triangles.push(corners.map(|p| self.place.point(p)));
    }

    pub fn quad(&mut self, corners: [[f64; 3]; 4]) {
        self.placed_quad(corners.map(|p| self.place.point(p)));
    }

    pub fn placed_quad(&mut self, [a, b, c, d]: [Vec3; 4]) {
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// Adds a rectangle in a plane z.
    pub fn rectangle(&mut self, z: f64, x: [f64; 2], y: [f64; 2]) {
        self.placed(
            z,
            x.map(|c| self.place.local(c)),
            y.map(|c| self.place.local(c)),
        );
    }

    /// Adds a rectangle in a plane z whose sides are already placed.
    pub fn placed(&mut self, z: f64, x: [f32; 2], y: [f32; 2]) {
        let z = self.place.local(z);
        let corner = |i: usize, j: usize| Vec3::new(x[i], y[j], z);
        self.placed_quad([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]);
    }

    /// Adds a wall in a plane z with a window. The wall has four pieces that overlap, and it reaches as far
    /// as `reach`.
    pub fn window(&mut self, z: f64, reach: f64, x: [f64; 2], y: [f64; 2]) {
        self.placed_window(
            z,
            reach,
            x.map(|c| self.place.local(c)),
            y.map(|c| self.place.local(c)),
        );
    }

    /// Adds a wall with a window like [`Draft::window`], but with the window's sides already placed.
    pub fn placed_window(&mut self, z: f64, reach: f64, x: [f32; 2], y: [f32; 2]) {
        let [lo, hi] = [-reach, reach].map(|c| self.place.local(c));
        self.placed(z, [lo, x[0]], [lo, hi]);
        self.placed(z, [x[1], hi], [lo, hi]);
        self.placed(z, [lo, hi], [lo, y[0]]);
        self.placed(z, [lo, hi], [y[1], hi]);
    }

    /// Adds the box between two corners, of twelve triangles that share their corners.
    pub fn solid(&mut self, lo: [f64; 3], hi: [f64; 3]) {
        let corner = |i: usize| -> [f64; 3] {
            std::array::from_fn(|k| if i >> k & 1 == 1 { hi[k] } else { lo[k] })
        };
        for side in [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ] {
            self.quad(side.map(corner));
        }
    }

    /// Adds an icosahedron whose faces are divided by four `levels` times, with the corners on the sphere.
    ///
    /// The triangles are turned outwards.
    pub fn sphere(&mut self, centre: [f64; 3], radius: f64, levels: u32) {
        let g = (1.0 + 5f64.sqrt()) / 2.0;
        let corners: Vec<DVec3> = [[0.0, 1.0, g], [1.0, g, 0.0], [g, 0.0, 1.0]]
            .iter()
            .flat_map(|p| {
                [
                    [1.0, 1.0, 1.0],
                    [-1.0, 1.0, 1.0],
                    [1.0, -1.0, 1.0],
                    [1.0, 1.0, -1.0],
                    [-1.0, -1.0, 1.0],
                    [1.0, -1.0, -1.0],
                    [-1.0, 1.0, -1.0],
                    [-1.0, -1.0, -1.0],
                ]
                .map(|s| DVec3::from(*p) * DVec3::from(s))
            })
            .filter(|p| {
                p.to_array()
                    .iter()
                    .all(|c| *c != 0.0 || c.is_sign_positive())
            })
            .map(DVec3::normalize)
            .collect();
        assert_eq!(corners.len(), 12);
        // Neighbours are the nearest corners.
        let near = |p: DVec3, q: DVec3| p.dot(q) > 0.4;
        let mut faces = Vec::new();
        for i in 0..12 {
            for j in i + 1..12 {
                for k in j + 1..12 {
                    let [a, b, c] = [corners[i], corners[j], corners[k]];
                    if near(a, b) && near(b, c) && near(c, a) {
                        let outward = (b - a).cross(c - a).dot(a) > 0.0;
                        faces.push(if outward { [a, b, c] } else { [a, c, b] });
                    }
                }
            }
        }
        assert_eq!(faces.len(), 20);
        for _ in 0..levels {
            faces = faces
                .into_iter()
                .flat_map(|[a, b, c]| {
                    let [p, q, r] = [a + b, b + c, c + a].map(DVec3::normalize);
                    [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
                })
                .collect();
        }
        for face in faces {
            self.triangle(face.map(|p| (DVec3::from(centre) + p * radius).to_array()));
        }
    }

    pub fn done(self) -> World {
        World::new(
            self.triangles
                .iter()
                .map(|t| t.map(|p| self.place.turned(p)))
                .collect(),
        )
    }
}

/// A source of random numbers and directions.
pub struct Random(SplitMix64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    /// Returns a number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.0.unit_f64()
    }

    pub fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Returns one of the numbers below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        (self.0.bits() % n as u64) as usize
    }

    /// Returns a point on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let p = DVec3::from([0; 3].map(|_| self.between(-1.0, 1.0)));
            if (0.01..1.0).contains(&p.length()) {
                return p.normalize();
            }
        }
    }
}
