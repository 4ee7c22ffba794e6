//! The part of space in which viewpoints can be: a tree of half-spaces whose planes contain triangles of the
//! scene.
//!
//! The index of a triangle identifies a plane exactly and in few bytes. The crate `sightline-portals`
//! computes the planes and their sides. In this module, the tree is only data of a job.

use sightline_numbers::varint;

/// The maximum size of an encoded region in bytes, well below the maximum size of a message.
pub const MOST_BYTES: usize = 1 << 20;

/// A node of a region. The nodes are in preorder: after a split come the nodes of its lower side, then the
/// nodes of its upper side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionNode {
    /// A part of space without viewpoints.
    Outside,
    /// A part of space in which viewpoints can be anywhere.
    Inside,
    /// The plane through the triangle with this id divides this part of space. The plane is n·x = k, with a
    /// positive first nonzero component of n. The lower side of the plane has n·x < k.
    Split(u32),
}

/// The part of space in which viewpoints can be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    nodes: Vec<RegionNode>,
}

/// The reason why bytes or nodes are not a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the region of viewpoints cannot be read: {0}")]
pub struct RegionError(&'static str);

impl Region {
    /// Creates a region of these nodes.
    ///
    /// # Errors
    /// [`RegionError`] if the nodes do not form a tree in canonical form with an inside, or if the encoded
    /// region is larger than [`MOST_BYTES`].
    pub fn new(nodes: Vec<RegionNode>) -> Result<Self, RegionError> {
        let region = Self { nodes };
        region.check()?;
        match region.encode().len() <= MOST_BYTES {
            true => Ok(region),
            false => Err(RegionError("the encoded region exceeds 1 MiB")),
        }
    }

    /// Returns the nodes, in preorder.
    pub fn nodes(&self) -> &[RegionNode] {
        &self.nodes
    }

    /// Returns the highest triangle id that identifies a plane, or `None` if the region has no planes.
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

    /// Encodes the nodes as bytes. Each node is one LEB128 number: 0 for outside, 1 for inside, and otherwise
    /// the triangle plus 2.
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

    /// Decodes a region.
    ///
    /// # Errors
    /// [`RegionError`] if the bytes are not a result of [`Self::encode`], or if the region has no inside.
    pub fn decode(mut bytes: &[u8]) -> Result<Self, RegionError> {
        if bytes.len() > MOST_BYTES {
            return Err(RegionError("the encoded region exceeds 1 MiB"));
        }
        let mut nodes = Vec::new();
        while !bytes.is_empty() {
            let number = varint::read_shortest(&mut bytes, varint::MOST_BYTES);
            nodes.push(
                match number.map_err(|_| RegionError("the number of a node is malformed"))? {
                    0 => RegionNode::Outside,
                    1 => RegionNode::Inside,
                    n => {
                        let triangle = u32::try_from(n - 2)
                            .map_err(|_| RegionError("the id of a triangle exceeds 32 bits"))?;
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
        // The number of nodes that must still follow.
        let mut open = 1u64;
        for node in &self.nodes {
            if open == 0 {
                return Err(RegionError("further nodes follow the end of the tree"));
            }
            match node {
                RegionNode::Split(_) => open += 1,
                RegionNode::Inside | RegionNode::Outside => open -= 1,
            }
        }
        if open != 0 {
            return Err(RegionError("the nodes end before the end of the tree"));
        }
        if !self.nodes.contains(&RegionNode::Inside) {
            return Err(RegionError("no part of space is inside the region"));
        }
        // Each region has only one encoding, because the bytes are part of a job's key.
        let is_leaf = |n: &RegionNode| !matches!(n, RegionNode::Split(_));
        let alike = |w: &[RegionNode]| !is_leaf(&w[0]) && is_leaf(&w[1]) && w[1] == w[2];
        if self.nodes.windows(3).any(alike) {
            return Err(RegionError(
                "both sides of a plane are inside, or both are outside",
            ));
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
    fn region_is_one_tree_with_inside() {
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
        fn random_bytes_are_decoded_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            if let Ok(region) = Region::decode(&bytes) {
                prop_assert_eq!(Region::decode(&region.encode()), Ok(region));
            }
        }
    }
}
