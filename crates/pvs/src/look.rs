//! What is seen from a point at run time: the cell's set without what is out of the view or behind walls
//! (Teller 1992, sections 5.4 and 8.4).
//!
//! Sight lines from the eye cross the portals of its leaf, then those of the leaves beyond. In the frame of
//! the view every portal is clipped to a window of tangents, and the window of what is left goes on. A leaf
//! that is entered twice gets the window around both, so the work is bounded by the leaves and portals.
//!
//! Doubles are rounded, so everything is taken for a little larger: a corner may be off by `OFF` of the
//! scene's size. Near the plane of a portal the eye is on both sides of it, and nothing is given up: what is
//! seen at a glancing angle through it stays. A window only ever grows by these slacks, so no triangle that
//! is seen from the eye is left out.

use crate::error::PvsError;
use crate::portals::{LEAF, MOST_CORNERS, NONE, Portals};
use crate::reader::Pvs;
use crate::runs;

/// How far a point may be off, as a fraction of the greatest magnitude of a coordinate.
const OFF: f64 = 1e-12;
/// How often the window of a leaf grows before it is the whole view.
const GROWTHS: u8 = 6;
/// Most corners of a clipped portal.
const MOST: usize = MOST_CORNERS + 5;

/// An eye with the view it has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The eye, in world space.
    pub eye: [f64; 3],
    /// Where it looks; of any length.
    pub direction: [f64; 3],
    /// The upward direction; not along `direction`.
    pub up: [f64; 3],
    /// The full horizontal and vertical angle in degrees, less than 180 each.
    pub fov: [f64; 2],
}

/// Why a view cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewError {
    /// The eye is not finite.
    #[error("the eye is not finite; give three numbers")]
    Eye,
    /// The directions have no length, or one line.
    #[error("dir and up must be two directions that are not on one line")]
    Directions,
    /// An angle.
    #[error("fov must be two angles in degrees, more than 0 and less than 180")]
    Angles,
}

/// A window of tangents: least and greatest x/z and y/z.
type Window = [[f64; 2]; 2];

/// Looks from points, with memory for it. One for each thread.
pub struct Looker<'a> {
    pvs: &'a Pvs,
    portals: &'a Portals,
    /// Where the portals of each leaf begin in `of_leaf`, and their numbers.
    starts: Vec<u32>,
    of_leaf: Vec<u32>,
    /// For each leaf its window, how often it has grown, and whether it waits.
    windows: Vec<(Window, u8, bool)>,
    /// The look in which a leaf was last entered.
    entered: Vec<u32>,
    /// The leaves that were entered in this look.
    leaves: Vec<u32>,
    /// The nodes that are still to be followed.
    nodes: Vec<u32>,
    waiting: Vec<u32>,
    /// The runs of consecutive triangles of all leaves, and where those of each leaf begin.
    runs: Vec<[u32; 2]>,
    run_starts: Vec<u32>,
    /// A sphere around each portal: its centre and radius.
    spheres: Vec<([f64; 3], f64)>,
    /// The cell of the last look, and its set; the triangles of the leaves that were entered: a bit each.
    cell: u32,
    set: Vec<u64>,
    seen: Vec<u64>,
    visible: Vec<u32>,
    /// The corners of a portal while it is clipped.
    points: [Vec<[f64; 3]>; 2],
    shut: Vec<bool>,
    look: u32,
}

impl<'a> Looker<'a> {
    /// Prepares look-ups in a result; `None` when it has no portals.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] for a file that was tampered with, [`PvsError::Memory`].
    pub fn new(pvs: &'a Pvs) -> Result<Option<Self>, PvsError> {
        let Some(portals) = pvs.portals()? else {
            return Ok(None);
        };
        let leaves = portals.leaves.len();
        let mut starts = vec![0u32; leaves + 1];
        for portal in &portals.portals {
            portal
                .leaves
                .iter()
                .for_each(|leaf| starts[*leaf as usize + 1] += 1);
        }
        for leaf in 0..leaves {
            starts[leaf + 1] += starts[leaf];
        }
        let mut next = starts.clone();
        let mut of_leaf = vec![0; 2 * portals.portals.len()];
        for (number, portal) in (0..).zip(&portals.portals) {
            for leaf in portal.leaves {
                let place = &mut next[leaf as usize];
                of_leaf[*place as usize] = number;
                *place += 1;
            }
        }
        // The header's number of triangles may be anything, the ids in leaves are in the file.
        let words = (pvs.triangle_count() as usize).div_ceil(64);
        let zeros = || {
            let mut bits = Vec::new();
            let no_memory = |_| PvsError::Memory {
                triangles: pvs.triangle_count(),
            };
            bits.try_reserve_exact(words).map_err(no_memory)?;
            bits.resize(words, 0);
            Ok::<_, PvsError>(bits)
        };
        let most = portals
            .leaves
            .iter()
            .map(Vec::len)
            .sum::<usize>()
            .min(pvs.triangle_count() as usize);
        let (mut runs, mut run_starts) = (Vec::new(), vec![0]);
        for ids in &portals.leaves {
            runs.extend(
                runs::from_ids(ids)
                    .chunks_exact(2)
                    .map(|run| [run[0], run[1]]),
            );
            run_starts.push(runs.len() as u32);
        }
        Ok(Some(Self {
            runs,
            run_starts,
            spheres: portals
                .portals
                .iter()
                .map(|portal| sphere(&portal.corners))
                .collect(),
            points: [(); 2].map(|()| Vec::with_capacity(MOST)),
            starts,
            of_leaf,
            windows: vec![([[0.0; 2]; 2], 0, false); leaves],
            entered: vec![0; leaves],
            leaves: Vec::with_capacity(leaves),
            nodes: Vec::with_capacity(portals.nodes.len() + 1),
            waiting: Vec::with_capacity(leaves),
            cell: NONE,
            set: zeros()?,
            seen: zeros()?,
            visible: Vec::with_capacity(most),
            shut: vec![false; portals.doors.len()],
            look: 0,
            pvs,
            portals,
        }))
    }

    /// The names of the doors that can be shut, ascending.
    pub fn doors(&self) -> &'a [String] {
        &self.portals.doors
    }

    /// Shuts a door, or opens it. All are open at first.
    pub fn shut(&mut self, door: usize, is_shut: bool) {
        if let Some(of) = self.shut.get_mut(door) {
            *of = is_shut;
        }
    }

    /// Finds the triangles that may be seen: those of the cell's set in leaves that the view reaches through
    /// portals. Returns the cell; `None` for an eye outside of the view box, or of the walls that enclose all
    /// viewpoints. Allocates nothing.
    ///
    /// # Errors
    /// [`LookError`].
    pub fn look(&mut self, view: &View) -> Result<Option<u32>, LookError> {
        let frame = Frame::of(view, self.portals.size)?;
        self.visible.clear();
        let Some(cell) = self.pvs.find_cell_precisely(view.eye) else {
            return Ok(None);
        };
        if self.cell != cell {
            self.cell = NONE;
            self.pvs.visible_bits(cell, &mut self.set)?;
            self.cell = cell;
        }
        if self.look == u32::MAX {
            self.entered.fill(0);
            self.look = 0;
        }
        self.look += 1;
        self.leaves.clear();
        self.waiting.clear();
        self.begin(&frame);
        while let Some(leaf) = self.waiting.pop() {
            self.windows[leaf as usize].2 = false;
            self.go_on(&frame, leaf);
        }
        // Between walls that enclose all viewpoints, and not there.
        if self.leaves.is_empty() {
            return Ok(None);
        }
        self.seen.fill(0);
        for leaf in &self.leaves {
            let [from, to] = [0, 1].map(|k| self.run_starts[*leaf as usize + k] as usize);
            self.runs[from..to]
                .iter()
                .for_each(|run| set_bits(&mut self.seen, *run));
        }
        for (k, (set, seen)) in self.set.iter().zip(&self.seen).enumerate() {
            let mut left = set & seen;
            while left != 0 {
                self.visible.push(k as u32 * 64 + left.trailing_zeros());
                left &= left - 1;
            }
        }
        Ok(Some(cell))
    }

    /// The number of triangles in the cell's set of the last look.
    pub fn of_cell(&self) -> usize {
        self.set.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// The triangles that the last look found, ascending.
    pub fn visible(&self) -> &[u32] {
        &self.visible
    }

    /// Enters the leaves in which the eye is: of an eye near planes, those on all sides of them.
    fn begin(&mut self, frame: &Frame) {
        if self.portals.nodes.is_empty() {
            self.enter(0, frame.whole, frame);
            return;
        }
        // Each node is followed once at most: none has two parents.
        self.nodes.clear();
        self.nodes.push(0);
        while let Some(at) = self.nodes.pop() {
            if at == NONE {
                continue;
            }
            if at >= LEAF {
                self.enter(at - LEAF, frame.whole, frame);
                continue;
            }
            let [plane, below, above] = self.portals.nodes[at as usize];
            let height = frame.height(&self.portals.planes[plane as usize]);
            if height >= -frame.off {
                self.nodes.push(above);
            }
            if height <= frame.off {
                self.nodes.push(below);
            }
        }
    }

    /// Enters a leaf with a window.
    fn enter(&mut self, leaf: u32, window: Window, frame: &Frame) {
        let at = leaf as usize;
        if self.entered[at] != self.look {
            self.entered[at] = self.look;
            self.leaves.push(leaf);
            self.waiting.push(leaf);
            self.windows[at] = (window, 0, true);
            return;
        }
        let (known, growths, is_waiting) = &mut self.windows[at];
        let is_inside = (0..2).all(|k| known[k][0] <= window[k][0] && window[k][1] <= known[k][1]);
        if is_inside {
            return;
        }
        *growths += 1;
        for k in 0..2 {
            known[k] = [known[k][0].min(window[k][0]), known[k][1].max(window[k][1])];
        }
        if *growths >= GROWTHS {
            *known = frame.whole;
        }
        if !std::mem::replace(is_waiting, true) {
            self.waiting.push(leaf);
        }
    }

    /// Follows the portals of a leaf.
    fn go_on(&mut self, frame: &Frame, leaf: u32) {
        let window = self.windows[leaf as usize].0;
        let [from, to] = [0, 1].map(|k| self.starts[leaf as usize + k] as usize);
        for place in from..to {
            let number = self.of_leaf[place] as usize;
            let portal = &self.portals.portals[number];
            if portal.door != NONE && self.shut[portal.door as usize] {
                continue;
            }
            // Lines from the eye cross it away from the eye.
            let is_up = portal.leaves[0] == leaf;
            let height = frame.height(&self.portals.planes[portal.plane as usize]);
            if if is_up {
                height > frame.off
            } else {
                height < -frame.off
            } {
                continue;
            }
            if frame.is_outside(self.spheres[number], window) {
                continue;
            }
            if let Some(beyond) = frame.clip(&portal.corners, window, &mut self.points) {
                self.enter(portal.leaves[usize::from(is_up)], beyond, frame);
            }
        }
    }
}

/// Why a look-up fails.
#[derive(Debug, thiserror::Error)]
pub enum LookError {
    /// The view.
    #[error(transparent)]
    View(#[from] ViewError),
    /// The file.
    #[error(transparent)]
    Pvs(#[from] PvsError),
}

/// The frame of a view: x to the right, y up, z ahead.
struct Frame {
    eye: [f64; 3],
    axes: [[f64; 3]; 3],
    whole: Window,
    /// How far points may be off.
    off: f64,
}

fn dot(a: &[f64], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    // Scaled first, so that no square overflows or vanishes.
    let most = a.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let b = a.map(|x| x / most);
    let length = dot(&b, b).sqrt();
    (most > 0.0 && most.is_finite() && length.is_finite()).then(|| b.map(|x| x / length))
}

impl Frame {
    fn of(view: &View, size: f64) -> Result<Self, ViewError> {
        if !view.eye.iter().all(|x| x.is_finite()) {
            return Err(ViewError::Eye);
        }
        let ahead = unit(view.direction).ok_or(ViewError::Directions)?;
        let up = unit(view.up).ok_or(ViewError::Directions)?;
        let right = cross(ahead, up);
        if dot(&right, right) < 1e-12 {
            return Err(ViewError::Directions);
        }
        let right = unit(right).ok_or(ViewError::Directions)?;
        let up = cross(right, ahead);
        if !view.fov.iter().all(|angle| *angle > 0.0 && *angle < 180.0) {
            return Err(ViewError::Angles);
        }
        let whole = view.fov.map(|angle| {
            let most = (angle.to_radians() / 2.0).tan() * (1.0 + 1e-9);
            [-most, most]
        });
        let most = view.eye.iter().fold(size, |m, x| m.max(x.abs()));
        Ok(Self {
            eye: view.eye,
            axes: [right, up, ahead],
            whole,
            off: OFF * most,
        })
    }

    /// The height of the eye above a plane.
    fn height(&self, plane: &[f64; 4]) -> f64 {
        dot(&plane[..3], self.eye) - plane[3]
    }

    fn flat(&self, point: [f64; 3]) -> [f64; 3] {
        let from = [
            point[0] - self.eye[0],
            point[1] - self.eye[1],
            point[2] - self.eye[2],
        ];
        self.axes.map(|axis| dot(&axis, from))
    }

    /// Whether a sphere is certainly outside of a window.
    fn is_outside(&self, (centre, radius): ([f64; 3], f64), window: Window) -> bool {
        let at = self.flat(centre);
        (0..2).any(|axis| {
            [0, 1].iter().any(|end| {
                let tangent = window[axis][*end];
                let sign = if *end == 0 { 1.0 } else { -1.0 };
                // The gradient of the height is (1, tangent).
                let most = (radius + 4.0 * self.off) * (1.0 + tangent.abs());
                (at[axis] - tangent * at[2]) * sign < -most
            })
        })
    }

    /// The window of the part of a polygon in a window; `None` when there is none.
    fn clip(
        &self,
        corners: &[[f64; 3]],
        window: Window,
        [points, other]: &mut [Vec<[f64; 3]>; 2],
    ) -> Option<Window> {
        points.clear();
        points.extend(corners.iter().map(|corner| self.flat(*corner)));
        // The half-spaces x ≥ x₀z, x ≤ x₁z, y ≥ y₀z and y ≤ y₁z; z ≥ 0 follows from two of them.
        for (axis, end) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let tangent = window[axis][end];
            let sign = if end == 0 { 1.0 } else { -1.0 };
            let slack = self.off * (2.0 + 2.0 * tangent.abs());
            let height = |p: &[f64; 3]| (p[axis] - tangent * p[2]) * sign + slack;
            other.clear();
            let mut q = points[points.len() - 1];
            let mut at_q = height(&q);
            for p in points.iter() {
                let at_p = height(p);
                if (at_p >= 0.0) != (at_q >= 0.0) {
                    let t = at_q / (at_q - at_p);
                    other.push([0, 1, 2].map(|k| q[k] + (p[k] - q[k]) * t));
                }
                if at_p >= 0.0 {
                    other.push(*p);
                }
                // A convex polygon has two crossings; a file made to deceive may have more.
                if other.len() + 2 > MOST {
                    return Some(window);
                }
                (q, at_q) = (*p, at_p);
            }
            std::mem::swap(points, other);
            if points.is_empty() {
                return None;
            }
        }
        let mut beyond = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for p in points.iter() {
            // What is this near to the eye is seen in any direction.
            let near = 64.0 * self.off;
            if p[2] <= near {
                return Some(window);
            }
            for (axis, of) in beyond.iter_mut().enumerate() {
                let tangent = p[axis] / p[2];
                // A corner that is off by a little is seen in a direction that is off by this.
                let wide = self.off * (4.0 + 4.0 * tangent.abs()) / p[2];
                *of = [of[0].min(tangent - wide), of[1].max(tangent + wide)];
            }
        }
        for (axis, of) in beyond.iter_mut().enumerate() {
            *of = [of[0].max(window[axis][0]), of[1].min(window[axis][1])];
        }
        Some(beyond)
    }
}

/// A sphere around some points, a little larger than needed.
fn sphere(corners: &[[f64; 3]]) -> ([f64; 3], f64) {
    let count = corners.len() as f64;
    let centre = [0, 1, 2].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / count);
    let far = |c: &[f64; 3]| {
        let from = [c[0] - centre[0], c[1] - centre[1], c[2] - centre[2]];
        dot(&from, from).sqrt()
    };
    (
        centre,
        corners.iter().map(far).fold(0.0, f64::max) * (1.0 + 1e-9),
    )
}

/// Sets the bits from the start of a run to before its end.
fn set_bits(bits: &mut [u64], [start, end]: [u32; 2]) {
    let (first, last) = ((start / 64) as usize, ((end - 1) / 64) as usize);
    let (low, high) = (u64::MAX << (start % 64), u64::MAX >> (63 - (end - 1) % 64));
    if first == last {
        bits[first] |= low & high;
    } else {
        bits[first] |= low;
        bits[first + 1..last].fill(u64::MAX);
        bits[last] |= high;
    }
}
