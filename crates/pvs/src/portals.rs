//! The scene divided along its walls, as a section of the file: for look-ups from a point at run time.
//!
//! The bytes of the section, in this order; counts come before what they count:
//!
//! - greatest magnitude of a coordinate as f64: the doubles below are rounded at this size;
//! - planes: count as u32; for each its unit normal and level as four f64, n·x = level;
//! - nodes of the tree: count as u32; for each its plane and its children below and above it as three u32. A
//!   child is the number of a later node, or [`LEAF`] + the number of a leaf, or [`NONE`] for space where no
//!   line can be. Without nodes, leaf 0 is all of space;
//! - doors: count as u32; for each the length of its name as u32, and the name in UTF-8, in ascending order;
//! - leaves: count as u32;
//! - portals: count as u32; for each the leaf below and above its plane, its plane, its door or [`NONE`],
//!   and the number of its corners, as five u32;
//! - the corners of all portals, each as three f64;
//! - for each leaf the number of its triangles as u32; then the ids of all leaves' triangles as u32,
//!   ascending in each leaf.

use crate::error::PvsError;
use crate::layout::Section;

/// No child, no door.
pub const NONE: u32 = u32::MAX;
/// A child that is a leaf.
pub const LEAF: u32 = 1 << 31;
/// Most corners of a portal.
pub const MOST_CORNERS: usize = 64;

/// An opening between two leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct Portal {
    /// The leaves below and above its plane.
    pub leaves: [u32; 2],
    /// Its plane.
    pub plane: u32,
    /// The door that can shut it, or [`NONE`].
    pub door: u32,
    /// Its corners in order.
    pub corners: Vec<[f64; 3]>,
}

/// A scene divided along its walls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Portals {
    /// The greatest magnitude of a coordinate.
    pub size: f64,
    /// Unit normals with levels.
    pub planes: Vec<[f64; 4]>,
    /// For each node its plane and its children.
    pub nodes: Vec<[u32; 3]>,
    /// The names of the doors, ascending.
    pub doors: Vec<String>,
    /// The portals.
    pub portals: Vec<Portal>,
    /// For each leaf the triangles of which parts are in it, ascending.
    pub leaves: Vec<Vec<u32>>,
}

impl Portals {
    /// All of space as one leaf with all triangles.
    pub fn undivided(triangles: u32) -> Self {
        Self {
            size: 1.0,
            leaves: vec![(0..triangles).collect()],
            ..Self::default()
        }
    }

    /// The section.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let count = |out: &mut Vec<u8>, n: usize| out.extend((n as u32).to_le_bytes());
        let floats =
            |out: &mut Vec<u8>, of: &[f64]| of.iter().for_each(|x| out.extend(x.to_le_bytes()));
        floats(&mut out, &[self.size]);
        count(&mut out, self.planes.len());
        self.planes.iter().for_each(|plane| floats(&mut out, plane));
        count(&mut out, self.nodes.len());
        self.nodes
            .iter()
            .flatten()
            .for_each(|n| out.extend(n.to_le_bytes()));
        count(&mut out, self.doors.len());
        for name in &self.doors {
            count(&mut out, name.len());
            out.extend(name.as_bytes());
        }
        count(&mut out, self.leaves.len());
        count(&mut out, self.portals.len());
        for Portal {
            leaves: [below, above],
            plane,
            door,
            corners,
        } in &self.portals
        {
            [*below, *above, *plane, *door]
                .iter()
                .for_each(|n| out.extend(n.to_le_bytes()));
            count(&mut out, corners.len());
        }
        self.portals
            .iter()
            .flat_map(|p| &p.corners)
            .for_each(|corner| floats(&mut out, corner));
        self.leaves
            .iter()
            .for_each(|ids| count(&mut out, ids.len()));
        self.leaves
            .iter()
            .flatten()
            .for_each(|id| out.extend(id.to_le_bytes()));
        out
    }

    /// Reads a section for a scene of some triangles.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] saying what is wrong.
    pub fn decode(bytes: &[u8], triangles: u32) -> Result<Self, PvsError> {
        let bad = |reason: &str| Section::Portals.malformed(reason);
        let mut r = Reader { bytes };
        let size = r.float()?;
        let is_size = size.is_finite() && size > 0.0;
        let planes = (0..r.count(32)?)
            .map(|_| r.floats::<4>())
            .collect::<Result<Vec<_>, _>>()?;
        let is_unit = |p: &[f64; 4]| {
            let length = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
            (length - 1.0).abs() < 1e-6 && p[3].is_finite()
        };
        if !is_size || !planes.iter().all(is_unit) {
            return Err(bad("its size or a plane is not finite"));
        }
        let nodes: Vec<[u32; 3]> = (0..r.count(12)?)
            .map(|_| r.numbers::<3>())
            .collect::<Result<Vec<_>, _>>()?;
        let mut doors = Vec::new();
        for _ in 0..r.count(4)? {
            let length = r.number()? as usize;
            let name = std::str::from_utf8(r.take(length)?)
                .map_err(|_| bad("a door's name is no UTF-8"))?;
            doors.push(name.to_owned());
        }
        if doors.windows(2).any(|w| w[0] >= w[1]) {
            return Err(bad("its doors are not in order"));
        }
        // Each leaf has at least the number of its triangles.
        let leaf_count = r.count(4)?;
        let is_leaf = |n: u32| (n as usize) < leaf_count;
        let is_child = |node: usize, child: u32| {
            child == NONE
                || if child >= LEAF {
                    is_leaf(child - LEAF)
                } else {
                    (node + 1..nodes.len()).contains(&(child as usize))
                }
        };
        let fits = |(at, [plane, below, above]): (usize, &[u32; 3])| {
            (*plane as usize) < planes.len() && is_child(at, *below) && is_child(at, *above)
        };
        // A tree: no node or leaf is the child of two nodes.
        let mut named = vec![false; nodes.len() + leaf_count];
        let is_new = |child: &u32| {
            let place = match *child {
                NONE => return true,
                leaf if leaf >= LEAF => nodes.len() + (leaf - LEAF) as usize,
                node => node as usize,
            };
            named
                .get_mut(place)
                .is_some_and(|named| !std::mem::replace(named, true))
        };
        if !nodes.iter().flat_map(|node| &node[1..]).all(is_new) {
            return Err(bad("a node or leaf has two parents"));
        }
        if leaf_count == 0 || leaf_count >= LEAF as usize || !nodes.iter().enumerate().all(fits) {
            return Err(bad("a node names a plane, node or leaf that there is not"));
        }
        let heads = (0..r.count(20)?)
            .map(|_| r.numbers::<5>())
            .collect::<Result<Vec<_>, _>>()?;
        let mut portals = Vec::with_capacity(heads.len());
        for [below, above, plane, door, corners] in heads {
            let is_there = is_leaf(below)
                && is_leaf(above)
                && (plane as usize) < planes.len()
                && (door == NONE || (door as usize) < doors.len())
                && (3..=MOST_CORNERS).contains(&(corners as usize));
            if !is_there {
                return Err(bad(
                    "a portal names a leaf, plane or door that there is not",
                ));
            }
            let corners = (0..corners)
                .map(|_| r.floats::<3>())
                .collect::<Result<Vec<_>, _>>()?;
            if corners
                .iter()
                .flatten()
                .any(|x| !x.is_finite() || x.abs() > 2.0 * size)
            {
                return Err(bad("a corner is outside of the scene"));
            }
            portals.push(Portal {
                leaves: [below, above],
                plane,
                door,
                corners,
            });
        }
        let counts = (0..leaf_count)
            .map(|_| r.number())
            .collect::<Result<Vec<_>, _>>()?;
        let mut leaves = Vec::with_capacity(leaf_count);
        for count in counts {
            let bytes = r.take((count as usize).saturating_mul(4))?;
            let ids: Vec<u32> = bytes
                .chunks_exact(4)
                .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect();
            if ids.windows(2).any(|w| w[0] >= w[1]) || ids.last().is_some_and(|id| *id >= triangles)
            {
                return Err(bad("the triangles of a leaf do not ascend, or reach N"));
            }
            leaves.push(ids);
        }
        if r.bytes.is_empty() {
            Ok(Self {
                size,
                planes,
                nodes,
                doors,
                portals,
                leaves,
            })
        } else {
            Err(bad("bytes follow its end"))
        }
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], PvsError> {
        let cut = || Section::Portals.malformed("it is cut short");
        let (taken, rest) = self.bytes.split_at_checked(length).ok_or_else(cut)?;
        self.bytes = rest;
        Ok(taken)
    }

    fn number(&mut self) -> Result<u32, PvsError> {
        self.numbers::<1>().map(|[n]| n)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[u32; N], PvsError> {
        let bytes = self.take(4 * N)?;
        Ok(std::array::from_fn(|k| {
            u32::from_le_bytes(std::array::from_fn(|i| bytes[4 * k + i]))
        }))
    }

    fn float(&mut self) -> Result<f64, PvsError> {
        self.floats::<1>().map(|[x]| x)
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N], PvsError> {
        let bytes = self.take(8 * N)?;
        Ok(std::array::from_fn(|k| {
            f64::from_le_bytes(std::array::from_fn(|i| bytes[8 * k + i]))
        }))
    }

    /// A count of things of at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, PvsError> {
        let count = self.number()? as usize;
        if count.saturating_mul(least) > self.bytes.len() {
            return Err(Section::Portals.malformed("a count does not fit its length"));
        }
        Ok(count)
    }
}
