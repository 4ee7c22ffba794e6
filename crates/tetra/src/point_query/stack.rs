//! A stack of pending beams with their pending entries, in a few long vectors.
//!
//! The stack pops the beam that was pushed last. So it can remove the beam's ring, entries, triangles and
//! planes from the ends of the vectors. Queries reuse these vectors.

use super::beam::{Edge, Ring};

/// A pending entry of a beam: a box or a cell to enter, or triangles to process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StackEntry {
    /// The sort key of the entry.
    ///
    /// The key of a box is a lower bound of the square of the distance of this box and of all boxes that are
    /// earlier in the list, which are processed later. The key of a cell is the square of the distance to the
    /// middle of the face through which the beam enters the cell. The key of a triangle in the search through
    /// cells is −1, so the search processes triangles first.
    pub key: f64,
    /// The content of the entry, which depends on `count`.
    ///
    /// If `count` is 0, `first` is the number of a box, or of a cell in which beams start. If `count` is
    /// [`super::space::THROUGH_FACE`], `first` is a face to cross, as `CellsView::faces_of` lists faces.
    /// Otherwise `first` is the id of a triangle in the search through cells, or the index of the first
    /// triangle in `Hierarchy::order` in the search through boxes.
    pub first: u32,
    /// The number of triangles, 0, or [`super::space::THROUGH_FACE`].
    pub count: u32,
}

/// A beam with its pending entries and its triangles.
#[derive(Debug, Default)]
pub struct Beam {
    /// The corners and sides of the beam.
    pub ring: Ring,
    /// The pending boxes, cells and triangles. The search processes the last entry first.
    pub pending: Vec<StackEntry>,
    /// The ids of the nearest triangle so far that covers the beam, and of coplanar triangles that cover the
    /// beam.
    pub caps: Vec<u32>,
    /// The ids of other triangles that may be visible in the beam.
    ///
    /// These triangles are see-through, or overlap a beam that is not cut any further.
    pub met: Vec<u32>,
    /// True if the beam is not cut any further.
    pub whole: bool,
    /// The id of a triangle that is probably visible in the beam, or [`NO_HINT`].
    pub hint: u32,
}

/// Marker for a missing hint.
pub const NO_HINT: u32 = u32::MAX;

/// A beam on the stack: the starts of its data in the vectors of [`Stack`].
#[derive(Clone, Copy)]
struct Top {
    ring: usize,
    pending: usize,
    caps: usize,
    met: usize,
    /// The number of planes that existed, and the number of cells that the beam had entered.
    made: (usize, usize),
    whole: bool,
    hint: u32,
}

/// The pending beams.
#[derive(Default)]
pub struct Stack {
    tops: Vec<Top>,
    ring: Ring,
    pending: Vec<StackEntry>,
    caps: Vec<u32>,
    met: Vec<u32>,
}

impl Stack {
    /// Pushes the part `ring` of a beam, with the caps `caps`. `whole` is true if the part is not cut any
    /// further.
    ///
    /// `made` contains the number of existing planes and the number of cells that the beam has entered.
    pub fn push(
        &mut self,
        beam: &Beam,
        ring: &[Edge],
        caps: &[u32],
        whole: bool,
        made: (usize, usize),
    ) {
        self.tops.push(Top {
            ring: self.ring.len(),
            pending: self.pending.len(),
            caps: self.caps.len(),
            met: self.met.len(),
            made,
            whole,
            hint: beam.hint,
        });
        self.ring.extend_from_slice(ring);
        self.pending.extend_from_slice(&beam.pending);
        self.caps.extend_from_slice(caps);
        self.met.extend_from_slice(&beam.met);
    }

    /// Pops the last beam into `beam`.
    ///
    /// Returns the number of planes that this beam and the remaining beams need, and the number of cells that
    /// the beam has entered. Returns `None` if the stack is empty.
    pub fn pop(&mut self, beam: &mut Beam) -> Option<(usize, usize)> {
        let top = self.tops.pop()?;
        fn take<T: Copy>(all: &mut Vec<T>, from: usize, to: &mut Vec<T>) {
            to.clear();
            to.extend_from_slice(&all[from..]);
            all.truncate(from);
        }
        take(&mut self.ring, top.ring, &mut beam.ring);
        take(&mut self.pending, top.pending, &mut beam.pending);
        take(&mut self.caps, top.caps, &mut beam.caps);
        take(&mut self.met, top.met, &mut beam.met);
        beam.whole = top.whole;
        beam.hint = top.hint;
        Some(top.made)
    }

    /// Removes all beams.
    pub fn clear(&mut self) {
        self.tops.clear();
        self.ring.clear();
        self.pending.clear();
        self.caps.clear();
        self.met.clear();
    }
}
