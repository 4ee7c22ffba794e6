//! Planes and vertices in integers of any size, for the checker only.

use std::rc::Rc;

use dashu_int::IBig;
use rustc_hash::FxHashMap;
use sightline_geometry::predicates::dyadic;

use super::fault::Fault;
use super::residues::{Field, ResiduePlace};
use crate::cells::{CellsView, Plane};

/// The points of cells as integers, in units of one power of two, with the planes and vertices of the cells.
pub(crate) struct Integers<'a> {
    cells: CellsView<'a>,
    /// The exponent of the unit: the unit is 2 to the power of `least`.
    pub least: i32,
}

impl<'a> Integers<'a> {
    pub fn new(cells: CellsView<'a>) -> Self {
        let parts = cells
            .points
            .as_flattened()
            .iter()
            .map(|x| dyadic(f64::from(*x)));
        let least = parts
            .filter(|(m, _)| *m != 0)
            .map(|(_, e)| e)
            .min()
            .unwrap_or(0);
        Self { cells, least }
    }

    pub fn point(&self, point: u32) -> [IBig; 3] {
        self.cells.points[point as usize].map(|x| {
            let (mantissa, exponent) = dyadic(f64::from(x));
            if mantissa == 0 {
                IBig::ZERO
            } else {
                IBig::from(mantissa) << (exponent - self.least) as usize
            }
        })
    }

    /// Computes the plane through three points: normal and offset. The plane's value at a point p is
    /// normal · p + offset.
    pub fn through(&self, corners: [u32; 3]) -> [IBig; 4] {
        let [a, b, c] = corners.map(|p| self.point(p));
        let third = std::array::from_fn(|i| &c[i] - &a[i]);
        spanned(&a, &std::array::from_fn(|i| &b[i] - &a[i]), &third)
    }

    /// Computes the plane through two points that is parallel to an axis, as normal and offset.
    pub fn along(&self, [a, b]: [u32; 2], axis: usize) -> [IBig; 4] {
        let [a, b] = [a, b].map(|p| self.point(p));
        let unit = std::array::from_fn(|i| IBig::from(u8::from(i == axis)));
        spanned(&a, &std::array::from_fn(|i| &b[i] - &a[i]), &unit)
    }

    pub fn plane(&self, plane: Plane) -> [IBig; 4] {
        match plane.axis() {
            Some(axis) => self.along([plane.0[0], plane.0[1]], axis),
            None => self.through(plane.0),
        }
    }

    /// Computes a vertex in homogeneous coordinates. The last coordinate is positive.
    ///
    /// Returns `None` if the planes of the vertex do not meet in a single point.
    pub fn vertex(&self, vertex: u32) -> Option<[IBig; 4]> {
        let n = self.cells.points.len();
        if (vertex as usize) < n {
            let [x, y, z] = self.point(vertex);
            return Some([x, y, z, IBig::ONE]);
        }
        let planes = self.cells.meets[vertex as usize - n];
        let [p, q, r] = planes.map(|p| self.plane(self.cells.planes[p as usize]));
        // Cramer's rule, with the offsets on the other side of the equations.
        let column = |i: usize| [&p[i], &q[i], &r[i]];
        let minus = [-&p[3], -&q[3], -&r[3]];
        let right = [&minus[0], &minus[1], &minus[2]];
        let w = det3(column(0), column(1), column(2));
        let x = det3(right, column(1), column(2));
        let y = det3(column(0), right, column(2));
        let z = det3(column(0), column(1), right);
        match sign(&w) {
            0 => None,
            1 => Some([x, y, z, w]),
            _ => Some([-x, -y, -z, -w]),
        }
    }
}

/// A cache of vertices and planes, because neighbouring cells share vertices and planes.
pub(crate) struct KnownGeometry<'a> {
    integers: &'a Integers<'a>,
    vertices: FxHashMap<u32, Rc<[IBig; 4]>>,
    planes: FxHashMap<u32, Rc<[IBig; 4]>>,
    places: FxHashMap<u32, ResiduePlace>,
}

impl<'a> KnownGeometry<'a> {
    pub fn new(integers: &'a Integers<'a>) -> Self {
        let (vertices, planes, places) = Default::default();
        Self {
            integers,
            vertices,
            planes,
            places,
        }
    }

    pub fn vertex(&mut self, vertex: u32) -> Result<Rc<[IBig; 4]>, Fault> {
        if let Some(known) = self.vertices.get(&vertex) {
            return Ok(known.clone());
        }
        let made = Rc::new(self.integers.vertex(vertex).ok_or(Fault::Vertex(vertex))?);
        self.vertices.insert(vertex, made.clone());
        Ok(made)
    }

    pub fn plane(&mut self, plane: u32) -> Rc<[IBig; 4]> {
        let made = || {
            Rc::new(
                self.integers
                    .plane(self.integers.cells.planes[plane as usize]),
            )
        };
        self.planes.entry(plane).or_insert_with(made).clone()
    }

    pub fn place(&mut self, vertex: u32, field: &Field) -> Result<ResiduePlace, Fault> {
        if let Some(known) = self.places.get(&vertex) {
            return Ok(*known);
        }
        let place = field.place(&*self.vertex(vertex)?);
        self.places.insert(vertex, place);
        Ok(place)
    }
}

fn spanned(at: &[IBig; 3], d: &[IBig; 3], e: &[IBig; 3]) -> [IBig; 4] {
    let n = |i: usize, j: usize| &d[i] * &e[j] - &d[j] * &e[i];
    let (x, y, z) = (n(1, 2), n(2, 0), n(0, 1));
    let offset = -(&x * &at[0] + &y * &at[1] + &z * &at[2]);
    [x, y, z, offset]
}

/// Computes the determinant with three columns.
pub(crate) fn det3(a: [&IBig; 3], b: [&IBig; 3], c: [&IBig; 3]) -> IBig {
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// Returns the side of a plane on which a vertex lies: 1 in front, 0 on the plane, −1 behind. The last
/// homogeneous coordinate of the vertex must be positive.
pub(crate) fn side(plane: &[IBig; 4], v: &[IBig; 4]) -> i8 {
    sign(&(&plane[0] * &v[0] + &plane[1] * &v[1] + &plane[2] * &v[2] + &plane[3] * &v[3]))
}

/// Returns the sign of a number: 1, 0 or −1.
pub(crate) fn sign(x: &IBig) -> i8 {
    x.cmp(&IBig::ZERO) as i8
}

/// Returns the axis with the largest component of a plane's normal, and the sign of this component.
///
/// The sign is 0 if the normal is zero.
pub(crate) fn main_axis(plane: &[IBig; 4]) -> (usize, i8) {
    let size = |i: usize| {
        if sign(&plane[i]) < 0 {
            -&plane[i]
        } else {
            plane[i].clone()
        }
    };
    let mut axis = 0;
    for i in 1..3 {
        if size(i) > size(axis) {
            axis = i;
        }
    }
    (axis, sign(&plane[axis]))
}
