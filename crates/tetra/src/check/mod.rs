//! The checker of cells, which uses integers only and no code of the construction.
//!
//! Exact signs decide the following conditions:
//! - Each vertex is near its position in doubles.
//! - Each face lies in its plane, is convex and turns counter-clockwise.
//! - All vertices of a cell are on the cell's side of each of its faces, and some are off the face.
//! - The cell in front of a face and the cell behind the face list the face once. A face on the border of the
//!   box has one cell.
//! - Each face that lists a triangle lies in the triangle.
//! - From a cell to its neighbour, the number of solids around the cell changes by the number of solids that
//!   begin or end in the common face.
//!
//! Residues modulo two primes decide the following conditions:
//! - The edges of a cell's faces cancel on each line.
//! - The volumes of the cells add up to the volume of the box.
//! - The areas of a triangle's faces add up to the area of the triangle.
//!
//! These conditions imply that the cells are right. The faces of a cell are a closed surface in the border of
//! the convex body K that their planes bound. So the faces cover the border of K k times, and k ≥ 1 because
//! each face turns counter-clockwise. Summed over all cells, inner faces cancel. So every point in the box is
//! inside the same number of cells, and the volumes show that this number is 1. So the cells are convex and
//! fill the box without overlap. Then faces of one plane do not overlap either. If the faces of a triangle
//! lie in the triangle and have the same total area, they therefore cover the triangle once, and no triangle
//! passes through the inside of a cell.

mod fault;
pub(crate) mod integers;
pub(crate) mod residues;
pub(crate) mod structure;

use std::rc::Rc;

use dashu_int::IBig;
use dashu_int::ops::BitTest as _;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use sightline_geometry::predicates::dyadic;

use crate::cells::{CellsView, NONE};
use crate::file::Contents;
use crate::surfaces::{CLOSED, SurfacesView};

pub use fault::Fault;
use integers::{Integers, KnownGeometry, det3, main_axis, side, sign};
use residues::{Field, ResiduePair, ResiduePlace};

/// Checks the cells of a file against its surfaces, and the numbers of solids around cells.
///
/// # Errors
/// The first [`Fault`] if the cells or the numbers of solids are faulty.
pub fn check(contents: &Contents<'_>) -> Result<(), Fault> {
    let Contents {
        cells,
        surfaces,
        windings,
        ref digest,
        ..
    } = *contents;
    structure::check(cells, surfaces)?;
    let checker = Checker {
        cells,
        surfaces,
        integers: Integers::new(cells),
        field: Field::new(digest),
        bounds: structure::bounds(cells),
    };
    first((0..cells.planes.len()).into_par_iter(), |i| {
        let plane = checker.integers.plane(cells.planes[i]);
        if main_axis(&plane).1 == 0 {
            Err(Fault::Plane(i))
        } else {
            Ok(())
        }
    })?;
    in_parts(cells.meets.len(), |part| {
        let mut known = KnownGeometry::new(&checker.integers);
        part.into_iter()
            .try_for_each(|i| checker.place(i, &mut known))
    })?;
    in_parts(cells.face_count(), |part| {
        let mut known = KnownGeometry::new(&checker.integers);
        part.into_iter()
            .try_for_each(|i| checker.face(i as u32, &mut known))
    })?;
    first((0..cells.face_count()).into_par_iter(), |i| {
        checker.solids(i as u32, windings)
    })?;
    let volumes = in_parts(cells.cell_count(), |part| {
        let mut known = KnownGeometry::new(&checker.integers);
        part.into_iter().try_fold(ResiduePair::default(), |sum, i| {
            Ok(checker.field.add(sum, checker.cell(i as u32, &mut known)?))
        })
    })?;
    let sum = volumes
        .into_iter()
        .fold(ResiduePair::default(), |sum, part| {
            checker.field.add(sum, part)
        });
    if sum != checker.box_volume() {
        return Err(Fault::Volume);
    }
    checker.triangles()
}

/// Runs a check on all indices, and returns the fault at the smallest index with a fault.
fn first(
    indices: impl IndexedParallelIterator<Item = usize>,
    check: impl Fn(usize) -> Result<(), Fault> + Sync + Send,
) -> Result<(), Fault> {
    indices
        .map(check)
        .find_map_first(Result::err)
        .map_or(Ok(()), Err)
}

/// Number of consecutive list entries that one thread checks with one cache. Entries near each other in a
/// list share vertices.
const PART: usize = 4096;

/// Runs a check on consecutive parts of all indices.
///
/// Returns the results of all parts, or the fault of the first faulty part.
fn in_parts<T: Send>(
    count: usize,
    check: impl Fn(std::ops::Range<usize>) -> Result<T, Fault> + Sync + Send,
) -> Result<Vec<T>, Fault> {
    let parts = (0..count.div_ceil(PART)).into_par_iter();
    let all: Vec<Result<T, Fault>> = parts
        .map(|n| check(n * PART..((n + 1) * PART).min(count)))
        .collect();
    all.into_iter().collect()
}

struct Checker<'a> {
    cells: CellsView<'a>,
    surfaces: SurfacesView<'a>,
    integers: Integers<'a>,
    field: Field,
    /// The numbers of the points at the corners of the box with the smallest and the largest coordinates.
    bounds: [u32; 2],
}

impl Checker<'_> {
    /// Checks that the position of a vertex in doubles is near the exact vertex.
    ///
    /// In each coordinate the distance must be at most 2⁻⁴⁴ times the power of two above the box's largest
    /// side, plus one unit in the last place.
    fn place(&self, meet: usize, known: &mut KnownGeometry<'_>) -> Result<(), Fault> {
        let vertex = (self.cells.points.len() + meet) as u32;
        let exact = known.vertex(vertex)?;
        let [min, max] = self.bounds.map(|p| self.integers.point(p));
        let greatest = (0..3).map(|i| &max[i] - &min[i]).max().unwrap_or_default();
        let least = self.integers.least;
        let share = greatest.bit_len() as i32 + least - 44;
        for (k, place) in self.cells.rounded[meet].into_iter().enumerate() {
            let (mantissa, exponent) = dyadic(place);
            // The unit in the last place. A subnormal number has the smallest unit that exists.
            let last = (((place.to_bits() >> 52 & 0x7ff) as i32).max(1)) - 1075;
            let unit = least
                .min(share)
                .min(last)
                .min(if mantissa == 0 { least } else { exponent });
            let in_units = |number: IBig, exponent: i32| number << (exponent - unit) as usize;
            let given = if mantissa == 0 {
                IBig::ZERO
            } else {
                in_units(IBig::from(mantissa), exponent)
            };
            let apart = given * &exact[3] - in_units(exact[k].clone(), least);
            let most = (in_units(IBig::ONE, share) + in_units(IBig::ONE, last)) * &exact[3];
            if apart > most || -apart > most {
                return Err(Fault::Place(vertex));
            }
        }
        Ok(())
    }

    fn face(&self, face: u32, known: &mut KnownGeometry<'_>) -> Result<(), Fault> {
        let record = self.cells.faces[face as usize];
        let numbers = self.cells.face_loop(face as usize);
        let loops = numbers
            .iter()
            .map(|v| known.vertex(*v))
            .collect::<Result<Vec<_>, _>>()?;
        let plane = known.plane(record.plane);
        for (v, number) in loops.iter().zip(numbers) {
            if side(&plane, v) != 0 {
                return Err(Fault::OffPlane {
                    face,
                    vertex: *number,
                });
            }
        }
        let (axis, up) = main_axis(&plane);
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let n = loops.len();
        let mut turns = false;
        for k in 0..n {
            let [u, v, w] = [0, 1, 2].map(|s| &loops[(k + s) % n]);
            let row = |x: usize| [&u[x], &v[x], &w[x]];
            let turn = sign(&det3(row(i), row(j), row(3))) * up;
            if turn < 0 {
                return Err(Fault::NotConvex(face));
            }
            turns |= turn > 0;
        }
        if !turns {
            return Err(Fault::NotConvex(face));
        }
        if record.cells.contains(&NONE) {
            self.border(face, &loops)?;
        }
        self.cells
            .face_triangles(face as usize)
            .iter()
            .try_for_each(|id| self.covered(face, *id, &loops))
    }

    /// Checks that a face with one cell is in one of the six sides of the box.
    fn border(&self, face: u32, loops: &[Rc<[IBig; 4]>]) -> Result<(), Fault> {
        let bounds = self.bounds.map(|p| self.integers.point(p));
        let is_on =
            |axis: usize, bound: &[IBig; 3]| loops.iter().all(|v| v[axis] == &bound[axis] * &v[3]);
        let on_one = bounds.iter().any(|b| (0..3).any(|axis| is_on(axis, b)));
        if on_one {
            Ok(())
        } else {
            Err(Fault::Border(face))
        }
    }

    /// Checks that a face that lists a triangle is in the triangle's plane and within the triangle's edges.
    fn covered(&self, face: u32, triangle: u32, loops: &[Rc<[IBig; 4]>]) -> Result<(), Fault> {
        let corners = self.surfaces.triangles[triangle as usize];
        let plane = self.integers.through(corners);
        let (axis, up) = main_axis(&plane);
        let is_in = up != 0
            && loops.iter().all(|v| side(&plane, v) == 0)
            && (0..3).all(|k| {
                let edge = self
                    .integers
                    .along([corners[k], corners[(k + 1) % 3]], axis);
                let [x, y, z] = self.integers.point(corners[(k + 2) % 3]);
                let inner = side(&edge, &[x, y, z, IBig::ONE]);
                loops.iter().all(|v| side(&edge, v) * inner >= 0)
            });
        if is_in {
            Ok(())
        } else {
            Err(Fault::NotOf { face, triangle })
        }
    }

    /// Checks the numbers of solids around the two cells of a face.
    ///
    /// The two numbers must differ by the number of solids that begin or end in the face. Outside of the box,
    /// the number of solids is 0.
    fn solids(&self, face: u32, windings: &[i32]) -> Result<(), Fault> {
        let record = self.cells.faces[face as usize];
        let [front, behind] = record.cells.map(|cell| match cell {
            NONE => Some(0),
            cell => windings.get(cell as usize).map(|w| i64::from(*w)),
        });
        let plane = self
            .integers
            .plane(self.cells.planes[record.plane as usize]);
        let closed = |id: &&u32| self.surfaces.flags[**id as usize] & CLOSED != 0;
        let begin: i64 = self
            .cells
            .face_triangles(face as usize)
            .iter()
            .filter(closed)
            .map(|id| {
                let own = self.integers.through(self.surfaces.triangles[*id as usize]);
                let along = &own[0] * &plane[0] + &own[1] * &plane[1] + &own[2] * &plane[2];
                i64::from(sign(&along))
            })
            .sum();
        match (front, behind) {
            (Some(front), Some(behind)) if behind == front + begin => Ok(()),
            _ => Err(Fault::Solids(face)),
        }
    }

    /// Checks that a cell is convex, has a volume, and that its faces close. Returns six times the cell's
    /// volume, modulo the two primes.
    fn cell(&self, cell: u32, known: &mut KnownGeometry<'_>) -> Result<ResiduePair, Fault> {
        let faces = self.cells.faces_of(cell as usize);
        let mut numbers: Vec<u32> = faces
            .iter()
            .flat_map(|f| self.cells.face_loop((f / 2) as usize))
            .copied()
            .collect();
        numbers.sort_unstable();
        numbers.dedup();
        let vertices = numbers
            .iter()
            .map(|v| known.vertex(*v))
            .collect::<Result<Vec<_>, _>>()?;
        let mut is_flat = true;
        for f in faces {
            let (face, inner) = (f / 2, if f & 1 == 0 { 1 } else { -1 });
            let plane = known.plane(self.cells.faces[face as usize].plane);
            for (v, number) in vertices.iter().zip(&numbers) {
                let side = side(&plane, v) * inner;
                if side < 0 {
                    return Err(Fault::Beyond {
                        cell,
                        face,
                        vertex: *number,
                    });
                }
                is_flat &= side == 0;
            }
        }
        if is_flat {
            return Err(Fault::Flat(cell));
        }
        let places: Vec<ResiduePlace> = numbers
            .iter()
            .map(|v| known.place(*v, &self.field))
            .collect::<Result<_, _>>()?;
        let place = |v: &u32| {
            numbers
                .binary_search(v)
                .map_or(ResiduePlace::default(), |at| places[at])
        };
        let mut volume = ResiduePair::default();
        let mut edges: Vec<(u32, u32)> = Vec::new();
        for f in faces {
            let numbers = self.cells.face_loop((f / 2) as usize);
            let loops: Vec<ResiduePlace> = numbers.iter().map(place).collect();
            let from = self.field.difference(&loops[0], &places[0]);
            let part = self.field.dot(&self.field.area(&loops), &from);
            let is_behind = f & 1 == 1;
            // The area vector of a face points to the front of the face, away from the cell behind it.
            volume = if is_behind {
                self.field.add(volume, part)
            } else {
                self.field.sub(volume, part)
            };
            let ends = numbers
                .iter()
                .zip(numbers.iter().cycle().skip(1))
                .map(|(a, b)| (*a, *b));
            edges.extend(ends.map(|(a, b)| if is_behind { (a, b) } else { (b, a) }));
        }
        if self.closes(&edges, place) {
            Ok(volume)
        } else {
            Err(Fault::Open(cell))
        }
    }

    /// Returns true if directed edges, given as pairs of vertex numbers, cancel on each line.
    ///
    /// Edges on a line cancel if each position is the end of as many edges as it is the start of.
    fn closes(&self, edges: &[(u32, u32)], place: impl Fn(&u32) -> ResiduePlace) -> bool {
        let mut net: FxHashMap<(u32, u32), i32> = FxHashMap::default();
        for (a, b) in edges {
            let (key, sign) = if a < b { ((*a, *b), 1) } else { ((*b, *a), -1) };
            *net.entry(key).or_default() += sign;
        }
        let mut ends: FxHashMap<([ResiduePlace; 2], ResiduePlace), i32> = FxHashMap::default();
        let mut rest: Vec<_> = net.into_iter().filter(|(_, n)| *n != 0).collect();
        rest.sort_unstable();
        for ((a, b), n) in rest {
            let (a, b) = (place(&a), place(&b));
            let line = self.field.line(&a, &b);
            *ends.entry((line, a)).or_default() -= n;
            *ends.entry((line, b)).or_default() += n;
        }
        ends.into_values().all(|n| n == 0)
    }

    fn box_volume(&self) -> ResiduePair {
        let [min, max] = self.bounds.map(|p| self.integers.point(p));
        let six = self.field.integer(&IBig::from(6));
        (0..3).fold(six, |v, i| {
            self.field.mul(v, self.field.integer(&(&max[i] - &min[i])))
        })
    }

    /// Checks that the projected face areas of each triangle add up to the triangle's projected area.
    fn triangles(&self) -> Result<(), Fault> {
        let mut faces: Vec<(u32, u32)> = (0..self.cells.face_count() as u32)
            .flat_map(|f| {
                self.cells
                    .face_triangles(f as usize)
                    .iter()
                    .map(move |id| (*id, f))
            })
            .collect();
        faces.par_sort_unstable();
        let check = |id: usize, known: &mut KnownGeometry<'_>| {
            let corners = self.surfaces.triangles[id];
            let plane = self.integers.through(corners);
            let (axis, up) = main_axis(&plane);
            let start = faces.partition_point(|(t, _)| (*t as usize) < id);
            let own = faces[start..].iter().take_while(|(t, _)| *t as usize == id);
            let mut sum = ResiduePair::default();
            for (_, face) in own {
                let record = self.cells.faces[*face as usize];
                let up = sign(
                    &self
                        .integers
                        .plane(self.cells.planes[record.plane as usize])[axis],
                );
                let loops = self.cells.face_loop(*face as usize).iter();
                let places: Result<Vec<ResiduePlace>, Fault> =
                    loops.map(|v| known.place(*v, &self.field)).collect();
                let area = self.field.area(&places?)[axis];
                sum = if up > 0 {
                    self.field.add(sum, area)
                } else {
                    self.field.sub(sum, area)
                };
            }
            let whole = self.field.integer(&plane[axis]);
            // A triangle without area has a zero normal and no faces.
            let is_whole = if up >= 0 {
                sum == whole
            } else {
                self.field.add(sum, whole) == [0; 2]
            };
            if is_whole {
                Ok(())
            } else {
                Err(Fault::NotCovered(id as u32))
            }
        };
        in_parts(self.surfaces.triangles.len(), |part| {
            let mut known = KnownGeometry::new(&self.integers);
            part.into_iter().try_for_each(|id| check(id, &mut known))
        })?;
        Ok(())
    }
}
