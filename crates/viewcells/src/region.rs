//! The part of space in which viewpoints can be: a tree of half-spaces, whose planes go through triangles of
//! the scene.
//!
//! A triangle names a plane exactly and in few bytes. The planes themselves, and what lies on which side of
//! them, are the business of `sightline-portals`; here the tree is data of a job.

use sightline_numbers::varint;

/// Most bytes of an encoded region: well below the size of a message.
pub const MOST_BYTES: usize = 1 << 20;

/// A node of a region. The nodes are in preorder: a split is followed by the nodes of its lesser side, then
/// by those of its greater side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionNode {
    /// No viewpoint is here.
    Outside,
    /// Viewpoints can be anywhere here.
    Inside,
    /// The plane through a triangle divides this part of space. It is n·x = k with the first component of n
    /// that is not 0 positive; its lesser side has n·x < k.
    Split(u32),
}

/// The part of space in which viewpoints can be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    nodes: Vec<RegionNode>,
}

/// Bytes that are no region.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the region of viewpoints cannot be read: {0}")]
pub struct RegionError(&'static str);

impl Region {
    /// A region of these nodes.
    ///
    /// # Errors
    /// [`RegionError`] when they are no tree, or larger than [`MOST_BYTES`].
    pub fn new(nodes: Vec<RegionNode>) -> Result<Self, RegionError> {
        let region = Self { nodes };
        region.check()?;
        match region.encode().len() <= MOST_BYTES {
            true => Ok(region),
            false => Err(RegionError("it has too many bytes")),
        }
    }

    /// The nodes, in preorder.
    pub fn nodes(&self) -> &[RegionNode] {
        &self.nodes
    }

    /// The greatest triangle that names a plane; `None` when there is no plane.
    pub fn greatest_triangle(&self) -> Option<u32> {
        self.nodes
            .iter()
            .filter_map(|n| {
                if let RegionNode::Split(t) = n {
                    Some(*t)
                } else {
                    None
                }
            })
            .max()
    }

    /// The nodes as bytes: a LEB128 number for each, 0 outside, 1 inside, else the triangle plus 2.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for node in &self.nodes {
            varint::write(
                &mut bytes,
                match node {
                    RegionNode::Outside => 0,
                    RegionNode::Inside => 1,
                    RegionNode::Split(triangle) => u64::from(*triangle) + 2,
                },
            );
        }
        bytes
    }

    /// Reads a region.
    ///
    /// # Errors
    /// [`RegionError`] when the bytes are not those of [`Self::encode`], or of a region without an inside.
    pub fn decode(mut bytes: &[u8]) -> Result<Self, RegionError> {
        if bytes.len() > MOST_BYTES {
            return Err(RegionError("it has too many bytes"));
        }
        let mut nodes = Vec::new();
        while !bytes.is_empty() {
            let number = varint::read_shortest(&mut bytes, varint::MOST_BYTES);
            nodes.push(
                match number.map_err(|_| RegionError("a number is malformed"))? {
                    0 => RegionNode::Outside,
                    1 => RegionNode::Inside,
                    n => {
                        let triangle = u32::try_from(n - 2)
                            .map_err(|_| RegionError("a triangle is too great"))?;
                        RegionNode::Split(triangle)
                    }
                },
            );
        }
        let region = Self { nodes };
        region.check()?;
        Ok(region)
    }

    fn check(&self) -> Result<(), RegionError> {
        // Nodes that are still to come.
        let mut open = 1u64;
        for node in &self.nodes {
            if open == 0 {
                return Err(RegionError("nodes follow its end"));
            }
            match node {
                RegionNode::Split(_) => open += 1,
                RegionNode::Inside | RegionNode::Outside => open -= 1,
            }
        }
        if open != 0 {
            return Err(RegionError("it is cut short"));
        }
        if !self.nodes.contains(&RegionNode::Inside) {
            return Err(RegionError("nothing is inside"));
        }
        // One way of writing each region, because the bytes are part of a job's key.
        let is_leaf = |n: &RegionNode| !matches!(n, RegionNode::Split(_));
        let alike = |w: &[RegionNode]| !is_leaf(&w[0]) && is_leaf(&w[1]) && w[1] == w[2];
        if self.nodes.windows(3).any(alike) {
            return Err(RegionError("both sides of a plane are alike"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::RegionNode::{Inside, Outside, Split};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_region_is_one_tree_with_an_inside() {
        let whole = vec![Split(70_000), Split(1), Outside, Inside, Outside];
        let region = Region::new(whole.clone()).unwrap();
        assert_eq!(region.greatest_triangle(), Some(70_000));
        let bytes = region.encode();
        assert_eq!(Region::decode(&bytes), Ok(region));
        for cut in 0..bytes.len() {
            assert!(Region::decode(&bytes[..cut]).is_err(), "{cut} bytes");
        }
        for wrong in [
            vec![],
            vec![Outside],
            vec![Inside, Inside],
            vec![Split(3), Inside],
            vec![Split(3), Inside, Inside],
            vec![Split(3), Outside, Split(4), Inside, Inside],
        ] {
            assert!(Region::new(wrong.clone()).is_err(), "{wrong:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            if let Ok(region) = Region::decode(&bytes) {
                prop_assert_eq!(Region::decode(&region.encode()), Ok(region));
            }
        }
    }
}
