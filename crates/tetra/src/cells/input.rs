//! Any tetrahedra that fill a box face to face, and what is wrong with others.

use super::planes::NONE;
use crate::surfaces::Surfaces;

/// Tetrahedra that fill a box face to face.
#[derive(Clone, Copy, Debug)]
pub struct Tetrahedra<'a> {
    /// The points: those of the surfaces in order, then the eight corners of a box that holds them, in any
    /// order.
    pub points: &'a [[f32; 3]],
    /// The four corners of each.
    pub tetrahedra: &'a [[u32; 4]],
    /// The tetrahedron beyond the face opposite each corner; `NONE` outside of the box.
    pub neighbours: &'a [[u32; 4]],
}

/// Why cells cannot be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CellsError {
    /// The tetrahedra are not those of the surfaces.
    #[error("the tetrahedra do not belong to the surfaces: {0}; make them from the same scene")]
    Input(String),
    /// The tetrahedra do not fill the box face to face.
    #[error(
        "the tetrahedra do not fill the box face to face: {what} at tetrahedron {tetrahedron}; this is a \
         fault of the program that made them"
    )]
    NotConforming {
        /// The tetrahedron.
        tetrahedron: u32,
        /// The fault.
        what: &'static str,
    },
    /// More of something than 32 bits can number.
    #[error("the cells have more {0} than 32 bits can number; divide the scene")]
    TooMany(&'static str),
    /// There is not enough memory.
    #[error("{0}")]
    Memory(String),
}

impl Tetrahedra<'_> {
    /// Checks lengths and numbers.
    pub(crate) fn check(&self, surfaces: &Surfaces) -> Result<(), CellsError> {
        let n = surfaces.points.len();
        let wrong = |what: &str| Err(CellsError::Input(what.to_owned()));
        // Four bits of a number are used for sides and faces.
        if self.points.len() >= 1 << 28 || surfaces.triangles.len() >= 1 << 28 {
            return Err(CellsError::TooMany("points or triangles"));
        }
        if self.tetrahedra.len() >= 1 << 28 {
            return Err(CellsError::TooMany("tetrahedra"));
        }
        if self.points.len() != n + 8 || self.points[..n] != surfaces.points[..] {
            return wrong("their points are not those of the surfaces and eight corners");
        }
        if !self.points.as_flattened().iter().all(|x| x.is_finite()) {
            return wrong("a coordinate is not a finite number");
        }
        if self.neighbours.len() != self.tetrahedra.len() {
            return wrong("there are more or fewer neighbours than tetrahedra");
        }
        if surfaces.flags.len() != surfaces.triangles.len()
            || surfaces
                .triangles
                .as_flattened()
                .iter()
                .any(|p| *p as usize >= n)
        {
            return wrong("a triangle has a corner that is no point, or no flags");
        }
        for (t, (corners, neighbours)) in (0..).zip(self.tetrahedra.iter().zip(self.neighbours)) {
            let fault = |what| {
                Err(CellsError::NotConforming {
                    tetrahedron: t,
                    what,
                })
            };
            if corners.iter().any(|p| *p as usize >= self.points.len()) {
                return fault("a corner that is no point");
            }
            for (k, other) in neighbours.iter().enumerate() {
                if *other != NONE && self.across(t, k).is_none() {
                    return fault("a neighbour that does not share the face");
                }
            }
        }
        Ok(())
    }

    /// The neighbour across the face opposite corner k, and its corner opposite the face. `None` where there
    /// is none, or where it does not know the face.
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
    /// The lesser of the numbers of the face opposite corner k: tetrahedron times four, plus corner.
    pub fn number_of_face(&self, t: u32, k: usize) -> u32 {
        let own = t * 4 + k as u32;
        if self.neighbours[t as usize][k] > t {
            return own;
        }
        self.across(t, k)
            .map_or(own, |(other, j)| own.min(other * 4 + j as u32))
    }
}

/// The corners of the face opposite corner k, in the tetrahedron's order.
pub fn face(corners: [u32; 4], k: usize) -> [u32; 3] {
    let mut others = (0..4).filter(|j| *j != k);
    std::array::from_fn(|_| others.next().map_or(NONE, |j| corners[j]))
}
