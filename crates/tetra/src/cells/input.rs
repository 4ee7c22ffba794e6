//! The input of the cell construction: tetrahedra that fill a box, and the checks of the input.

use super::planes::NONE;
use crate::surfaces::Surfaces;

/// Tetrahedra that fill a box face to face.
#[derive(Clone, Copy, Debug)]
pub struct Tetrahedra<'a> {
    /// The points of the surfaces in order, then the eight corners of a box that contains these points.
    ///
    /// The box corners can be in any order.
    pub points: &'a [[f32; 3]],
    /// The four corners of each tetrahedron, as indices into `points`.
    pub tetrahedra: &'a [[u32; 4]],
    /// For each corner of each tetrahedron, the number of the tetrahedron beyond the opposite face, or `NONE`
    /// on the border of the box.
    pub neighbours: &'a [[u32; 4]],
}

/// The reason why cells cannot be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CellsError {
    /// The tetrahedra were not built from these surfaces.
    #[error("the tetrahedra do not belong to the surfaces: {0}; build both from the same scene")]
    Input(String),
    /// The tetrahedra do not fill the box face to face.
    #[error(
        "the tetrahedra do not fill the box face to face: tetrahedron {tetrahedron} {what}; report this \
         fault of the program that built the tetrahedra"
    )]
    NotConforming {
        /// The number of the faulty tetrahedron.
        tetrahedron: u32,
        /// The description of the fault: a verb and its object.
        what: &'static str,
    },
    /// A list is too long: indices of its entries have 32 bits, and some lists reserve up to four of the
    /// bits.
    #[error("the scene needs more {0} than 32-bit indices can number; divide the scene")]
    TooMany(&'static str),
    /// The observer of the build rejected the memory use, with this message.
    #[error("{0}")]
    Memory(String),
}

impl Tetrahedra<'_> {
    /// Checks the lengths of the lists and the indices in them.
    pub(crate) fn check(&self, surfaces: &Surfaces) -> Result<(), CellsError> {
        let n = surfaces.points.len();
        let wrong = |what: &str| Err(CellsError::Input(what.to_owned()));
        // Four bits of an index are reserved for sides and faces.
        if self.points.len() >= 1 << 28 || surfaces.triangles.len() >= 1 << 28 {
            return Err(CellsError::TooMany("points or triangles"));
        }
        if self.tetrahedra.len() >= 1 << 28 {
            return Err(CellsError::TooMany("tetrahedra"));
        }
        if self.points.len() != n + 8 || self.points[..n] != surfaces.points[..] {
            return wrong(
                "the points of the tetrahedra are not the points of the surfaces and eight corners",
            );
        }
        if !self.points.as_flattened().iter().all(|x| x.is_finite()) {
            return wrong("a coordinate is not a finite number");
        }
        if self.neighbours.len() != self.tetrahedra.len() {
            return wrong("the numbers of tetrahedra and of entries with neighbours differ");
        }
        if surfaces.flags.len() != surfaces.triangles.len()
            || surfaces
                .triangles
                .as_flattened()
                .iter()
                .any(|p| *p as usize >= n)
        {
            return wrong("a triangle has a corner that does not exist, or has no flags");
        }
        for (t, (corners, neighbours)) in (0..).zip(self.tetrahedra.iter().zip(self.neighbours)) {
            let fault = |what| {
                Err(CellsError::NotConforming {
                    tetrahedron: t,
                    what,
                })
            };
            if corners.iter().any(|p| *p as usize >= self.points.len()) {
                return fault("has a corner that is not a point");
            }
            for (k, other) in neighbours.iter().enumerate() {
                if *other != NONE && self.across(t, k).is_none() {
                    return fault("has a neighbour that does not share the face");
                }
            }
        }
        Ok(())
    }

    /// Returns the neighbour of tetrahedron `t` across the face opposite corner `k`, and the index of the
    /// neighbour's corner opposite the face.
    ///
    /// Returns `None` if the tetrahedron has no such neighbour, or if the neighbour does not have this face.
    pub fn across(&self, t: u32, k: usize) -> Option<(u32, usize)> {
        let other = self.neighbours[t as usize][k];
        let own = face(self.tetrahedra[t as usize], k);
        let back = self.neighbours.get(other as usize)?;
        let corners = self.tetrahedra[other as usize];
        let is_shared = |j: &usize| {
            back[*j] == t && own.iter().all(|p| corners.contains(p)) && !own.contains(&corners[*j])
        };
        (0..4).find(is_shared).map(|j| (other, j))
    }
}

impl Tetrahedra<'_> {
    /// Returns the number of the face opposite corner `k` of tetrahedron `t`.
    ///
    /// The number is four times the number of the tetrahedron, plus the index of the corner. A face of two
    /// tetrahedra has the smaller of its two numbers.
    pub fn number_of_face(&self, t: u32, k: usize) -> u32 {
        let own = t * 4 + k as u32;
        if self.neighbours[t as usize][k] > t {
            return own;
        }
        self.across(t, k)
            .map_or(own, |(other, j)| own.min(other * 4 + j as u32))
    }
}

/// Returns the corners of the face opposite corner `k` of a tetrahedron, in the order of `corners`.
pub fn face(corners: [u32; 4], k: usize) -> [u32; 3] {
    let mut others = (0..4).filter(|j| *j != k);
    std::array::from_fn(|_| others.next().map_or(NONE, |j| corners[j]))
}
