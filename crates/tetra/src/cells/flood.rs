//! Search for the tetrahedra through which each triangle passes, and for the faces in the triangle's plane.
//!
//! The tetrahedra that touch a triangle's relative interior are connected through faces that touch the
//! interior, because the interior is connected, and so are the tetrahedra around each of its points. So a
//! flood from the tetrahedra at one corner finds all of these tetrahedra. The tests for contact use only
//! signs of planes. The tests never miss a contact, but may report contacts that do not exist. Exact cuts
//! decide these afterwards.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::input::{CellsError, Tetrahedra, face};
use super::planes::{NONE, Plane, axis_apart};
use crate::surfaces::{FLAT, Surfaces};

/// The number of a face of a tetrahedron: four times the number of the tetrahedron, plus the index of the
/// corner opposite the face.
///
/// A face of two tetrahedra has the smaller of its two numbers.
pub type FaceNumber = u32;

/// The tetrahedra and faces that triangles touch.
#[derive(Debug, Default)]
pub struct Meetings {
    /// Pairs of a tetrahedron and a triangle that may pass through the inside of the tetrahedron, ascending.
    pub inside: Vec<(u32, u32)>,
    /// Pairs of a face and a triangle in the face's plane that may overlap the face, ascending.
    pub within: Vec<(FaceNumber, u32)>,
    /// Pairs of a face and a triangle that equals the face, ascending.
    pub whole: Vec<(FaceNumber, u32)>,
}

/// The plane of a triangle and the planes through its edges.
#[derive(Clone, Copy, Debug)]
pub struct TrianglePlanes {
    /// The plane of the triangle.
    pub plane: Plane,
    /// The planes through the edges from each corner to the next.
    pub edges: [Plane; 3],
}

impl TrianglePlanes {
    /// Computes the planes of a triangle with area, whose corners are point numbers.
    pub fn new(corners: [u32; 3], points: &[[f32; 3]]) -> Self {
        let axis = axis_apart(corners.map(|c| points[c as usize]));
        let edges = std::array::from_fn(|i| Plane::along([corners[i], corners[(i + 1) % 3]], axis));
        Self {
            plane: Plane(corners),
            edges,
        }
    }
}

/// Finds the tetrahedra and faces that the triangles with area touch.
///
/// # Errors
/// [`CellsError::NotConforming`] if no tetrahedron touches one of the triangles.
pub fn meetings(surfaces: &Surfaces, all: &Tetrahedra<'_>) -> Result<Meetings, CellsError> {
    let mut whole = whole_faces(surfaces, all);
    let mut is_whole = vec![false; surfaces.triangles.len()];
    whole
        .iter()
        .for_each(|(_, id)| is_whole[*id as usize] = true);
    whole.par_sort_unstable();
    let mut at_point = vec![NONE; all.points.len()];
    for (t, corners) in (0..).zip(all.tetrahedra) {
        corners.iter().for_each(|c| at_point[*c as usize] = t);
    }
    let ids: Vec<u32> = (0..surfaces.triangles.len() as u32)
        .filter(|id| surfaces.flags[*id as usize] & FLAT == 0 && !is_whole[*id as usize])
        .collect();
    let found: Vec<FloodResult> = ids
        .par_chunks(256)
        .map_init(
            || Flood {
                all,
                at_point: &at_point,
                seen: vec![NONE; all.tetrahedra.len()],
                known: vec![(NONE, [0; 4]); all.points.len()],
                todo: Vec::new(),
            },
            |flood, ids| {
                let mut found = FloodResult::default();
                ids.iter().try_for_each(|id| {
                    flood.flood(*id, surfaces.triangles[*id as usize], &mut found)
                })?;
                Ok(found)
            },
        )
        .collect::<Result<_, CellsError>>()?;
    let mut meetings = Meetings {
        whole,
        ..Meetings::default()
    };
    for part in found {
        meetings.inside.extend(part.inside);
        meetings.within.extend(part.within);
    }
    meetings.inside.par_sort_unstable();
    meetings.within.par_sort_unstable();
    // The flood finds an inner face from both of its tetrahedra.
    meetings.within.dedup();
    Ok(meetings)
}

/// Returns the pairs of a face and a triangle with the same corners.
fn whole_faces(surfaces: &Surfaces, all: &Tetrahedra<'_>) -> Vec<(FaceNumber, u32)> {
    let sorted = |mut corners: [u32; 3]| {
        corners.sort_unstable();
        corners
    };
    let mut first: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    let mut next = vec![NONE; surfaces.triangles.len()];
    for id in (0..surfaces.triangles.len()).rev() {
        if surfaces.flags[id] & FLAT == 0 {
            let key = sorted(surfaces.triangles[id]);
            next[id] = first.insert(key, id as u32).unwrap_or(NONE);
        }
    }
    (0..all.tetrahedra.len() as u32)
        .into_par_iter()
        .flat_map_iter(|t| {
            let (first, next) = (&first, &next);
            (0..4).flat_map(move |k| {
                let other = all.neighbours[t as usize][k];
                let is_first = other == NONE || t < other;
                let key = sorted(face(all.tetrahedra[t as usize], k));
                let mut at = first
                    .get(&key)
                    .copied()
                    .filter(|_| is_first)
                    .unwrap_or(NONE);
                std::iter::from_fn(move || {
                    let id = Some(at).filter(|id| *id != NONE)?;
                    at = next[id as usize];
                    Some((t * 4 + k as u32, id))
                })
            })
        })
        .collect()
}

#[derive(Default)]
struct FloodResult {
    inside: Vec<(u32, u32)>,
    within: Vec<(FaceNumber, u32)>,
}

struct Flood<'a> {
    all: &'a Tetrahedra<'a>,
    /// For each point, the number of a tetrahedron that has the point as a corner, or `NONE`.
    at_point: &'a [u32],
    /// For each tetrahedron, the id of the last triangle whose flood reached the tetrahedron.
    seen: Vec<u32>,
    /// For each point, the id of the last triangle for which the point's sides were computed, and these
    /// sides.
    ///
    /// Neighbouring tetrahedra share points, so this cache avoids repeated computations.
    known: Vec<(u32, Sides)>,
    todo: Vec<u32>,
}

/// The sides on which a point is: of the triangle's plane, then of the planes through the triangle's edges.
///
/// For an edge's plane, 1 is the side of the triangle and −1 the other side. 0 is on a plane.
type Sides = [i8; 4];

impl Flood<'_> {
    fn flood(
        &mut self,
        id: u32,
        corners: [u32; 3],
        found: &mut FloodResult,
    ) -> Result<(), CellsError> {
        let points = self.all.points;
        let planes = TrianglePlanes::new(corners, points);
        let inner: [i8; 3] =
            std::array::from_fn(|i| planes.edges[i].side_of(points, corners[(i + 2) % 3]) as i8);
        let sides = |p: u32| -> Sides {
            std::array::from_fn(|i| match i {
                0 => planes.plane.side_of(points, p) as i8,
                _ => planes.edges[i - 1].side_of(points, p) as i8 * inner[i - 1],
            })
        };
        self.seeds(id, corners[0], &sides);
        if self.todo.is_empty() {
            return Err(CellsError::NotConforming {
                tetrahedron: 0,
                what: "and all other tetrahedra do not touch the inside of a triangle",
            });
        }
        while let Some(t) = self.todo.pop() {
            let own = self.all.tetrahedra[t as usize];
            let signs = own.map(|p| self.sides(id, p, &sides));
            let is_met = may_touch(&signs) && self.may_touch_back(own, corners);
            if !is_met {
                continue;
            }
            if signs.iter().any(|s| s[0] > 0) && signs.iter().any(|s| s[0] < 0) {
                found.inside.push((t, id));
            }
            for k in 0..4 {
                let others: [Sides; 3] =
                    std::array::from_fn(|i| signs[if i < k { i } else { i + 1 }]);
                if !may_touch(&others) {
                    continue;
                }
                if others.iter().all(|s| s[0] == 0) {
                    found.within.push((self.all.number_of_face(t, k), id));
                }
                let next = self.all.neighbours[t as usize][k];
                if next != NONE && self.seen[next as usize] != id {
                    self.seen[next as usize] = id;
                    self.todo.push(next);
                }
            }
        }
        Ok(())
    }

    /// Fills `todo` with the tetrahedra at a corner of the triangle that may touch the triangle, or with all
    /// tetrahedra if no tetrahedron has the corner.
    fn seeds(&mut self, id: u32, corner: u32, sides: &impl Fn(u32) -> Sides) {
        self.todo.clear();
        let start = self.at_point[corner as usize];
        if start == NONE {
            self.todo.extend(0..self.all.tetrahedra.len() as u32);
            self.seen.fill(id);
            return;
        }
        // The walk visits all tetrahedra at the corner, through the faces that contain the corner.
        let mut star = vec![start];
        self.seen[start as usize] = id;
        let mut at = 0;
        while let Some(t) = star.get(at).copied() {
            at += 1;
            let own = self.all.tetrahedra[t as usize];
            for k in (0..4).filter(|k| own[*k] != corner) {
                let next = self.all.neighbours[t as usize][k];
                if next != NONE && self.seen[next as usize] != id {
                    self.seen[next as usize] = id;
                    star.push(next);
                }
            }
        }
        // A tetrahedron that cannot touch the triangle remains marked as seen.
        for t in star {
            if may_touch(&self.all.tetrahedra[t as usize].map(|p| self.sides(id, p, sides))) {
                self.todo.push(t);
            }
        }
    }

    fn sides(&mut self, id: u32, point: u32, sides: &impl Fn(u32) -> Sides) -> Sides {
        let known = &mut self.known[point as usize];
        if known.0 != id {
            *known = (id, sides(point));
        }
        known.1
    }

    /// Returns true if no face of a tetrahedron separates the triangle from the tetrahedron.
    fn may_touch_back(&self, own: [u32; 4], corners: [u32; 3]) -> bool {
        let points = self.all.points;
        (0..4).all(|k| {
            if corners.iter().any(|c| own.contains(c) && *c != own[k]) {
                // A corner of the triangle is on the face.
                return true;
            }
            let plane = Plane(face(own, k));
            let inner = plane.side_of(points, own[k]);
            corners
                .iter()
                .any(|c| plane.side_of(points, *c) != inner.reverse())
        })
    }
}

/// Returns true if the convex hull of points with these sides may touch the triangle's relative interior.
fn may_touch(signs: &[Sides]) -> bool {
    let has = |i: usize, sign: i8| signs.iter().any(|s| s[i] == sign);
    let crosses = has(0, 0) || (has(0, 1) && has(0, -1));
    crosses && (1..4).all(|i| has(i, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meetings_list_all_triangles_equal_to_face() {
        let points = [
            [0.0f32; 3],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
        ];
        let all = Tetrahedra {
            points: &points,
            tetrahedra: &[[0, 1, 2, 3]],
            neighbours: &[[NONE; 4]],
        };
        let surfaces = Surfaces {
            points: points.to_vec(),
            triangles: vec![[0, 2, 1], [1, 2, 0], [1, 2, 3], [0, 0, 1]],
            flags: vec![0, 0, 0, FLAT],
        };
        assert_eq!(whole_faces(&surfaces, &all).len(), 3);
        let found = meetings(&surfaces, &all).unwrap();
        assert_eq!(found.whole, [(0, 2), (3, 0), (3, 1)]);
        assert!(found.inside.is_empty() && found.within.is_empty());
    }
}
