//! The planes and vertices around one tetrahedron, and the side of a plane on which a vertex lies, exactly.
//!
//! A side is the sign of a determinant of four planes. The side is 0 if the vertex is known to lie on the
//! plane: the plane is one of the vertex's three planes, or shares points of the input with these planes.
//! Otherwise doubles with error bounds decide the side, and integers decide the side if doubles do not.
//! Coordinates are relative to one nearby point, which makes integers short and bounds narrow.

use std::cmp::Ordering;

use dashu_int::IBig;
use rustc_hash::FxHashMap;
use sightline_geometry::predicates::dyadic;
use sightline_numbers::integer::ratio;

use super::number::{Approx, Number, along_axis, meet, through_points, value};
use super::planes::{NONE, Plane};

/// The points, the planes and the scale that all tetrahedra share.
pub struct SharedGeometry<'a> {
    /// The points of the input.
    pub points: &'a [[f32; 3]],
    /// The planes by number.
    pub planes: &'a [Plane],
    /// The power of two by which coordinates are multiplied, so that every difference is at most 1.
    scale: f64,
    /// The exponent of the unit: every coordinate is an integer times two to this power.
    least: i32,
    /// The maximum error of a rounded vertex that is computed from doubles, in units of the scene.
    tolerance: f64,
}

impl<'a> SharedGeometry<'a> {
    /// Creates the shared geometry, and computes the scale and the unit of the points.
    pub fn new(points: &'a [[f32; 3]], planes: &'a [Plane]) -> Self {
        let mut least = i32::MAX;
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in points {
            for i in 0..3 {
                let x = f64::from(p[i]);
                let (mantissa, exponent) = dyadic(x);
                if mantissa != 0 {
                    least = least.min(exponent);
                }
                (min[i], max[i]) = (min[i].min(x), max[i].max(x));
            }
        }
        let size = (0..3).map(|i| max[i] - min[i]).fold(0.0, f64::max);
        // The exponent of the power of two above the size: the double's own exponent plus one.
        let exponent = if size > 0.0 {
            (size.to_bits() >> 52) as i32 - 1022
        } else {
            0
        };
        let tolerance = 2f64.powi(exponent - ROUNDED_BITS);
        Self {
            points,
            planes,
            scale: 2f64.powi(-exponent),
            least: least.min(127),
            tolerance,
        }
    }

    fn doubles(&self, point: u32, origin: [f32; 3]) -> [Approx; 3] {
        let p = self.points[point as usize];
        std::array::from_fn(|i| {
            Approx::difference(f64::from(p[i]), f64::from(origin[i]), self.scale)
        })
    }

    fn integers(&self, point: u32, origin: [f32; 3]) -> [IBig; 3] {
        let p = self.points[point as usize];
        let one = |x: f32| {
            let (mantissa, exponent) = dyadic(f64::from(x));
            if mantissa == 0 {
                IBig::ZERO
            } else {
                IBig::from(mantissa) << (exponent - self.least) as usize
            }
        };
        std::array::from_fn(|i| one(p[i]) - one(origin[i]))
    }

    fn equation<T: Number>(&self, plane: Plane, point: impl Fn(u32) -> [T; 3]) -> [T; 4] {
        let [a, b, c] = plane.0;
        match plane.axis() {
            Some(axis) => along_axis([&point(a), &point(b)], axis),
            None => through_points([&point(a), &point(b), &point(c)]),
        }
    }
}

/// Precision of rounded vertices, in bits.
///
/// The error of a rounded coordinate is at most two to the power of −`ROUNDED_BITS` times the power of two
/// above the box's largest side, plus one unit in the last place.
pub const ROUNDED_BITS: i32 = 44;

/// The key of a vertex: `[point, NONE, NONE]` with a point number, or the global numbers of three planes,
/// ascending.
pub type VertexKey = [u32; 3];

/// Returns the key of the vertex at the point of the input with this number.
pub fn point_key(point: u32) -> VertexKey {
    [point, NONE, NONE]
}

struct LocalPlane {
    /// The global number of the plane.
    number: u32,
    doubles: [Approx; 4],
    integers: Option<Box<[IBig; 4]>>,
    /// The numbers of points of the input that are known to lie on the plane. The list need not be complete.
    points: Vec<u32>,
}

struct Vertex {
    key: VertexKey,
    /// The local numbers of the vertex's three planes; `NONE` for a point of the input.
    planes: [u32; 3],
    /// The homogeneous coordinates in doubles; the last coordinate is positive.
    doubles: [Approx; 4],
    integers: Option<Box<[IBig; 4]>>,
    /// True if the last coordinate was negative before all coordinates were negated.
    is_negated: bool,
}

/// The number of all exact decisions, and the number of decisions that needed integers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decisions {
    /// The number of signs of determinants that were computed.
    pub all: u64,
    /// The number of signs that doubles did not decide.
    pub integers: u64,
}

impl std::ops::AddAssign for Decisions {
    fn add_assign(&mut self, other: Self) {
        self.all += other.all;
        self.integers += other.integers;
    }
}

/// The planes and vertices around one tetrahedron. A local number is an index into these lists; a global
/// number is the same for all tetrahedra.
pub struct LocalGeometry<'a> {
    /// The geometry that all tetrahedra share.
    pub world: &'a SharedGeometry<'a>,
    origin: [f32; 3],
    planes: Vec<LocalPlane>,
    plane_of: FxHashMap<u32, u32>,
    vertices: Vec<Vertex>,
    vertex_of: FxHashMap<VertexKey, u32>,
    /// The signs that doubles did not decide, by the local numbers of vertex and plane.
    signs: FxHashMap<(u32, u32), i8>,
    /// The number of decisions so far.
    pub decisions: Decisions,
}

impl<'a> LocalGeometry<'a> {
    /// Creates empty lists of planes and vertices. Coordinates are relative to the point with the number
    /// `origin`.
    pub fn new(world: &'a SharedGeometry<'a>, origin: u32) -> Self {
        Self {
            world,
            origin: world.points[origin as usize],
            planes: Vec::new(),
            plane_of: FxHashMap::default(),
            vertices: Vec::new(),
            vertex_of: FxHashMap::default(),
            signs: FxHashMap::default(),
            decisions: Decisions::default(),
        }
    }

    /// Returns the local number of the plane with the global number `number`, and records that `points` lie
    /// on the plane.
    pub fn plane(&mut self, number: u32, points: &[u32]) -> u32 {
        let (world, origin) = (self.world, self.origin);
        let planes = &mut self.planes;
        let local = *self.plane_of.entry(number).or_insert_with(|| {
            let plane = world.planes[number as usize];
            let doubles = world.equation(plane, |p| world.doubles(p, origin));
            let points = plane.given().to_vec();
            planes.push(LocalPlane {
                number,
                doubles,
                integers: None,
                points,
            });
            planes.len() as u32 - 1
        });
        let known = &mut self.planes[local as usize].points;
        for p in points {
            if !known.contains(p) {
                known.push(*p);
            }
        }
        local
    }

    /// Returns the global number of a local plane.
    pub fn number(&self, plane: u32) -> u32 {
        self.planes[plane as usize].number
    }

    /// Returns the key of a local vertex.
    pub fn key(&self, vertex: u32) -> VertexKey {
        self.vertices[vertex as usize].key
    }

    /// Returns the local number of the vertex at a point of the input.
    pub fn point(&mut self, point: u32) -> u32 {
        let vertices = &mut self.vertices;
        *self.vertex_of.entry(point_key(point)).or_insert_with(|| {
            let doubles = [Approx::default(); 4];
            vertices.push(Vertex {
                key: point_key(point),
                planes: [NONE; 3],
                doubles,
                integers: None,
                is_negated: false,
            });
            vertices.len() as u32 - 1
        })
    }

    /// Returns the local number of the vertex in which three planes meet, given their local numbers. The
    /// planes must have exactly one common point.
    pub fn meet(&mut self, p: u32, q: u32, r: u32) -> u32 {
        let [a, b, c] = [p, q, r].map(|l| &self.planes[l as usize].points);
        if let Some(point) = a.iter().find(|x| b.contains(x) && c.contains(x)).copied() {
            return self.point(point);
        }
        let mut planes = [p, q, r];
        planes.sort_unstable_by_key(|l| self.planes[*l as usize].number);
        let key = planes.map(|l| self.planes[l as usize].number);
        if let Some(v) = self.vertex_of.get(&key) {
            return *v;
        }
        let [a, b, c] = planes.map(|l| &self.planes[l as usize].doubles);
        let mut vertex = Vertex {
            key,
            planes,
            doubles: meet(a, b, c),
            integers: None,
            is_negated: false,
        };
        self.decisions.all += 1;
        vertex.is_negated = match vertex.doubles[3].sign() {
            Some(sign) => sign < 0,
            None => {
                self.decisions.integers += 1;
                let exact = self.exact_meet(planes);
                let is_negative = exact[3] < IBig::ZERO;
                vertex.integers = Some(Box::new(if is_negative {
                    exact.map(|x| -x)
                } else {
                    exact
                }));
                is_negative
            }
        };
        if vertex.is_negated {
            vertex.doubles = vertex.doubles.map(Approx::negated);
        }
        let v = self.vertices.len() as u32;
        self.vertices.push(vertex);
        self.vertex_of.insert(key, v);
        v
    }

    /// Returns the side of a plane on which a vertex lies, given their local numbers.
    ///
    /// The side is 1 in front, −1 behind, and 0 on the plane.
    pub fn side(&mut self, vertex: u32, plane: u32) -> i8 {
        let (v, s) = (
            &self.vertices[vertex as usize],
            &self.planes[plane as usize],
        );
        if v.planes[0] == NONE {
            let point = v.key[0];
            if s.points.contains(&point) {
                return 0;
            }
            self.decisions.all += 1;
            return sign(self.world.planes[s.number as usize].side_of(self.world.points, point));
        }
        if v.planes.contains(&plane) {
            return 0;
        }
        self.decisions.all += 1;
        if let Some(sign) = value(&s.doubles, &v.doubles).sign() {
            return sign;
        }
        if let Some(sign) = self.signs.get(&(vertex, plane)) {
            return *sign;
        }
        let sign = if self.is_on_shared_line(vertex, plane) {
            0
        } else {
            self.exact_side(vertex, plane)
        };
        self.signs.insert((vertex, plane), sign);
        sign
    }

    /// Returns true if two planes of a vertex share two input points with a third plane.
    ///
    /// Then the three planes share a line, and the vertex lies on this line.
    fn is_on_shared_line(&self, vertex: u32, plane: u32) -> bool {
        let [p, q, r] = self.vertices[vertex as usize]
            .planes
            .map(|l| &self.planes[l as usize].points);
        let s = &self.planes[plane as usize].points;
        let shared = |p: &[u32], q: &[u32]| {
            s.iter()
                .filter(|x| p.contains(x) && q.contains(x))
                .take(2)
                .count()
                == 2
        };
        shared(p, q) || shared(q, r) || shared(r, p)
    }

    fn exact_side(&mut self, vertex: u32, plane: u32) -> i8 {
        self.decisions.integers += 1;
        self.need_integers(plane);
        if self.vertices[vertex as usize].integers.is_none() {
            let exact = self.exact_meet(self.vertices[vertex as usize].planes);
            let v = &mut self.vertices[vertex as usize];
            v.integers = Some(Box::new(if v.is_negated {
                exact.map(|x| -x)
            } else {
                exact
            }));
        }
        match (
            &self.planes[plane as usize].integers,
            &self.vertices[vertex as usize].integers,
        ) {
            (Some(s), Some(v)) => sign(value(s, v).cmp(&IBig::ZERO)),
            // Both values were computed above.
            _ => 0,
        }
    }

    fn need_integers(&mut self, plane: u32) {
        let (world, origin) = (self.world, self.origin);
        let p = &mut self.planes[plane as usize];
        if p.integers.is_none() {
            let plane = world.planes[p.number as usize];
            p.integers = Some(Box::new(
                world.equation(plane, |x| world.integers(x, origin)),
            ));
        }
    }

    fn exact_meet(&mut self, planes: [u32; 3]) -> [IBig; 4] {
        for p in planes {
            self.need_integers(p);
        }
        match planes.map(|l| &self.planes[l as usize].integers) {
            [Some(a), Some(b), Some(c)] => meet(a, b, c),
            // All values were computed above.
            _ => std::array::from_fn(|_| IBig::ZERO),
        }
    }

    /// Returns a vertex in doubles, with the precision of [`ROUNDED_BITS`].
    pub fn rounded(&mut self, vertex: u32) -> [f64; 3] {
        let v = &self.vertices[vertex as usize];
        if v.planes[0] == NONE {
            return self.world.points[v.key[0] as usize].map(f64::from);
        }
        let origin = self.origin.map(f64::from);
        let w = v.doubles[3];
        let at = |x: Approx| x.value / w.value;
        // Twice the error of a quotient, which covers the roundings of this formula. `most` adds the
        // roundings of the result.
        let error = |x: Approx| 2.0 * (x.error + at(x).abs() * w.error) / (w.value - w.error);
        let most = (0..3).map(|i| error(v.doubles[i]) + f64::EPSILON * at(v.doubles[i]).abs());
        let is_near = most.fold(0.0, f64::max) <= self.world.tolerance * self.world.scale;
        if w.sign() == Some(1) && is_near {
            return std::array::from_fn(|i| origin[i] + at(v.doubles[i]) / self.world.scale);
        }
        let exact = self.exact_meet(self.vertices[vertex as usize].planes);
        let is_negative = exact[3] < IBig::ZERO;
        let [x, y, z, w] = if is_negative {
            exact.map(|x| -x)
        } else {
            exact
        };
        let zero = self.world.integers_of(self.origin);
        // Exact coordinates relative to the origin of the scene need only one rounding.
        let absolute = |x: IBig, o: &IBig| self.world.unscaled(&(x + o * &w), &w);
        [
            absolute(x, &zero[0]),
            absolute(y, &zero[1]),
            absolute(z, &zero[2]),
        ]
    }
}

impl SharedGeometry<'_> {
    fn integers_of(&self, place: [f32; 3]) -> [IBig; 3] {
        place.map(|x| {
            let (mantissa, exponent) = dyadic(f64::from(x));
            if mantissa == 0 {
                IBig::ZERO
            } else {
                IBig::from(mantissa) << (exponent - self.least) as usize
            }
        })
    }

    /// Computes a quotient of integers, which are in units of 2 to the power of `least`, in units of the
    /// scene.
    fn unscaled(&self, n: &IBig, d: &IBig) -> f64 {
        ratio(n, d) * 2f64.powi(self.least)
    }
}

fn sign(order: Ordering) -> i8 {
    order as i8
}
