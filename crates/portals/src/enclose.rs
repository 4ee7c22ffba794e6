//! Whether walls enclose given points, and what space the points reach.
//!
//! The tree is refined only where it matters: while there is a way from the points to the outside, the leaf
//! on it whose best plane covers most is split. A way through leaves without detail alone is a leak, and
//! nothing is refined any further. Where the walls close, leaves that are reached are split along planes that
//! cover much of them, which may close off other rooms. Furniture stays unsplit.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use glam::Vec3;

use crate::choose::{Choice, best_plane, split_wall};
use crate::tree::{LeafId, OUTSIDE, PortalId, Tree};

/// How long the search goes on. The counts are of work, not of time, so that every machine gets the same
/// answer.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Most leaves.
    pub leaves: usize,
    /// Most work from now on: fragments and portals that are put on a side of a plane or looked at, and walls
    /// of leaves that are split.
    pub work: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            leaves: 1 << 16,
            work: 1 << 30,
        }
    }
}

/// A plane with this merit may part rooms. Of a wall with a door much more of the section is covered, of
/// furniture mostly less.
pub(crate) const WALL: f64 = 0.3;

/// How the search ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Enclosure {
    /// No way leads outside.
    Closed,
    /// A way leads outside through openings: the leaves on it, and the portals between them. Of all ways
    /// through leaves without detail it is one whose narrowest opening is the widest.
    Leak(Vec<LeafId>, Vec<PortalId>),
    /// It is not known; the limits ended the search.
    Unknown,
    /// The caller ended the search.
    Stopped,
}

/// The leaves that hold the points; of a point on planes, those on all sides of it.
pub fn seeds(tree: &Tree, points: &[[f32; 3]]) -> Vec<LeafId> {
    let mut leaves: Vec<LeafId> = points
        .iter()
        .flat_map(|p| tree.leaves_of(Vec3::from(*p)))
        .collect();
    leaves.sort_unstable();
    leaves.dedup();
    leaves
}

/// Refines the tree until the points are enclosed, or a leak is found. `tell` is called now and then with the
/// number of leaves and says whether to go on.
pub fn enclose(
    tree: &mut Tree,
    points: &[[f32; 3]],
    limits: Limits,
    tell: &mut dyn FnMut(usize) -> bool,
) -> Enclosure {
    let mut choices: Vec<Option<Choice>> = Vec::new();
    let mut looked = 0u64;
    let limits = Limits {
        work: limits.work.saturating_add(tree.work()),
        ..limits
    };
    loop {
        let Some(way) = way_out(tree, &seeds(tree, points), &mut looked) else {
            return part_rooms(tree, points, limits, looked, tell);
        };
        if !tell(tree.len()) {
            return Enclosure::Stopped;
        }
        let open: Vec<LeafId> = way
            .0
            .iter()
            .copied()
            .filter(|l| !tree.leaf(*l).detail.is_empty())
            .collect();
        if open.is_empty() {
            let (leaves, portals) = widest_way(tree, &seeds(tree, points)).unwrap_or(way);
            return Enclosure::Leak(leaves, portals);
        }
        choices.resize(tree.len(), None);
        for leaf in &open {
            let known = &mut choices[leaf.0 as usize];
            if known.is_none() {
                *known = best_plane(tree, *leaf);
            }
        }
        let merit = |leaf: &LeafId| choices[leaf.0 as usize].map_or(-1.0, |c| c.merit);
        let most = open.iter().map(merit).fold(f64::NEG_INFINITY, f64::max);
        // What covers nearly as much as the best is split in the same round: a round looks at all leaves.
        let worth: Vec<LeafId> = open
            .iter()
            .copied()
            .filter(|l| merit(l) >= most - 0.1 * most.abs())
            .collect();
        for leaf in worth {
            if tree.len() >= limits.leaves || tree.work() + looked >= limits.work {
                return Enclosure::Unknown;
            }
            let Some(choice) = choices[leaf.0 as usize].take() else {
                // Every leaf with detail has a plane: that of its first fragment.
                return Enclosure::Unknown;
            };
            split_wall(tree, leaf, choice.plane);
        }
    }
}

/// Splits the leaves that the points reach along walls, until no plane covers much of one.
fn part_rooms(
    tree: &mut Tree,
    points: &[[f32; 3]],
    limits: Limits,
    mut looked: u64,
    tell: &mut dyn FnMut(usize) -> bool,
) -> Enclosure {
    // For each leaf whether it has no such plane.
    let mut whole: Vec<bool> = Vec::new();
    loop {
        let leaves = reached(tree, points);
        looked += leaves
            .iter()
            .map(|l| tree.leaf(*l).portals.len() as u64)
            .sum::<u64>();
        whole.resize(tree.len(), false);
        let open: Vec<LeafId> = leaves
            .into_iter()
            .filter(|l| !whole[l.0 as usize] && !tree.leaf(*l).detail.is_empty())
            .collect();
        if open.is_empty() {
            return Enclosure::Closed;
        }
        for leaf in open {
            if !tell(tree.len()) {
                return Enclosure::Stopped;
            }
            // It is closed all the same; only rooms may be parted no further.
            if tree.len() >= limits.leaves || tree.work() + looked >= limits.work {
                return Enclosure::Closed;
            }
            match best_plane(tree, leaf).filter(|choice| choice.merit >= WALL) {
                Some(choice) => drop(split_wall(tree, leaf, choice.plane)),
                None => whole[leaf.0 as usize] = true,
            }
        }
    }
}

/// A way from the seeds to the outside, through as few leaves with detail as possible.
fn way_out(
    tree: &Tree,
    seeds: &[LeafId],
    looked: &mut u64,
) -> Option<(Vec<LeafId>, Vec<PortalId>)> {
    let cost = |leaf: LeafId| u32::from(!tree.leaf(leaf).detail.is_empty());
    // For each leaf reached: its cost, and the portal through which it was entered.
    let mut reached: Vec<Option<(u32, Option<PortalId>)>> = vec![None; tree.len()];
    let mut open: VecDeque<(u32, LeafId)> = VecDeque::new();
    for seed in seeds {
        reached[seed.0 as usize] = Some((cost(*seed), None));
        if cost(*seed) == 0 {
            open.push_front((0, *seed))
        } else {
            open.push_back((1, *seed))
        }
    }
    while let Some((at, leaf)) = open.pop_front() {
        if reached[leaf.0 as usize].is_some_and(|(c, _)| c < at) {
            continue;
        }
        if leaf == OUTSIDE {
            break;
        }
        for portal in &tree.leaf(leaf).portals {
            *looked += 1;
            let next = tree.portal(*portal).beyond(leaf);
            let total = at + cost(next);
            if reached[next.0 as usize].is_none_or(|(c, _)| total < c) {
                reached[next.0 as usize] = Some((total, Some(*portal)));
                if total == at {
                    open.push_front((total, next))
                } else {
                    open.push_back((total, next))
                }
            }
        }
    }
    reached[OUTSIDE.0 as usize]?;
    Some(back(tree, |leaf| {
        reached[leaf.0 as usize].and_then(|(_, portal)| portal)
    }))
}

/// The way to the outside that `entered` tells backwards: the portal through which a leaf was entered.
fn back(tree: &Tree, entered: impl Fn(LeafId) -> Option<PortalId>) -> (Vec<LeafId>, Vec<PortalId>) {
    let (mut leaves, mut portals) = (vec![OUTSIDE], Vec::new());
    let mut at = OUTSIDE;
    while let Some(portal) = entered(at) {
        at = tree.portal(portal).beyond(at);
        leaves.push(at);
        portals.push(portal);
    }
    leaves.reverse();
    portals.reverse();
    (leaves, portals)
}

/// Of the ways from the seeds to the outside through leaves without detail, one whose narrowest portal is the
/// widest.
fn widest_way(tree: &Tree, seeds: &[LeafId]) -> Option<(Vec<LeafId>, Vec<PortalId>)> {
    let is_clear = |leaf: LeafId| tree.leaf(leaf).detail.is_empty();
    let mut entered: Vec<Option<PortalId>> = vec![None; tree.len()];
    let mut is_done = vec![false; tree.len()];
    // Widths are positive, and the bits of positive doubles are in their order.
    let mut open: BinaryHeap<(u64, Reverse<LeafId>, Option<PortalId>)> = BinaryHeap::new();
    open.extend(
        seeds
            .iter()
            .filter(|l| is_clear(**l))
            .map(|l| (f64::INFINITY.to_bits(), Reverse(*l), None)),
    );
    while let Some((width, Reverse(leaf), through)) = open.pop() {
        if std::mem::replace(&mut is_done[leaf.0 as usize], true) {
            continue;
        }
        entered[leaf.0 as usize] = through;
        if leaf == OUTSIDE {
            return Some(back(tree, |leaf| entered[leaf.0 as usize]));
        }
        for portal in &tree.leaf(leaf).portals {
            let next = tree.portal(*portal).beyond(leaf);
            if is_clear(next) && !is_done[next.0 as usize] {
                let own = tree.portal(*portal).face.width().max(0.0).to_bits();
                open.push((width.min(own), Reverse(next), Some(*portal)));
            }
        }
    }
    None
}

/// All leaves that the points reach through portals, ascending.
pub fn reached(tree: &Tree, points: &[[f32; 3]]) -> Vec<LeafId> {
    let mut found = seeds(tree, points);
    let mut known = vec![false; tree.len()];
    found.iter().for_each(|l| known[l.0 as usize] = true);
    let mut next = 0;
    while next < found.len() {
        let leaf = found[next];
        next += 1;
        for portal in &tree.leaf(leaf).portals {
            let beyond = tree.portal(*portal).beyond(leaf);
            if !std::mem::replace(&mut known[beyond.0 as usize], true) {
                found.push(beyond);
            }
        }
    }
    found.sort_unstable();
    found
}
