//! Whether cells are what they say, by other code than made them, with integers alone.
//!
//! What is checked with exact signs: each vertex is near its place in doubles; each face lies in its plane,
//! is convex and turns counter-clockwise; all vertices of a cell are on its side of each of its faces, some
//! off it; each face is listed once in front of one cell and once behind another, but for those on the box;
//! each face that names a triangle lies in it; from cell to cell the number of solids changes by those that
//! begin or end between them. What is checked modulo two primes: the edges of a cell's faces cancel on each
//! line; volumes add up to the box's, and the areas of a triangle's faces to the triangle's.
//!
//! What follows. The faces of a cell are a closed surface in the border of the convex body K that their
//! planes bound, so they go k times around K, and k ≥ 1 by their turn. Summed over all cells, inner faces
//! cancel, so the number of times that a place in the box is inside of cells is the same everywhere; by the
//! volumes it is 1. So the cells are convex, and fill the box without overlap. Faces of one plane then do not
//! overlap either, so a triangle whose faces lie in it and have its area is covered once, and no triangle
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
use integers::{Integers, Known, det3, main_axis, side, sign};
use residues::{Both, Field, ResiduePlace};

/// Checks the cells of a file against its surfaces, and the solids around cells.
///
/// # Errors
/// The first [`Fault`].
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
        let mut known = Known::new(&checker.integers);
        part.into_iter()
            .try_for_each(|i| checker.place(i, &mut known))
    })?;
    in_parts(cells.face_count(), |part| {
        let mut known = Known::new(&checker.integers);
        part.into_iter()
            .try_for_each(|i| checker.face(i as u32, &mut known))
    })?;
    first((0..cells.face_count()).into_par_iter(), |i| {
        checker.solids(i as u32, windings)
    })?;
    let volumes = in_parts(cells.cell_count(), |part| {
        let mut known = Known::new(&checker.integers);
        part.into_iter().try_fold(Both::default(), |sum, i| {
            Ok(checker.field.add(sum, checker.cell(i as u32, &mut known)?))
        })
    })?;
    let sum = volumes
        .into_iter()
        .fold(Both::default(), |sum, part| checker.field.add(sum, part));
    if sum != checker.box_volume() {
        return Err(Fault::Volume);
    }
    checker.triangles()
}

/// Runs a check on all indices, and returns the fault of the least.
fn first(
    indices: impl IndexedParallelIterator<Item = usize>,
    check: impl Fn(usize) -> Result<(), Fault> + Sync + Send,
) -> Result<(), Fault> {
    indices
        .map(check)
        .find_map_first(Result::err)
        .map_or(Ok(()), Err)
}

/// Numbers that are checked together. Neighbours in the lists are neighbours in space and share vertices.
const PART: usize = 4096;

/// Runs a check on parts of all indices, and returns what each found, or the fault of the first.
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
    /// A point of the input at the least corner of the box, and one at the greatest.
    bounds: [u32; 2],
}

impl Checker<'_> {
    /// The place of a vertex in doubles is as near to it as it is said to be: 2⁻⁴⁴ of the power of two above
    /// the box's greatest side and one unit in the last place, in each coordinate.
    fn place(&self, meet: usize, known: &mut Known<'_>) -> Result<(), Fault> {
        let vertex = (self.cells.points.len() + meet) as u32;
        let exact = known.vertex(vertex)?;
        let [min, max] = self.bounds.map(|p| self.integers.point(p));
        let greatest = (0..3).map(|i| &max[i] - &min[i]).max().unwrap_or_default();
        let least = self.integers.least;
        let share = greatest.bit_len() as i32 + least - 44;
        for (k, place) in self.cells.rounded[meet].into_iter().enumerate() {
            let (mantissa, exponent) = dyadic(place);
            // The unit in the last place; that of a subnormal number is the least there is.
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

    fn face(&self, face: u32, known: &mut Known<'_>) -> Result<(), Fault> {
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

    /// A face with one cell is in one of the six sides of the box.
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

    /// A face that names a triangle is in its plane and within its edges.
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

    /// The solids that hold the two cells of a face differ by those that begin or end in it; outside of the
    /// box there are none.
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

    /// Six times the volume of a cell, after all checks of its signs.
    fn cell(&self, cell: u32, known: &mut Known<'_>) -> Result<Both, Fault> {
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
        let mut volume = Both::default();
        let mut edges: Vec<(u32, u32)> = Vec::new();
        for f in faces {
            let numbers = self.cells.face_loop((f / 2) as usize);
            let loops: Vec<ResiduePlace> = numbers.iter().map(place).collect();
            let from = self.field.difference(&loops[0], &places[0]);
            let part = self.field.dot(&self.field.area(&loops), &from);
            let is_behind = f & 1 == 1;
            // Area vectors point to the front, away from cells behind.
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

    /// Whether directed edges cancel on each line. On a line they do where each place ends as many as it
    /// begins.
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

    fn box_volume(&self) -> Both {
        let [min, max] = self.bounds.map(|p| self.integers.point(p));
        let six = self.field.integer(&IBig::from(6));
        (0..3).fold(six, |v, i| {
            self.field.mul(v, self.field.integer(&(&max[i] - &min[i])))
        })
    }

    /// The areas of the faces of each triangle, seen along an axis, add up to its own.
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
        let check = |id: usize, known: &mut Known<'_>| {
            let corners = self.surfaces.triangles[id];
            let plane = self.integers.through(corners);
            let (axis, up) = main_axis(&plane);
            let start = faces.partition_point(|(t, _)| (*t as usize) < id);
            let own = faces[start..].iter().take_while(|(t, _)| *t as usize == id);
            let mut sum = Both::default();
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
            // A triangle without area, whose normal is zero, has no faces.
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
            let mut known = Known::new(&self.integers);
            part.into_iter().try_for_each(|id| check(id, &mut known))
        })?;
        Ok(())
    }
}
