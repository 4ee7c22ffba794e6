//! The search for walls that enclose given points, and the space that the points reach.
//!
//! The search refines the tree only where it affects the result. While a way from the points to the outside
//! exists, the search splits the leaf on the way whose best plane has the largest covered fraction. A way
//! only through leaves without detail is a leak and ends the search. If no way to the outside exists, the
//! search splits the reached leaves along planes whose triangles cover much of a leaf's section, which may
//! separate other rooms from the points. The search does not split leaves along furniture.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use glam::Vec3;

use crate::plane_choice::{RatedPlane, best_plane, split_wall};
use crate::tree::{LeafId, OUTSIDE, PortalId, Tree};

/// The limits of the search for walls.
///
/// The limits count work instead of time, so that the result is the same on every machine.
#[derive(Clone, Copy, Debug)]
pub struct EnclosureLimits {
    /// The maximum number of leaves of the tree. Default: 65,536.
    pub leaves: usize,
    /// The maximum work of the search, in addition to the tree's work before the search. Default: 2³⁰.
    ///
    /// One unit of work is the classification of a fragment or portal by a plane, or the inspection of a
    /// portal. Other operations count as multiples.
    pub work: u64,
}

impl Default for EnclosureLimits {
    fn default() -> Self {
        Self {
            leaves: 1 << 16,
            work: 1 << 30,
        }
    }
}

/// The minimum merit of a plane that may separate rooms.
///
/// A wall with a door covers a much larger fraction of the section; furniture usually covers a smaller one.
pub(crate) const WALL: f64 = 0.3;

/// The outcome of the search for walls.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Enclosure {
    /// No way leads from the points to the outside of the tree's box.
    Closed,
    /// A way leads from the points to the outside through openings: the leaves on the way, and the portals
    /// between these leaves.
    ///
    /// Among all ways through leaves without detail, this is the way whose narrowest opening is widest.
    Leak(Vec<LeafId>, Vec<PortalId>),
    /// The limits ended the search before it found walls or a leak.
    Unknown,
    /// The caller ended the search.
    Stopped,
}

/// Returns the leaves that contain the points, in ascending order. A point on a plane is in the leaves on
/// both sides of the plane.
pub fn seeds(tree: &Tree, points: &[[f32; 3]]) -> Vec<LeafId> {
    let mut leaves: Vec<LeafId> = points
        .iter()
        .flat_map(|p| tree.leaves_of(Vec3::from(*p)))
        .collect();
    leaves.sort_unstable();
    leaves.dedup();
    leaves
}

/// Refines the tree until walls enclose the points, the search finds a leak, or a limit or the caller ends
/// the search.
///
/// The function calls `tell` repeatedly with the number of leaves; `tell` returns false to stop the search.
pub fn enclose(
    tree: &mut Tree,
    points: &[[f32; 3]],
    limits: EnclosureLimits,
    tell: &mut dyn FnMut(usize) -> bool,
) -> Enclosure {
    let mut choices: Vec<Option<RatedPlane>> = Vec::new();
    let mut looked = 0u64;
    let limits = EnclosureLimits {
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
        // Leaves whose planes cover nearly as much as the best are split in the same round, because a round
        // inspects all leaves.
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
                // Every leaf with detail has a plane: the plane of its first fragment.
                return Enclosure::Unknown;
            };
            split_wall(tree, leaf, choice.plane);
        }
    }
}

/// Splits the leaves that the points reach along walls, until no plane's triangles cover much of a leaf's
/// section.
fn part_rooms(
    tree: &mut Tree,
    points: &[[f32; 3]],
    limits: EnclosureLimits,
    mut looked: u64,
    tell: &mut dyn FnMut(usize) -> bool,
) -> Enclosure {
    // For each leaf, true if no plane's triangles cover much of the leaf's section.
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
            // The result is still `Closed`; only the division into rooms stops.
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

/// Finds a way from the seeds to the outside through as few leaves with detail as possible, and adds the
/// number of inspected portals to `looked`.
fn way_out(
    tree: &Tree,
    seeds: &[LeafId],
    looked: &mut u64,
) -> Option<(Vec<LeafId>, Vec<PortalId>)> {
    let cost = |leaf: LeafId| u32::from(!tree.leaf(leaf).detail.is_empty());
    // For each reached leaf: the number of leaves with detail on the way to it, and the portal through which
    // the way entered it.
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

/// Reconstructs the way to the outside from `entered`, which returns the portal through which a leaf was
/// entered.
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

/// Finds the way from the seeds to the outside whose narrowest portal is widest.
///
/// Only ways through leaves without detail count.
fn widest_way(tree: &Tree, seeds: &[LeafId]) -> Option<(Vec<LeafId>, Vec<PortalId>)> {
    let is_clear = |leaf: LeafId| tree.leaf(leaf).detail.is_empty();
    let mut entered: Vec<Option<PortalId>> = vec![None; tree.len()];
    let mut is_done = vec![false; tree.len()];
    // The bits of widths have the order of the widths, because widths are not negative.
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

/// Returns all leaves that the points reach through portals, in ascending order.
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
