//! The scene divided along its walls, as a section of the file, for point queries at run time.
//!
//! The section contains the following fields in this order. A count precedes the elements that it counts:
//!
//! - the largest magnitude of a coordinate as f64: the rounding error of the doubles below is proportional to
//!   this size;
//! - planes: count as u32; for each plane its unit normal and level as four f64, n·x = level;
//! - nodes of the tree: count as u32; for each node its plane and its children below and above it as three
//!   u32. A child is the number of a later node, or [`LEAF`] + the number of a leaf, or [`NONE`] for space
//!   that no line can reach. Without nodes, leaf 0 is all of space;
//! - doors: count as u32; for each door the length of its name as u32, and the name in UTF-8, in ascending
//!   order;
//! - leaves: count as u32;
//! - portals: count as u32; for each portal the leaves below and above its plane, its plane, its door or
//!   [`NONE`], and the number of its corners, as five u32;
//! - the corners of all portals, each as three f64;
//! - for each leaf the number of its triangles as u32; then the ids of all leaves' triangles as u32,
//!   ascending in each leaf.

use crate::error::PvsError;
use crate::layout::Section;

/// The value of a missing child or door.
pub const NONE: u32 = u32::MAX;
/// The bit that marks a child as a leaf.
pub const LEAF: u32 = 1 << 31;
/// The maximum number of corners of a portal.
pub const MOST_CORNERS: usize = 64;

/// An opening between two leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct Portal {
    /// The indices of the leaves below and above the plane of the portal.
    pub leaves: [u32; 2],
    /// The index of the plane that contains the portal.
    pub plane: u32,
    /// The index of the door that can shut the portal, or [`NONE`].
    pub door: u32,
    /// The corners of the portal, in order.
    pub corners: Vec<[f64; 3]>,
}

/// A scene divided along its walls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Portals {
    /// The largest magnitude of a coordinate of the scene, in world units.
    pub size: f64,
    /// The unit normal and the level of each plane.
    pub planes: Vec<[f64; 4]>,
    /// For each node: the index of its plane, its lower child and its upper child, in the form that the
    /// module describes.
    pub nodes: Vec<[u32; 3]>,
    /// The names of the doors, ascending.
    pub doors: Vec<String>,
    /// The portals.
    pub portals: Vec<Portal>,
    /// For each leaf: the triangles with parts in it, ascending.
    pub leaves: Vec<Vec<u32>>,
}

impl Portals {
    /// Creates a division of all space into one leaf with all triangles.
    pub fn undivided(triangles: u32) -> Self {
        Self {
            size: 1.0,
            leaves: vec![(0..triangles).collect()],
            ..Self::default()
        }
    }

    /// Returns the bytes of the section.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let count = |out: &mut Vec<u8>, n: usize| out.extend((n as u32).to_le_bytes());
        let floats = |out: &mut Vec<u8>, numbers: &[f64]| {
            numbers.iter().for_each(|x| out.extend(x.to_le_bytes()))
        };
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

    /// Decodes the section of a scene with `triangles` triangles.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the section is not valid. The error names the fault.
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
            return Err(bad(
                "the size is not positive and finite, or the normal of a plane is not of length 1",
            ));
        }
        let nodes: Vec<[u32; 3]> = (0..r.count(12)?)
            .map(|_| r.numbers::<3>())
            .collect::<Result<Vec<_>, _>>()?;
        let mut doors = Vec::new();
        for _ in 0..r.count(4)? {
            let length = r.number()? as usize;
            let name = std::str::from_utf8(r.take(length)?)
                .map_err(|_| bad("the name of a door is not UTF-8"))?;
            doors.push(name.to_owned());
        }
        if doors.windows(2).any(|w| w[0] >= w[1]) {
            return Err(bad("the names of the doors do not ascend"));
        }
        // Each leaf has at least four bytes: the number of its triangles.
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
        // The nodes form a tree: no node or leaf is the child of two nodes.
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
            return Err(bad(
                "a node refers to a plane, node or leaf that does not exist",
            ));
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
                    "a portal has an invalid leaf, plane, door or number of corners",
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
                return Err(bad(
                    "a coordinate of a portal's corner exceeds twice the size",
                ));
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
                return Err(bad(
                    "the triangle ids of a leaf do not ascend or are too large",
                ));
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
            Err(bad("bytes follow the last leaf"))
        }
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], PvsError> {
        let cut = || Section::Portals.malformed("the section is cut short");
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

    /// Reads the count of elements that have at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, PvsError> {
        let count = self.number()? as usize;
        if count.saturating_mul(least) > self.bytes.len() {
            return Err(Section::Portals.malformed("a count exceeds the remaining bytes"));
        }
        Ok(count)
    }
}
