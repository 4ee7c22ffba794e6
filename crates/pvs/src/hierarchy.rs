//! The sets of a result's tree: the choice of the sets at inner nodes, and the form in which each set is
//! coded.
//!
//! A cell's set is the exclusive or of the sets along its root path (Nirenstein 2003, appendix B.1). The sets
//! at inner nodes are free: Nirenstein takes the ids that most children see. Here they are chosen for each id
//! such that the number of ids stored in the whole tree is least. This is the small parsimony problem, which
//! Fitch's rule solves on a binary tree (Fitch 1971, "Toward defining the course of evolution", Systematic
//! Zoology 20). On the way up, an id is *in* a node when it is in one child and not out of the other, *out*
//! of it likewise, and *open* when the children contradict each other or are both open. On the way down, an
//! open id follows the parent.
//!
//! Sets are kept coded to save memory: the sets of the cells, the contradictions of each split, which the way
//! down needs, and the set of every node in both of its forms. Subtrees are independent, so with the feature
//! `parallel` all cores work on them.

use crate::codec;
use crate::error::PvsError;
use crate::layout::Section;
use crate::runs;
use crate::tree::CellTree;

/// The sets of one kind (visible or undecided), one for each cell.
#[derive(Default)]
pub struct Hierarchy {
    /// The number of cells with empty sets before the first other one.
    empty: usize,
    /// The sets of the other cells in absolute form, in the order of the cells.
    cells: Vec<Vec<u8>>,
    ids: u64,
}

/// A cell's set, coded in absolute form.
pub struct CodedSet {
    bytes: Vec<u8>,
    ids: usize,
}

impl CodedSet {
    /// Codes the set with these boundaries (see [`runs`]), which has `ids` ids.
    pub fn new(set: &[u32], ids: usize) -> Self {
        let mut bytes = Vec::new();
        codec::encode(set, true, &mut bytes);
        Self { bytes, ids }
    }
}

/// The average of a subtree by Fitch's rule. Sets as boundaries; the two are disjoint.
#[derive(Default)]
struct Average {
    /// Ids in the subtree.
    within: Vec<u32>,
    /// Open ids.
    open: Vec<u32>,
}

/// The coded sets of a node.
#[derive(Clone, Default)]
struct Coded {
    /// Its set in absolute form, which is shorter for a set that differs much from its parent (a cell set
    /// aside, say).
    absolute: Vec<u8>,
    /// Its set as the difference from its parent.
    relative: Vec<u8>,
    /// Of a split: the ids in its lower child and out of its upper child; the ids for which it is the
    /// reverse.
    contradictions: [Vec<u8>; 2],
}

impl Hierarchy {
    /// Adds the next cell's set.
    pub fn push(&mut self, set: CodedSet) {
        if set.ids == 0 && self.cells.is_empty() {
            self.empty += 1;
            return;
        }
        self.cells.push(set.bytes);
        self.ids += set.ids as u64;
    }

    /// Sum of the sizes of the sets.
    pub fn ids(&self) -> u64 {
        self.ids
    }

    /// Offsets and coded sets of all nodes of `tree`. The sets of all cells must have been pushed.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] when a set coded here cannot be decoded, which would be a bug in this crate.
    pub fn section(
        self,
        of: Section,
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
            of,
            tree,
            triangles,
        };
        let average = work.up(0, &mut nodes)?;
        // Ids open at the root are out of it: either choice stores the same number of ids.
        work.down(0, &mut nodes, &[], &average.within)?;
        Ok(chosen(tree, &nodes))
    }
}

/// The passes up and down the tree. The nodes of a subtree follow its root, the lower child's before the
/// upper's.
struct Work<'a> {
    /// The section that errors name.
    of: Section,
    tree: &'a CellTree,
    triangles: u32,
}

impl Work<'_> {
    /// The average of the subtree of `node`, whose nodes are `nodes`. Stores the contradictions of each
    /// split.
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
            // Bits 0 and 1: in the lower child, open there; bits 2 and 3: the same of the upper one.
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

    /// Codes the node's set in both forms and continues with its children. The recursion is as deep as the
    /// tree, at most [`crate::MAX_DEPTH`].
    fn down(
        &self,
        node: u32,
        nodes: &mut [Coded],
        above: &[u32],
        set: &[u32],
    ) -> Result<(), PvsError> {
        let [difference] = runs::sweep([above, set], |m| u32::from(m == 1 || m == 2));
        codec::encode(&difference, false, &mut nodes[0].relative);
        // A cell's absolute form exists already.
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
        let mut bounds = Vec::new();
        codec::decode(coded, self.triangles, |start, end| {
            bounds.extend([start, end])
        })
        .map_err(|e| self.of.malformed(e.0))?;
        Ok(bounds)
    }
}

/// The results of `a` and `b`; with the feature `parallel` in parallel.
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

/// The section with the form of each node's set that makes the section shortest.
fn chosen(tree: &CellTree, nodes: &[Coded]) -> Vec<u8> {
    // `referring`: bytes of a node's subtree without the node itself, when its children may refer to it.
    // `standing`: bytes of its subtree when no set in it refers to a node above it. Children come after their
    // parents, so the loop runs backwards.
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
    // For each node, whether an ancestor's set is stored that it can refer to.
    let mut may_refer = vec![false; nodes.len()];
    for (node, coded) in nodes.iter().enumerate() {
        let refers = may_refer[node] && coded.relative.len() + referring[node] <= standing[node];
        let children = children(node);
        // An inner set that saves no bytes is left out: it takes no bytes, and no set below refers to it.
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
    fn the_bytes_do_not_depend_on_threads() {
        // A full tree of 64 cells along x; the sets share many ids, and some are empty.
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
