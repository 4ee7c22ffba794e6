//! The sets of a result's tree: which to keep at its inner nodes, and how each is coded.
//!
//! A cell's set is the exclusive or of the sets along its root path (thesis appendix B.1). Which averages to keep
//! at the inner nodes is free; the thesis takes what most children see. Here they are chosen so that the number of
//! ids stored in the whole tree is least, for each id on its own: the small parsimony problem, solved on a binary
//! tree by Fitch's rule (1971, "Toward defining the course of evolution", Systematic Zoology 20). Going up, an id
//! is *in* a node when it is in one child and not out of the other, *out* likewise, and *open* when the children
//! contradict or are both open. Going down, an open id follows the node above.
//!
//! Sets are kept coded: those of the cells, what the way down needs of each split (where its children contradict), and
//! every node's in the two forms it can have. Subtrees have nothing to do with each other, so with the feature `parallel` all
//! cores work on them.

use crate::codec;
use crate::error::PvsError;
use crate::layout::Section;
use crate::runs;
use crate::tree::CellTree;

/// The sets of one kind, one a cell.
#[derive(Default)]
pub struct Hierarchy {
    /// So many cells with nothing in their sets come first.
    empty: usize,
    /// The others, coded to stand for themselves, in the order of the cells.
    cells: Vec<Vec<u8>>,
    ids: u64,
}

/// A cell's set, coded to stand for itself.
pub struct CodedSet {
    bytes: Vec<u8>,
    ids: usize,
}

impl CodedSet {
    /// The set with these boundaries (see [`runs`]), of so many ids.
    pub fn new(set: &[u32], ids: usize) -> Self {
        let mut bytes = Vec::new();
        codec::encode(set, true, &mut bytes);
        Self { bytes, ids }
    }
}

/// The average of a subtree by Fitch's rule. Sets as boundaries; the two are disjoint.
#[derive(Default)]
struct Average {
    /// In it.
    within: Vec<u32>,
    /// As well in as out.
    open: Vec<u32>,
}

/// What is kept of a node, coded.
#[derive(Clone, Default)]
struct Coded {
    /// Its set by itself, which is shorter for what resembles nothing else (a cell set aside, say).
    absolute: Vec<u8>,
    /// Its set as the difference from the node above.
    relative: Vec<u8>,
    /// Of a split: ids in its lower child and out of the upper one; the reverse.
    contradictions: [Vec<u8>; 2],
}

impl Hierarchy {
    /// Takes the next cell's set.
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

    /// Offsets and coded sets of all nodes of `tree`, of whose cells each has been pushed.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if what was coded here cannot be read, which would be a mistake of this crate.
    pub fn section(self, of: Section, tree: &CellTree, triangles: u32) -> Result<Vec<u8>, PvsError> {
        let mut nodes = vec![Coded::default(); tree.nodes().len()];
        let mut nothing = Vec::new();
        codec::encode(&[], true, &mut nothing);
        let cells = std::iter::repeat_n(nothing, self.empty).chain(self.cells);
        for (cell, coded) in cells.enumerate() {
            if let Some(leaf) = tree.leaf(cell as u32) {
                nodes[leaf as usize].absolute = coded;
            }
        }
        let work = Work { of, tree, triangles };
        let average = work.up(0, &mut nodes)?;
        // Ids open at the root are out of it: as few ids as the other way.
        work.down(0, &mut nodes, &[], &average.within)?;
        Ok(chosen(tree, &nodes))
    }
}

/// Both ways through the tree. A subtree's nodes follow its root, the lower child's before the upper one's.
struct Work<'a> {
    /// What errors are about.
    of: Section,
    tree: &'a CellTree,
    triangles: u32,
}

impl Work<'_> {
    /// The average of the subtree of `node`, whose nodes are `nodes`; keeps where children contradict.
    fn up(&self, node: u32, nodes: &mut [Coded]) -> Result<Average, PvsError> {
        let Some(upper) = self.tree.upper(node) else {
            return Ok(Average { within: self.decoded(&nodes[0].absolute)?, open: Vec::new() });
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

    /// Codes the node's set both ways and goes on with its children. Recursion is as deep as the tree, at most
    /// [`crate::MAX_DEPTH`].
    fn down(&self, node: u32, nodes: &mut [Coded], above: &[u32], set: &[u32]) -> Result<(), PvsError> {
        let [difference] = runs::sweep([above, set], |m| u32::from(m == 1 || m == 2));
        codec::encode(&difference, false, &mut nodes[0].relative);
        // A cell's is there already.
        let Some(upper) = self.tree.upper(node) else { return Ok(()) };
        codec::encode(set, true, &mut nodes[0].absolute);
        let (own, [below, beyond]) = parts(nodes, node, upper);
        let [lower_only, upper_only] = std::mem::take(&mut own.contradictions);
        let [lower_only, upper_only] = [self.decoded(&lower_only)?, self.decoded(&upper_only)?];
        // In order: the node, lower only, upper only.
        let [in_lower, in_upper] = runs::sweep([set, &lower_only, &upper_only], |m| {
            u32::from(m & 2 != 0 || m == 1) | u32::from(m & 4 != 0 || m == 1) << 1
        });
        let (lower, upper) =
            both(|| self.down(node + 1, below, set, &in_lower), || self.down(upper, beyond, set, &in_upper));
        lower.and(upper)
    }

    fn decoded(&self, coded: &[u8]) -> Result<Vec<u32>, PvsError> {
        let mut bounds = Vec::new();
        codec::decode(coded, self.triangles, |start, end| bounds.extend([start, end]))
            .map_err(|e| self.of.malformed(e.0))?;
        Ok(bounds)
    }
}

/// Does both, at the same time where that is possible.
fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    #[cfg(feature = "parallel")]
    return rayon::join(a, b);
    #[cfg(not(feature = "parallel"))]
    (a(), b())
}

/// A split, and the nodes of its lower and its upper child's subtrees.
fn parts(nodes: &mut [Coded], node: u32, upper: u32) -> (&mut Coded, [&mut [Coded]; 2]) {
    let (head, upper) = nodes.split_at_mut((upper - node) as usize);
    let (own, lower) = head.split_at_mut(1);
    (&mut own[0], [lower, upper])
}

/// The form of each node's set that makes the section least.
fn chosen(tree: &CellTree, nodes: &[Coded]) -> Vec<u8> {
    // Bytes of a node's subtree without the node when its children may refer to it; bytes of its subtree when
    // nothing refers above it. Children come after their parents, so backwards.
    let mut referring = vec![0usize; nodes.len()];
    let mut standing = vec![0usize; nodes.len()];
    let children = |node: usize| tree.upper(node as u32).map(|upper| [node + 1, upper as usize]);
    for node in (0..nodes.len()).rev() {
        let own = nodes[node].absolute.len();
        (referring[node], standing[node]) = children(node).map_or((0, own), |children| {
            let refer = children.map(|c| (nodes[c].relative.len() + referring[c]).min(standing[c]));
            let refer = refer[0] + refer[1];
            (refer, (own + refer).min(children.iter().map(|&c| standing[c]).sum()))
        });
    }
    let mut offsets = vec![0u64];
    let mut sets: Vec<u8> = Vec::new();
    // Whether there is something above to refer to, for each node.
    let mut may_refer = vec![false; nodes.len()];
    for (node, coded) in nodes.iter().enumerate() {
        let refers = may_refer[node] && coded.relative.len() + referring[node] <= standing[node];
        let children = children(node);
        // An inner set that pays for nothing is left out: no bytes, and none below refers to it.
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
    fn threads_change_no_byte() {
        // A full tree of 64 cells along x; sets that share much, and some of nothing.
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
                    .filter(|id| cell > 3 && (id / 7 + cell / 9) % 3 == 0 && (id * 31 + cell) % 11 != 0)
                    .collect();
                sets.push(CodedSet::new(&runs::from_ids(&ids), ids.len()));
            }
            sets.section(Section::Visible, &tree, 5000).unwrap()
        };
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let alone = pool(1).install(section);
        assert!(alone.len() > 1000);
        assert_eq!(alone, pool(4).install(section));
    }
}
