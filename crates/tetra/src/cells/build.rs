//! Construction of cells from tetrahedra.
//!
//! The construction finds the tetrahedra that triangles touch, numbers planes, cuts tetrahedra and divides
//! faces. Then the construction collects the results in the order of the tetrahedra.

use std::hash::BuildHasher as _;
use std::sync::atomic::{AtomicU64, Ordering};

use hashbrown::HashTable;
use hashbrown::hash_table::Entry;
use rayon::prelude::*;
use rustc_hash::{FxBuildHasher, FxHashMap};

use super::bsp::{Cuts, Cutter};
use super::facets::{Faces, TetrahedronCells, of_cuts, of_face};
use super::flood::{Meetings, TrianglePlanes, meetings};
use super::input::{CellsError, Tetrahedra, face};
use super::local::{Decisions, LocalGeometry, SharedGeometry};
use super::planes::{NONE, Plane, PlaneTable};
use super::polygon::{Corners, Polygon, reverse};
use super::result::{CellCounts, Cells, FaceRecord};
use crate::surfaces::Surfaces;
use crate::watch::{BuildObserver, BuildStage};

/// Expected memory per tetrahedron with its faces, in bytes.
///
/// The value is the peak of whole runs of `sightline tetra --json` on scenes of 12 231 to 147 829 triangles,
/// which was 489 bytes, plus a margin.
const BYTES_A_TETRAHEDRON: u64 = 550;
/// Expected memory per pair of a tetrahedron and a crossing triangle, in bytes. The peak of the same runs was
/// 176 bytes.
const BYTES_A_MEETING: u64 = 220;

/// Number of tetrahedra whose faces are computed in parallel before one thread collects the faces.
const BATCH: usize = 1 << 14;

/// Computes the convex cells of a box between the triangles of the surfaces.
///
/// # Errors
/// [`CellsError`] if the tetrahedra do not belong to these surfaces or do not fill the box face to face, if
/// 32-bit indices cannot number the cells, faces or vertices, or if the observer rejects the memory use.
pub fn cells(
    surfaces: &Surfaces,
    all: &Tetrahedra<'_>,
    watch: &dyn BuildObserver,
) -> Result<(Cells, CellCounts), CellsError> {
    all.check(surfaces)?;
    let meetings = meetings(surfaces, all)?;
    let bytes = all.tetrahedra.len() as u64 * BYTES_A_TETRAHEDRON
        + meetings.inside.len() as u64 * BYTES_A_MEETING;
    watch.needs(bytes).map_err(CellsError::Memory)?;
    let mut numbers = PlaneNumbers::new(surfaces, all, &meetings);
    let table = std::mem::take(&mut numbers.table);
    let work = CellBuild {
        surfaces,
        all,
        meetings: &meetings,
        numbers: &numbers,
        watch,
    };
    let world = SharedGeometry::new(all.points, &table.planes);
    let mut counts = CellCounts {
        whole: distinct(&meetings.whole),
        ..CellCounts::default()
    };
    counts.meetings = meetings.inside.len() as u64;
    let cuts = work.cut(&world, &mut counts.decisions);
    counts.cut = cuts.iter().filter(|(_, c)| !c.cuts.is_empty()).count() as u32;
    let first_cells = first_cells(all, &cuts)?;
    let mut cells = Cells::default();
    work.gather(
        &world,
        &cuts,
        &first_cells,
        &mut cells,
        &mut counts.decisions,
    )?;
    drop(cuts);
    cells.points = all.points.to_vec();
    cells.planes = table.planes;
    work.raw_planes(&mut cells);
    let repeat_per_cell = |t: usize| (first_cells[t]..first_cells[t + 1]).map(move |_| t as u32);
    cells.finish((0..all.tetrahedra.len()).flat_map(repeat_per_cell));
    Ok((cells, counts))
}

fn distinct(whole: &[(u32, u32)]) -> u32 {
    let mut ids: Vec<u32> = whole.iter().map(|(_, id)| *id).collect();
    ids.sort_unstable();
    ids.dedup();
    ids.len() as u32
}

/// Returns the number of each tetrahedron's first cell, and at the end the number of all cells.
fn first_cells(all: &Tetrahedra<'_>, cuts: &[(u32, Cuts)]) -> Result<Vec<u32>, CellsError> {
    let mut first = vec![1u64; all.tetrahedra.len() + 1];
    cuts.iter()
        .for_each(|(t, c)| first[*t as usize] = u64::from(c.parts()));
    let mut at = 0u64;
    for n in &mut first {
        (*n, at) = (at, at + *n);
    }
    first
        .iter()
        .map(|n| {
            u32::try_from(*n)
                .ok()
                .filter(|n| *n < 1 << 30)
                .ok_or(CellsError::TooMany("cells"))
        })
        .collect()
}

/// The global numbers of the planes that the construction compares with other planes.
struct PlaneNumbers {
    table: PlaneTable,
    /// For each triangle id, the numbers of the triangle's plane and of the planes through its edges.
    triangles: FxHashMap<u32, [u32; 4]>,
    /// For each number of a tetrahedron's face, the number of the face's plane.
    faces: FxHashMap<u32, u32>,
}

impl PlaneNumbers {
    fn new(surfaces: &Surfaces, all: &Tetrahedra<'_>, meetings: &Meetings) -> Self {
        let mut ids: Vec<u32> = meetings.inside.iter().map(|(_, id)| *id).collect();
        ids.extend(meetings.within.iter().map(|(_, id)| *id));
        ids.par_sort_unstable();
        ids.dedup();
        let mut faces: Vec<u32> = meetings.within.iter().map(|(face, _)| *face).collect();
        let mut cut: Vec<u32> = meetings.inside.iter().map(|(t, _)| *t).collect();
        cut.dedup();
        faces.extend(
            cut.iter()
                .flat_map(|t| (0..4).map(|k| all.number_of_face(*t, k))),
        );
        // The edges of a divided face lie in the other faces of the tetrahedron with this face.
        let beside: Vec<u32> = faces
            .par_iter()
            .flat_map_iter(|f| (0..4).map(move |k| all.number_of_face(f / 4, k)))
            .collect();
        faces.extend(beside);
        faces.par_sort_unstable();
        faces.dedup();
        let points = all.points;
        let of_triangles: Vec<[(Plane, u64); 4]> = ids
            .par_iter()
            .map(|id| {
                let planes = TrianglePlanes::new(surfaces.triangles[*id as usize], points);
                let [a, b, c] = planes.edges;
                [planes.plane, a, b, c].map(|p| (p, p.name(points)))
            })
            .collect();
        let of_faces: Vec<(Plane, u64)> = faces
            .par_iter()
            .map(|f| {
                let plane = Plane(face(all.tetrahedra[(f / 4) as usize], (f % 4) as usize));
                (plane, plane.name(points))
            })
            .collect();
        let mut table = PlaneTable::default();
        let mut number = |(plane, name)| table.number(plane, name, points);
        // The planes of triangles are numbered first. So a face plane that equals a triangle's plane is
        // defined by the three points of the triangle.
        let own: Vec<u32> = of_triangles
            .iter()
            .map(|planes| number(planes[0]))
            .collect();
        let triangles = ids
            .iter()
            .zip(own.iter().zip(&of_triangles))
            .map(|(id, (own, planes))| {
                (
                    *id,
                    [
                        *own,
                        number(planes[1]),
                        number(planes[2]),
                        number(planes[3]),
                    ],
                )
            });
        let triangles = triangles.collect();
        let faces = faces
            .iter()
            .zip(of_faces)
            .map(|(f, plane)| (*f, number(plane)))
            .collect();
        Self {
            table,
            triangles,
            faces,
        }
    }
}

struct CellBuild<'a> {
    surfaces: &'a Surfaces,
    all: &'a Tetrahedra<'a>,
    meetings: &'a Meetings,
    numbers: &'a PlaneNumbers,
    watch: &'a dyn BuildObserver,
}

impl CellBuild<'_> {
    fn cutter(&self, id: u32) -> Cutter {
        let [plane, a, b, c] = self
            .numbers
            .triangles
            .get(&id)
            .copied()
            .unwrap_or([NONE; 4]);
        Cutter {
            id,
            corners: self.surfaces.triangles[id as usize],
            plane,
            edges: [a, b, c],
        }
    }

    /// Returns the corners of tetrahedron `t` and the local planes of its faces. All its faces must have
    /// numbered planes.
    fn corners(&self, local: &mut LocalGeometry<'_>, t: u32) -> Corners {
        let points = self.all.tetrahedra[t as usize];
        let faces = std::array::from_fn(|k| {
            let number = self
                .numbers
                .faces
                .get(&self.all.number_of_face(t, k))
                .copied()
                .unwrap_or(NONE);
            local.plane(number, &face(points, k))
        });
        Corners { points, faces }
    }

    /// Cuts all tetrahedra through which triangles pass. Returns the number of each such tetrahedron with its
    /// cuts.
    fn cut(&self, world: &SharedGeometry<'_>, decisions: &mut Decisions) -> Vec<(u32, Cuts)> {
        let groups: Vec<&[(u32, u32)]> = self.meetings.inside.chunk_by(|a, b| a.0 == b.0).collect();
        let done = AtomicU64::new(0);
        let cut: Vec<(u32, Cuts, Decisions)> = groups
            .par_iter()
            .map(|group| {
                let done = done.fetch_add(1, Ordering::Relaxed);
                if done.is_multiple_of(BATCH as u64) {
                    self.watch.done(BuildStage::Cut, done, groups.len() as u64);
                }
                let t = group[0].0;
                let mut local = LocalGeometry::new(world, self.all.tetrahedra[t as usize][0]);
                let corners = self.corners(&mut local, t);
                let cutters = group.iter().map(|(_, id)| self.cutter(*id));
                let cuts = Cuts::new(&mut local, corners, cutters);
                (t, cuts, local.decisions)
            })
            .collect();
        cut.iter().for_each(|(_, _, d)| *decisions += *d);
        cut.into_iter().map(|(t, cuts, _)| (t, cuts)).collect()
    }

    /// Computes the faces of all tetrahedra, and collects the faces in `cells`.
    fn gather(
        &self,
        world: &SharedGeometry<'_>,
        cuts: &[(u32, Cuts)],
        first_cells: &[u32],
        cells: &mut Cells,
        decisions: &mut Decisions,
    ) -> Result<(), CellsError> {
        let n = self.all.tetrahedra.len();
        let mut of_tetrahedron: Vec<u32> = vec![NONE; n];
        for (i, (t, c)) in (0..).zip(cuts) {
            if !c.cuts.is_empty() {
                of_tetrahedron[*t as usize] = i;
            }
        }
        let parts = |t: u32| match of_tetrahedron.get(t as usize) {
            None => TetrahedronCells {
                cuts: None,
                first_cell: NONE,
            },
            Some(i) => TetrahedronCells {
                cuts: cuts.get(*i as usize).map(|(_, c)| c),
                first_cell: first_cells[t as usize],
            },
        };
        let mut gathered = GatheredFaces {
            cells,
            numbers: HashTable::new(),
            points: self.all.points.len(),
        };
        for start in (0..n).step_by(BATCH) {
            self.watch.done(BuildStage::Faces, start as u64, n as u64);
            let batch: Vec<Vec<(u32, Faces, Decisions)>> = (start..(start + BATCH).min(n))
                .into_par_iter()
                .chunks(256)
                .map(|chunk| {
                    chunk
                        .into_iter()
                        .map(|t| self.faces(world, t as u32, &parts))
                        .collect()
                })
                .collect::<Vec<Result<Vec<_>, _>>>()
                .into_iter()
                .collect::<Result<_, CellsError>>()?;
            for (_, faces, counted) in batch.iter().flatten() {
                gathered.add(faces)?;
                *decisions += *counted;
            }
        }
        Ok(())
    }

    /// Computes the faces of cells that belong to tetrahedron `t`.
    ///
    /// These are the faces in the tetrahedron's cuts, and in each face of the tetrahedron whose number is
    /// counted from `t`, not from the neighbour.
    fn faces<'p>(
        &self,
        world: &SharedGeometry<'_>,
        t: u32,
        parts: &impl Fn(u32) -> TetrahedronCells<'p>,
    ) -> Result<(u32, Faces, Decisions), CellsError> {
        let points = self.all.tetrahedra[t as usize];
        let mut local = LocalGeometry::new(world, points[0]);
        let mut out = Faces::default();
        let own = parts(t);
        let cutter = |id: u32| self.cutter(id);
        if own.cuts.is_some() {
            let corners = self.corners(&mut local, t);
            self.know(&mut local, own);
            if !of_cuts(&mut local, corners, own, &cutter, &mut out) {
                return Err(CellsError::NotConforming {
                    tetrahedron: t,
                    what: "has a cut outside of itself",
                });
            }
        }
        for k in 0..4 {
            let number = self.all.number_of_face(t, k);
            if number != t * 4 + k as u32 {
                continue;
            }
            let other = parts(self.all.neighbours[t as usize][k]);
            let whole = range(&self.meetings.whole, number);
            let within = range(&self.meetings.within, number);
            let is_plain = own.cuts.is_none() && other.cuts.is_none() && within.is_empty();
            let corners = face(points, k);
            let plane = if is_plain {
                Plane(corners)
            } else {
                let number = self.numbers.faces.get(&number).copied().unwrap_or(NONE);
                world.planes[number as usize]
            };
            let is_front = plane.side_of(self.all.points, points[k]).is_gt();
            let sides = if is_front { [own, other] } else { [other, own] };
            if is_plain {
                out.plain(corners, sides, whole);
                continue;
            }
            if other.cuts.is_some() {
                let beyond = self.all.neighbours[t as usize][k];
                self.corners(&mut local, beyond);
                self.know(&mut local, other);
            }
            let polygon = self.face_polygon(&mut local, t, k, is_front);
            let within = within.iter().map(|(_, id)| self.cutter(*id));
            of_face(&mut local, polygon, sides, whole, within, &mut out);
        }
        Ok((t, out, local.decisions))
    }

    /// Records in the local planes the points of the triangles in a tetrahedron's cuts.
    fn know(&self, local: &mut LocalGeometry<'_>, parts: TetrahedronCells<'_>) {
        for (_, id) in parts.cuts.iter().flat_map(|c| &c.triangles) {
            let cutter = self.cutter(*id);
            cutter.polygon(local);
        }
    }

    /// Returns the face opposite corner `k` of tetrahedron `t`, counter-clockwise as seen from in front of
    /// the face's plane. `is_front` is true if corner `k` is in front of the plane.
    fn face_polygon(
        &self,
        local: &mut LocalGeometry<'_>,
        t: u32,
        k: usize,
        is_front: bool,
    ) -> Polygon {
        let points = self.all.tetrahedra[t as usize];
        let corners = face(points, k);
        let number = |k: usize| {
            let number = self.all.number_of_face(t, k);
            self.numbers.faces.get(&number).copied()
        };
        let plane = local.plane(number(k).unwrap_or(NONE), &corners);
        let mut loops: Vec<(u32, u32)> = Vec::with_capacity(3);
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            let apart = (0..4)
                .find(|j| *j != k && points[*j] != a && points[*j] != b)
                .unwrap_or(k);
            let edge = number(apart).map(|n| local.plane(n, &face(points, apart)));
            loops.push((local.point(a), edge.unwrap_or(NONE)));
        }
        // `is_left` is true if the corners turn counter-clockwise as seen from corner `k`.
        let is_left = Plane(corners).side_of(self.all.points, points[k]).is_gt();
        if is_left != is_front {
            reverse(&mut loops);
        }
        Polygon { plane, loops }
    }

    /// Adds the planes of faces without a plane number, which no decision compared with other planes.
    fn raw_planes(&self, cells: &mut Cells) {
        for i in 0..cells.faces.len() {
            if cells.faces[i].plane == NONE {
                let start = cells.faces[i].loop_start as usize;
                cells.faces[i].plane = cells.planes.len() as u32;
                cells
                    .planes
                    .push(Plane(std::array::from_fn(|k| cells.loops[start + k])));
            }
        }
    }
}

/// Returns the pairs of a sorted list whose first entry is `number`.
fn range(list: &[(u32, u32)], number: u32) -> &[(u32, u32)] {
    let first = list.partition_point(|(n, _)| *n < number);
    let count = list[first..]
        .iter()
        .take_while(|(n, _)| *n == number)
        .count();
    &list[first..first + count]
}

/// The collector of the faces of all tetrahedra in one list with global vertex numbers.
struct GatheredFaces<'a> {
    cells: &'a mut Cells,
    /// The indices of the entries of `cells.meets`, hashed by the planes of these entries.
    ///
    /// Only `cells.meets` stores the planes.
    numbers: HashTable<u32>,
    /// The number of points.
    points: usize,
}

impl GatheredFaces<'_> {
    fn add(&mut self, faces: &Faces) -> Result<(), CellsError> {
        let mut vertices = Vec::with_capacity(faces.keys.len());
        for (key, rounded) in faces.keys.iter().zip(&faces.rounded) {
            if key[1] == NONE {
                vertices.push(key[0]);
                continue;
            }
            let hash = |key: &[u32; 3]| FxBuildHasher.hash_one(key);
            let Cells {
                meets,
                rounded: places,
                ..
            } = &mut *self.cells;
            let entry = self.numbers.entry(
                hash(key),
                |n| meets[*n as usize] == *key,
                |n| hash(&meets[*n as usize]),
            );
            let number = match entry {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(free) => {
                    let number = meets.len() as u32;
                    free.insert(number);
                    meets.push(*key);
                    places.push(*rounded);
                    number
                }
            };
            vertices.push(self.points as u32 + number);
        }
        let cells = &mut *self.cells;
        let (mut loop_at, mut triangle_at) = (0, 0);
        for face in &faces.faces {
            cells.faces.push(FaceRecord {
                plane: face.plane,
                loop_start: cells.loops.len() as u32,
                triangles_start: cells.triangles.len() as u32,
                cells: face.cells,
            });
            let (loop_end, triangles_end) = (face.loop_end as usize, face.triangles_end as usize);
            cells.loops.extend(
                faces.loops[loop_at..loop_end]
                    .iter()
                    .map(|v| vertices[*v as usize]),
            );
            cells
                .triangles
                .extend(&faces.triangles[triangle_at..triangles_end]);
            (loop_at, triangle_at) = (loop_end, triangles_end);
        }
        // Every count fits before the faces of the next tetrahedron are added.
        let most = cells
            .loops
            .len()
            .max(cells.triangles.len())
            .max(cells.faces.len() * 2);
        if most.max(self.points + cells.meets.len()) > (u32::MAX / 2) as usize {
            return Err(CellsError::TooMany("faces or vertices"));
        }
        Ok(())
    }
}
