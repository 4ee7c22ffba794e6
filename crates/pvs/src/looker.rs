//! Point queries at run time. They return the triangles of a cell's set that are in the view and not behind
//! walls (Teller 1992, sections 5.4 and 8.4).
//!
//! Sight lines from the eye cross the portals of its leaf, then the portals of the leaves beyond. The query
//! clips every portal, in the frame of the view, to a window of tangents. The window of the remaining part is
//! the window of the leaf beyond the portal. If the query enters a leaf twice, the leaf gets the smallest
//! window that contains both. So the leaves and portals bound the work.
//!
//! The arithmetic rounds doubles, so the query enlarges all portals and windows a little: the error of a
//! corner is at most `OFF` times the scene's size. If the eye is near the plane of a portal, the eye is on
//! both sides of the plane. The query then keeps all triangles that are seen through the portal at a glancing
//! angle. These slacks only enlarge windows, so the query omits no triangle that is visible from the eye.

use crate::error::PvsError;
use crate::portals::{LEAF, MOST_CORNERS, NONE, Portals};
use crate::reader::Pvs;
use crate::runs;

/// The maximum error of a point, as a fraction of the largest magnitude of a coordinate.
const OFF: f64 = 1e-12;
/// The number of times that the window of a leaf grows before it becomes the whole view.
const GROWTHS: u8 = 6;
/// The maximum number of corners of a clipped portal.
const MOST: usize = MOST_CORNERS + 5;

/// The parameters of a view: the eye, its directions and its angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The position of the eye, in world space.
    pub eye: [f64; 3],
    /// The direction of the view, of any length.
    pub direction: [f64; 3],
    /// The upward direction, which must not be parallel to `direction`.
    pub up: [f64; 3],
    /// The full horizontal and vertical angle in degrees, less than 180 each.
    pub fov: [f64; 2],
}

/// The reason why a view is not valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewError {
    /// A coordinate of the eye is not finite.
    #[error("a coordinate of the eye is not finite; give three finite numbers")]
    Eye,
    /// A direction has no length, or both directions lie on one line.
    #[error("dir and up must be two directions that are not on one line")]
    Directions,
    /// An angle is outside the range of 0° to 180°, exclusive.
    #[error("fov must be two angles in degrees, more than 0 and less than 180")]
    Angles,
}

/// A window of tangents: minimum and maximum of x/z and of y/z.
type Window = [[f64; 2]; 2];

/// An evaluator of point queries, with its memory. Use one per thread.
pub struct Looker<'a> {
    pvs: &'a Pvs,
    portals: &'a Portals,
    /// The start of each leaf's range in `of_leaf`, which lists the indices of the leaf's portals.
    starts: Vec<u32>,
    of_leaf: Vec<u32>,
    /// For each leaf: its window, the number of times that the window has grown, and true if the leaf waits.
    windows: Vec<(Window, u8, bool)>,
    /// For each leaf, the value of `look` at the last query that entered the leaf.
    entered: Vec<u32>,
    /// The leaves that the current query has entered.
    leaves: Vec<u32>,
    /// The nodes of the tree of leaves that the current query still has to visit.
    nodes: Vec<u32>,
    waiting: Vec<u32>,
    /// The runs of consecutive triangles of all leaves, and the start of each leaf's range in them.
    runs: Vec<[u32; 2]>,
    run_starts: Vec<u32>,
    /// A sphere around each portal.
    spheres: Vec<Sphere>,
    /// The cell of the last query, the cell's set as bits, and the triangles of the entered leaves as bits.
    cell: u32,
    set: Vec<u64>,
    seen: Vec<u64>,
    visible: Vec<u32>,
    /// The corners of a portal during clipping.
    points: [Vec<[f64; 3]>; 2],
    shut: Vec<bool>,
    look: u32,
}

impl<'a> Looker<'a> {
    /// Creates an evaluator for a result, or returns `None` if the result has no portals.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the file's portals are malformed. [`PvsError::Memory`] if memory is
    /// insufficient.
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
        // The header may state any number of triangles, while the ids in leaves are stored in the file.
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

    /// Returns the names of the doors that can be shut, ascending.
    pub fn doors(&self) -> &'a [String] {
        &self.portals.doors
    }

    /// Shuts or opens a door, given as an index in [`Self::doors`]. All doors are open at first. Another
    /// index has no effect.
    pub fn shut(&mut self, door: usize, is_shut: bool) {
        if let Some(of) = self.shut.get_mut(door) {
            *of = is_shut;
        }
    }

    /// Finds the triangles that may be visible: the triangles of the cell's set in leaves that the view
    /// reaches through portals. Returns the index of the eye's cell. Returns `None` if the eye is outside the
    /// view box or outside the walls that enclose all viewpoints. Allocates nothing.
    ///
    /// # Errors
    /// [`LookError::View`] if the view is not valid. [`LookError::Pvs`] if the set of the eye's cell cannot
    /// be decoded.
    pub fn look(&mut self, view: &View) -> Result<Option<u32>, LookError> {
        let frame = Frame::new(view, self.portals.size)?;
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
            self.follow_portals(&frame, leaf);
        }
        // The walls enclose all viewpoints, and the eye is not between these walls.
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

    /// Returns the number of triangles in the set of the cell of the last query.
    pub fn of_cell(&self) -> usize {
        self.set.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Returns the ids of the triangles that the last query found, ascending.
    pub fn visible(&self) -> &[u32] {
        &self.visible
    }

    /// Enters the leaf that contains the eye. If the eye is near planes, enters the leaves on all sides of
    /// these planes.
    fn begin(&mut self, frame: &Frame) {
        if self.portals.nodes.is_empty() {
            self.enter(0, frame.whole, frame);
            return;
        }
        // Each node is followed at most once, because no node has two parents.
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
    fn follow_portals(&mut self, frame: &Frame, leaf: u32) {
        let window = self.windows[leaf as usize].0;
        let [from, to] = [0, 1].map(|k| self.starts[leaf as usize + k] as usize);
        for place in from..to {
            let number = self.of_leaf[place] as usize;
            let portal = &self.portals.portals[number];
            if portal.door != NONE && self.shut[portal.door as usize] {
                continue;
            }
            // A line from the eye leaves the leaf through the portal only if the eye is on the leaf's side of
            // the portal.
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

/// The reason why a point query fails.
#[derive(Debug, thiserror::Error)]
pub enum LookError {
    /// The view is not valid.
    #[error(transparent)]
    View(#[from] ViewError),
    /// The file is not valid.
    #[error(transparent)]
    Pvs(#[from] PvsError),
}

/// The coordinate frame of a view: x to the right, y up, z ahead.
struct Frame {
    eye: [f64; 3],
    axes: [[f64; 3]; 3],
    whole: Window,
    /// The maximum error of a point, in world units.
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
    // Scale first, so that no square overflows or underflows.
    let most = a.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let b = a.map(|x| x / most);
    let length = dot(&b, b).sqrt();
    (most > 0.0 && most.is_finite() && length.is_finite()).then(|| b.map(|x| x / length))
}

/// A sphere around a portal.
#[derive(Clone, Copy, Debug)]
struct Sphere {
    centre: [f64; 3],
    radius: f64,
}

impl Frame {
    fn new(view: &View, size: f64) -> Result<Self, ViewError> {
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

    /// Returns the height of the eye above a plane.
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

    /// Returns true if a sphere is certainly outside a window.
    fn is_outside(&self, sphere: Sphere, window: Window) -> bool {
        let at = self.flat(sphere.centre);
        (0..2).any(|axis| {
            [0, 1].iter().any(|end| {
                let tangent = window[axis][*end];
                let sign = if *end == 0 { 1.0 } else { -1.0 };
                // The gradient of the height is (1, tangent).
                let most = (sphere.radius + 4.0 * self.off) * (1.0 + tangent.abs());
                (at[axis] - tangent * at[2]) * sign < -most
            })
        })
    }

    /// Returns the window of the part of a polygon inside `window`, or `None` if the polygon is outside.
    fn clip(
        &self,
        corners: &[[f64; 3]],
        window: Window,
        [points, other]: &mut [Vec<[f64; 3]>; 2],
    ) -> Option<Window> {
        points.clear();
        points.extend(corners.iter().map(|corner| self.flat(*corner)));
        // Clip to the half-spaces x ≥ x₀z, x ≤ x₁z, y ≥ y₀z and y ≤ y₁z. Two of them imply z ≥ 0.
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
                // A convex polygon has two crossings, but a file that was tampered with may have more.
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
            // A corner this near to the eye may be in any direction.
            let near = 64.0 * self.off;
            if p[2] <= near {
                return Some(window);
            }
            for (axis, bound) in beyond.iter_mut().enumerate() {
                let tangent = p[axis] / p[2];
                // An error of `off` in the corner's position changes the tangent by at most `wide`.
                let wide = self.off * (4.0 + 4.0 * tangent.abs()) / p[2];
                *bound = [bound[0].min(tangent - wide), bound[1].max(tangent + wide)];
            }
        }
        for (axis, bound) in beyond.iter_mut().enumerate() {
            *bound = [bound[0].max(window[axis][0]), bound[1].min(window[axis][1])];
        }
        Some(beyond)
    }
}

/// Computes a sphere around some points, a little larger than needed.
fn sphere(corners: &[[f64; 3]]) -> Sphere {
    let count = corners.len() as f64;
    let centre = [0, 1, 2].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / count);
    let far = |c: &[f64; 3]| {
        let from = [c[0] - centre[0], c[1] - centre[1], c[2] - centre[2]];
        dot(&from, from).sqrt()
    };
    Sphere {
        centre,
        radius: corners.iter().map(far).fold(0.0, f64::max) * (1.0 + 1e-9),
    }
}

/// Sets the bits of a run, from its start to its exclusive end.
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
