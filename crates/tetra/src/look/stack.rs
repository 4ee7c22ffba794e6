//! Beams that wait, with what they wait for, in a few long vectors.
//!
//! The last one that was pushed comes back first, so everything that was made since its push can be dropped
//! with it: its ring, its list of boxes, its triangles, and the planes of beams that are done. These
//! vectors are kept from query to query.

use super::beam::{Edge, Ring};

/// A box or a cell to go through, or triangles to meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// For boxes: the square of a distance, and no box that waits below in the list is nearer. For cells: the
    /// square of the distance to the middle of the face before it, and −1 for a triangle, which comes first.
    pub key: f64,
    /// What it is, by `count`: a box, or a cell that beams start in (0); a face as cells list them, to go
    /// through ([`super::space::THROUGH_FACE`]); a triangle, or the place of the first in the boxes' order.
    pub first: u32,
    /// Number of triangles, or one of the two values above.
    pub count: u32,
}

/// A beam and what is known of it.
#[derive(Debug, Default)]
pub struct Beam {
    /// Its corners.
    pub ring: Ring,
    /// What it has yet to go through, the next one last.
    pub pending: Vec<Entry>,
    /// The nearest triangle so far that covers all of it, and others in the same plane that do.
    pub caps: Vec<u32>,
    /// Triangles that may be seen in it besides: see-through ones, and what an uncut beam met.
    pub met: Vec<u32>,
    /// Whether it is cut no more.
    pub whole: bool,
    /// A triangle that is probably seen in it, or [`NO_HINT`].
    pub hint: u32,
}

/// No triangle.
pub const NO_HINT: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Top {
    ring: usize,
    pending: usize,
    caps: usize,
    met: usize,
    /// Number of planes, and of cells that were entered.
    made: (usize, usize),
    whole: bool,
    hint: u32,
}

/// The beams that wait.
#[derive(Default)]
pub struct Stack {
    tops: Vec<Top>,
    ring: Ring,
    pending: Vec<Entry>,
    caps: Vec<u32>,
    met: Vec<u32>,
}

impl Stack {
    /// Puts a part of a beam on the stack. `made` are the numbers of planes that exist, and of cells that the
    /// beam has entered.
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

    /// Takes the last beam; says how many planes it and the beams below it need, and how many cells it has
    /// entered.
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

    /// Forgets all beams.
    pub fn clear(&mut self) {
        self.tops.clear();
        self.ring.clear();
        self.pending.clear();
        self.caps.clear();
        self.met.clear();
    }
}
