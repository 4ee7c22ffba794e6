//! The openness of many receivers, in blocks.

use rayon::prelude::*;

use crate::blockers::Blockers;
use crate::items::Items;
use crate::partition::Partition;
use crate::query::{Openness, Scratch, open};
use crate::receivers::{Receiver, Source, blocks};

/// How a solution is found. No choice changes an answer by more than its bound.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Distance beyond which nothing hides, in units of the scene; may be infinite.
    pub distance: f64,
    /// Most receivers of a block.
    pub block: usize,
    /// Largest extent of a block, by the distance.
    pub extent: f64,
    /// Boxes that take a larger solid angle are opened before the first query.
    pub open_above: f64,
    /// Most bytes of a partition. One that takes more is begun anew.
    pub bytes: usize,
}

impl Options {
    /// The defaults.
    pub fn new(distance: f64) -> Self {
        let open_above = if distance.is_finite() { 0.0 } else { 0.01 };
        Self { distance, block: 64, extent: 0.5, open_above, bytes: 64 << 20 }
    }
}

/// The openness of the receivers, in their order.
pub fn solve(blockers: &Blockers, receivers: &[Receiver], options: &Options) -> Vec<Openness> {
    let size = options.distance * options.extent;
    let blocks = blocks(receivers, |t| blockers.of(t), options.block, size);
    let answers: Vec<Vec<Openness>> = blocks
        .par_iter()
        .map_init(Scratch::default, |scratch, block| {
            let receivers: Vec<Receiver> = block.iter().map(|i| receivers[*i as usize]).collect();
            solve_block(blockers, &receivers, options, scratch)
        })
        .collect();
    let mut all = vec![Openness::default(); receivers.len()];
    for (block, answers) in blocks.iter().zip(answers) {
        for (i, answer) in block.iter().zip(answers) {
            all[*i as usize] = answer;
        }
    }
    all
}

/// The openness of the receivers of one block.
pub fn solve_block(
    blockers: &Blockers,
    receivers: &[Receiver],
    options: &Options,
    scratch: &mut Scratch,
) -> Vec<Openness> {
    let source = Source::around(receivers);
    let own = receivers.first().and_then(|r| r.triangle).and_then(|t| blockers.of(t));
    let mut items = Items::new(blockers, &source, options.distance, own);
    let root = items.begin(options.open_above);
    let mut tree = Partition::new(root);
    receivers
        .iter()
        .map(|r| {
            if tree.bytes() > options.bytes {
                tree.clear();
            }
            open(&mut tree, &mut items, &source, r, options.distance, scratch)
        })
        .collect()
}
