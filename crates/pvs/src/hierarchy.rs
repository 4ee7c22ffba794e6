//! The sets of a result's tree: the choice of the sets at inner nodes, and the coded form of each set.
//!
//! A cell's set is the exclusive or of the sets along its root path (Nirenstein 2003, appendix B.1). The sets
//! at inner nodes are free: Nirenstein chooses the ids that most children see. This module chooses the sets
//! for each id such that the number of ids stored in the whole tree is minimal. This is the small parsimony
//! problem, which Fitch's rule solves on a binary tree (Fitch 1971, "Toward defining the course of
//! evolution", Systematic Zoology 20).
//!
//! On the way up, an id is *in* a node if it is in one child and in or open in the other. An id is *out* of a
//! node if it is out of one child and out or open in the other. An id is *open* if the children contradict
//! each other or are both open. On the way down, an open id follows the parent.
//!
//! Sets are stored in coded form to save memory. This applies to the sets of the cells, to the contradictions
//! of each split, which the way down needs, and to both forms of the set of every node. Subtrees are
//! independent, so with the feature `parallel` all cores work on them.

use crate::codec;
use crate::error::PvsError;
use crate::layout::Section;
use crate::runs;
use crate::tree::CellTree;

/// The sets of one kind (visible or undecided), one per cell.
#[derive(Default)]
pub struct Hierarchy {
    /// The number of cells with empty sets before the first cell with a nonempty set.
    empty: usize,
    /// The sets of the remaining cells in absolute form, in cell order.
    cells: Vec<Vec<u8>>,
    ids: u64,
}

/// A cell's set, coded in absolute form.
pub struct CodedSet {
    bytes: Vec<u8>,
    ids: usize,
}

impl CodedSet {
    /// Codes the set with these boundaries (see [`runs`]), which contains `ids` ids.
    pub fn new(set: &[u32], ids: usize) -> Self {
        let mut bytes = Vec::new();
        codec::encode(set, true, &mut bytes);
        Self { bytes, ids }
    }
}

/// The average of a subtree by Fitch's rule, as two disjoint sets given by boundaries.
#[derive(Default)]
struct Average {
    /// The ids that are in the subtree.
    within: Vec<u32>,
    /// The ids that are open in the subtree.
    open: Vec<u32>,
}

/// The coded sets of a node.
#[derive(Clone, Default)]
struct Coded {
    /// The node's set in absolute form. This form is shorter for a set that differs much from its parent's
    /// set (for example of a cell set aside).
    absolute: Vec<u8>,
    /// The node's set as the difference from its parent's set.
    relative: Vec<u8>,
    /// The ids on which the children of a split differ. The first set has the ids in the lower and not in the
    /// upper child, and the second set has the ids in the upper and not in the lower child.
    contradictions: [Vec<u8>; 2],
}

impl Hierarchy {
    /// Adds the set of the next cell.
    pub fn push(&mut self, set: CodedSet) {
        if set.ids == 0 && self.cells.is_empty() {
            self.empty += 1;
            return;
        }
        self.cells.push(set.bytes);
        self.ids += set.ids as u64;
    }

    /// Returns the sum of the numbers of ids in the sets.
    pub fn ids(&self) -> u64 {
        self.ids
    }

    /// Returns the offsets and coded sets of all nodes of `tree`. The sets of all cells must have been
    /// pushed.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if a set coded here cannot be decoded, which would be a bug in this crate.
    pub fn section(
        self,
        section: Section,
        tree: &CellTree,
        triangles: u32,
    ) -> Result<Vec<u8>, PvsError> {
        let mut nodes = vec![Coded::default(); tree.nodes().len()];
        let mut nothing = Vec::new();
        codec::encode(&[], true, &mut nothing);
        let cells = std::iter::repeat_n(nothing, self.empty).chain(self.cells);
        for (cell, coded) in cells.enumerate() {
            if let Some(leaf) = tree.leaf(cell as u32) {
                nodes[leaf as usize].absolute = coded;
            }
        }
        let work = Work {
            section,
            tree,
            triangles,
        };
        let average = work.up(0, &mut nodes)?;
        // Treat ids open at the root as out of it: either choice stores the same number of ids.
        work.down(0, &mut nodes, &[], &average.within)?;
        Ok(chosen(tree, &nodes))
    }
}

/// The passes up and down the tree. The nodes of a subtree follow its root: first the lower child's nodes,
/// then the upper child's.
struct Work<'a> {
    /// The section that errors name.
    section: Section,
    tree: &'a CellTree,
    triangles: u32,
}

impl Work<'_> {
    /// Computes the average of the subtree of `node`, whose nodes are `nodes`. Stores the contradictions of
    /// each split.
    fn up(&self, node: u32, nodes: &mut [Coded]) -> Result<Average, PvsError> {
        let Some(upper) = self.tree.upper(node) else {
            return Ok(Average {
                within: self.decoded(&nodes[0].absolute)?,
                open: Vec::new(),
            });
        };
        let (own, [below, above]) = parts(nodes, node, upper);
        let (lower, upper) = both(|| self.up(node + 1, below), || self.up(upper, above));
        let (lower, upper) = (lower?, upper?);
        let [within, open, lower_only, upper_only] = runs::sweep(
            [&lower.within, &lower.open, &upper.within, &upper.open],
            // Bits 0 and 1: ids in and ids open in the lower child. Bits 2 and 3: the same for the upper
            // child.
            |m| match m {
                0b0101 | 0b1001 | 0b0110 => 0b0001,
                0b1010 => 0b0010,
                0b0001 => 0b0110,
                0b0100 => 0b1010,
                _ => 0,
            },
        );
        for (coded, only) in own.contradictions.iter_mut().zip([lower_only, upper_only]) {
            codec::encode(&only, false, coded);
        }
        Ok(Average { within, open })
    }

    /// Codes the node's set in both forms and continues with its children. The depth of the recursion is the
    /// depth of the tree, at most [`crate::MAX_DEPTH`].
    fn down(
        &self,
        node: u32,
        nodes: &mut [Coded],
        above: &[u32],
        set: &[u32],
    ) -> Result<(), PvsError> {
        let [difference] = runs::sweep([above, set], |m| u32::from(m == 1 || m == 2));
        codec::encode(&difference, false, &mut nodes[0].relative);
        // The absolute form of a cell's set exists already.
        let Some(upper) = self.tree.upper(node) else {
            return Ok(());
        };
        codec::encode(set, true, &mut nodes[0].absolute);
        let (own, [below, beyond]) = parts(nodes, node, upper);
        let [lower_only, upper_only] = std::mem::take(&mut own.contradictions);
        let [lower_only, upper_only] = [self.decoded(&lower_only)?, self.decoded(&upper_only)?];
        // Bit 0: the node's set; bit 1: ids in the lower child only; bit 2: ids in the upper child only.
        let [in_lower, in_upper] = runs::sweep([set, &lower_only, &upper_only], |m| {
            u32::from(m & 2 != 0 || m == 1) | u32::from(m & 4 != 0 || m == 1) << 1
        });
        let (lower, upper) = both(
            || self.down(node + 1, below, set, &in_lower),
            || self.down(upper, beyond, set, &in_upper),
        );
        lower.and(upper)
    }

    fn decoded(&self, coded: &[u8]) -> Result<Vec<u32>, PvsError> {
        // A run has about a byte.
        let mut bounds = Vec::with_capacity(2 * coded.len());
        codec::decode(coded, self.triangles, |start, end| {
            bounds.extend([start, end])
        })
        .map_err(|e| self.section.malformed(e.0))?;
        Ok(bounds)
    }
}

/// Returns the results of `a` and `b`. With the feature `parallel`, they run in parallel.
fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    #[cfg(feature = "parallel")]
    return rayon::join(a, b);
    #[cfg(not(feature = "parallel"))]
    (a(), b())
}

/// Splits `nodes` into a split node and the subtrees of its lower and its upper child.
fn parts(nodes: &mut [Coded], node: u32, upper: u32) -> (&mut Coded, [&mut [Coded]; 2]) {
    let (head, upper) = nodes.split_at_mut((upper - node) as usize);
    let (own, lower) = head.split_at_mut(1);
    (&mut own[0], [lower, upper])
}

/// Returns the section with the form of each node's set that makes the section shortest.
fn chosen(tree: &CellTree, nodes: &[Coded]) -> Vec<u8> {
    // `referring` is the size of a node's subtree without the node itself, in bytes, if its children may
    // refer to the node. `standing` is the size of the subtree if no set in it refers to a node above it.
    // Children come after their parents, so the loop runs backwards.
    let mut referring = vec![0usize; nodes.len()];
    let mut standing = vec![0usize; nodes.len()];
    let children = |node: usize| {
        tree.upper(node as u32)
            .map(|upper| [node + 1, upper as usize])
    };
    for node in (0..nodes.len()).rev() {
        let own = nodes[node].absolute.len();
        (referring[node], standing[node]) = children(node).map_or((0, own), |children| {
            let refer = children.map(|c| (nodes[c].relative.len() + referring[c]).min(standing[c]));
            let refer = refer[0] + refer[1];
            (
                refer,
                (own + refer).min(children.iter().map(|&c| standing[c]).sum()),
            )
        });
    }
    let mut offsets = vec![0u64];
    let mut sets: Vec<u8> = Vec::new();
    // True for each node that has an ancestor with a stored set to refer to.
    let mut may_refer = vec![false; nodes.len()];
    for (node, coded) in nodes.iter().enumerate() {
        let refers = may_refer[node] && coded.relative.len() + referring[node] <= standing[node];
        let children = children(node);
        // An inner set that saves no bytes is omitted: it has no bytes, and no set below refers to it.
        let stands = children.is_none() || coded.absolute.len() + referring[node] <= standing[node];
        if refers {
            sets.extend(&coded.relative);
        } else if stands {
            sets.extend(&coded.absolute);
        }
        for child in children.into_iter().flatten() {
            may_refer[child] = refers || stands;
        }
        offsets.push(sets.len() as u64);
    }
    let mut bytes: Vec<u8> = offsets.iter().flat_map(|o| o.to_le_bytes()).collect();
    bytes.extend(sets);
    bytes
}

#[cfg(all(test, feature = "parallel"))]
mod tests {
    use super::*;
    use crate::tree::Node;

    #[test]
    fn bytes_do_not_depend_on_threads() {
        // Build a full tree of 64 cells along x. The sets share many ids, and some are empty.
        fn grow(nodes: &mut Vec<Node>, lo: f32, hi: f32, levels: u32) {
            if levels == 0 {
                return nodes.push(Node::Leaf);
            }
            let at = (lo + hi) * 0.5;
            nodes.push(Node::Split { axis: 0, at });
            grow(nodes, lo, at, levels - 1);
            grow(nodes, at, hi, levels - 1);
        }
        let mut nodes = Vec::new();
        grow(&mut nodes, 0.0, 64.0, 6);
        let tree = CellTree::new([[0.0; 3], [64.0, 1.0, 1.0]], nodes).unwrap();
        let section = || {
            let mut sets = Hierarchy::default();
            for cell in 0..64u32 {
                let ids: Vec<u32> = (0..5000)
                    .filter(|id| {
                        cell > 3 && (id / 7 + cell / 9) % 3 == 0 && (id * 31 + cell) % 11 != 0
                    })
                    .collect();
                sets.push(CodedSet::new(&runs::from_ids(&ids), ids.len()));
            }
            sets.section(Section::Visible, &tree, 5000).unwrap()
        };
        let pool = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
        };
        let alone = pool(1).install(section);
        assert!(alone.len() > 1000);
        assert_eq!(alone, pool(4).install(section));
    }
}
