//! Blame: the costliest objects and the reasons for their costs. For each object, blame contains the number
//! of cells that see it, the opening through which most of these cells see it, and the saving if the opening
//! were closed.
//!
//! All results are estimates. For the costliest objects and some of the cells that see them, the search draws
//! segments from points of the cell to points of the object's triangles in the set. The free segments are
//! *witnesses*. An opening is a box that the witnesses of most cells pass. Closing an opening would hide an
//! object from a cell if all witnesses of this cell and object pass the opening. The saving is the number of
//! triangles that such pairs draw, scaled from the inspected cells to all cells that see the object. An
//! object with a single witness counts as seen through the opening that this witness passes, so savings are
//! more often too large than too small.

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;
use sightline_numbers::random::SplitMix64;
use sightline_pvs::Pvs;
use sightline_scene::{Aabb, Scene};
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sight::{Passed, SightLineTracer};

use crate::ReportError;
use crate::costs::Costs;
use crate::openings::{Opening, Sights, find};

/// The maximum number of inspected objects.
const OBJECTS: usize = 48;
/// The maximum number of inspected cells per object.
const CELLS: usize = 64;
/// The number of segments tried per pair of cell and object.
const TRIED: usize = 16 * LANES;
/// The number of attempts to find a viewpoint in a cell, per segment.
const PLACES: u32 = 8;
/// The fraction of a segment, from the cell, that must be unobstructed. The rest is next to the object.
const FREE: f32 = 1.0 - 1e-3;

/// An object and its costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Blamed {
    /// The name of the object, or the position of the cluster.
    pub name: String,
    /// The number of cells that see the object.
    pub cells: u32,
    /// The number of the object's triangles that these cells draw, summed.
    pub drawn: u64,
    /// The quotient of `drawn` and the number of all triangles that all cells draw.
    pub share: f64,
    /// The number of inspected cells.
    pub looked_at: u32,
    /// The number of inspected cells with a free segment to the object.
    pub joined: u32,
    /// The index of the opening through which most of these cells see the object.
    pub through: Option<usize>,
}

/// An opening and the saving if it were closed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Closed {
    /// The box of the opening.
    pub opening: Opening,
    /// The estimated saving, as a fraction of all drawn triangles.
    pub saves: f64,
    /// The number of objects that most cells see through the opening.
    pub objects: usize,
}

/// The objects and openings that are responsible for the costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Blame {
    /// True if the objects are clusters of a scene with few objects.
    pub are_clusters: bool,
    /// The objects, the costliest first.
    pub objects: Vec<Blamed>,
    /// The openings, the one with the largest saving first.
    pub openings: Vec<Closed>,
}

/// The witnesses of an object.
struct ObjectWitnesses {
    group: usize,
    looked_at: u32,
    /// The inspected cells with their witnesses, and the number of the object's triangles that each cell
    /// draws.
    sights: Vec<(Sights, u32)>,
}

/// Searches for openings. `is_place` returns true for points where viewpoints can be. `step` has the meaning
/// of the parameter of [`SightLineTracer::trace_each`].
///
/// # Errors
/// [`ReportError`] if the result cannot be read or rays cannot be traced.
pub fn blame(
    sight: &SightLineTracer<'_>,
    pvs: &Pvs,
    scene: &Scene,
    costs: &Costs,
    seed: u64,
    step: f32,
    is_place: &(dyn Fn(Vec3) -> bool + Sync),
) -> Result<Blame, ReportError> {
    let by_group = costs.by_group();
    let mut order: Vec<usize> = (0..by_group.len()).filter(|g| by_group[*g].0 > 0).collect();
    order.sort_by_key(|g| (std::cmp::Reverse(by_group[*g].1), *g));
    order.truncate(OBJECTS);
    let seen: Vec<ObjectWitnesses> = order
        .par_iter()
        .map(|group| look(sight, pvs, scene, costs, *group, seed, step, is_place))
        .collect::<Result<_, _>>()?;
    let bounds = scene.bounds();
    let mut openings: Vec<Closed> = Vec::new();
    let mut objects = Vec::new();
    for witnesses in &seen {
        let triangles = &costs.groups[witnesses.group].triangles;
        let object = Aabb::around(
            triangles
                .iter()
                .flat_map(|t| scene.triangles()[*t as usize].v),
        );
        let sights: Vec<&Sights> = witnesses.sights.iter().map(|(sights, _)| sights).collect();
        let through = find(bounds, object, &sights).map(|opening| {
            // Treat boxes that meet as one opening, which is the first found.
            openings
                .iter()
                .position(|known| known.opening.meets(&opening))
                .unwrap_or_else(|| {
                    openings.push(Closed {
                        opening,
                        saves: 0.0,
                        objects: 0,
                    });
                    openings.len() - 1
                })
        });
        if let Some(number) = through {
            openings[number].objects += 1;
        }
        let (cells, drawn) = by_group[witnesses.group];
        objects.push(Blamed {
            name: costs.groups[witnesses.group].name.clone(),
            cells,
            drawn,
            share: drawn as f64 / costs.total.max(1) as f64,
            looked_at: witnesses.looked_at,
            joined: witnesses.sights.len() as u32,
            through,
        });
    }
    for closed in &mut openings {
        let saved: f64 = seen
            .iter()
            .map(|witnesses| saved_by(closed.opening, witnesses, by_group[witnesses.group].0))
            .sum();
        closed.saves = saved / costs.total.max(1) as f64;
    }
    // Renumber the openings by their new order.
    let mut ranks: Vec<usize> = (0..openings.len()).collect();
    ranks.sort_by(|a, b| {
        openings[*b]
            .saves
            .total_cmp(&openings[*a].saves)
            .then(a.cmp(b))
    });
    for object in &mut objects {
        object.through = object
            .through
            .and_then(|old| ranks.iter().position(|rank| *rank == old));
    }
    let openings = ranks.iter().map(|rank| openings[*rank].clone()).collect();
    Ok(Blame {
        are_clusters: costs.are_clusters,
        objects,
        openings,
    })
}

/// Returns the number of triangles of an object that would not be drawn, if `cells` cells see the object.
fn saved_by(opening: Opening, witnesses: &ObjectWitnesses, cells: u32) -> f64 {
    let is_hidden = |s: &&(Sights, u32)| {
        s.0.segments
            .iter()
            .all(|segment| opening.is_passed(*segment))
    };
    let hidden: u64 = witnesses
        .sights
        .iter()
        .filter(is_hidden)
        .map(|(_, drawn)| u64::from(*drawn))
        .sum();
    // Cells without a witness give no information, and count as cells that still see the object.
    hidden as f64 * f64::from(cells) / f64::from(witnesses.looked_at.max(1))
}

/// Samples segments from some of the cells that see an object to the object.
fn look(
    sight: &SightLineTracer<'_>,
    pvs: &Pvs,
    scene: &Scene,
    costs: &Costs,
    group: usize,
    seed: u64,
    step: f32,
    is_place: &(dyn Fn(Vec3) -> bool + Sync),
) -> Result<ObjectWitnesses, ReportError> {
    let seers: Vec<(u32, u32)> = (0u32..)
        .zip(&costs.cells)
        .filter_map(|(cell, drawn)| {
            let at = drawn
                .binary_search_by_key(&(group as u32), |(g, _)| *g)
                .ok()?;
            Some((cell, drawn[at].1))
        })
        .collect();
    let every = seers.len().div_ceil(CELLS).max(1);
    let own = &costs.groups[group].triangles;
    let (mut ids, mut sights, mut looked_at) = (Vec::new(), Vec::new(), 0);
    for (cell, drawn) in seers.into_iter().step_by(every) {
        looked_at += 1;
        pvs.visible(cell, &mut ids)?;
        ids.retain(|id| own.binary_search(id).is_ok());
        let Some([min, max]) = pvs.cell_bounds(cell).map(|b| b.map(Vec3::from)) else {
            continue;
        };
        let mut random = SplitMix64::named(&[seed, group as u64, u64::from(cell)]);
        let mut unit = || random.unit_f32();
        let mut packets: Vec<Packet> = Vec::new();
        let mut tried: Vec<[Vec3; 2]> = Vec::new();
        for _ in 0..TRIED {
            let place = (0..PLACES).find_map(|_| {
                let at = min + (max - min) * Vec3::new(unit(), unit(), unit());
                is_place(at).then_some(at)
            });
            let pick = (unit() * ids.len() as f32) as usize;
            let (Some(from), Some(id)) = (place, ids.get(pick.min(ids.len().saturating_sub(1))))
            else {
                continue;
            };
            // Choose a uniform point of the triangle (Turk 1990).
            let v = scene.triangles()[*id as usize].v;
            let (s, t) = (unit().sqrt(), unit());
            let to = v[0] * (1.0 - s) + v[1] * (s * (1.0 - t)) + v[2] * (s * t);
            if from == to {
                continue;
            }
            if tried.len().is_multiple_of(LANES) {
                packets.push(Packet::default());
            }
            if let Some(packet) = packets.last_mut() {
                packet.push(from.to_array(), (to - from).to_array());
                tried.push([from, to]);
            }
        }
        sight.trace_each(&mut packets, &mut Passed::default(), step)?;
        let is_free = |i: usize| packets[i / LANES].distance[i % LANES] >= FREE;
        let segments: Vec<[Vec3; 2]> = (0..tried.len())
            .filter(|i| is_free(*i))
            .map(|i| tried[i])
            .collect();
        if !segments.is_empty() {
            let blocked = (0..tried.len())
                .filter(|i| !is_free(*i))
                .map(|i| tried[i])
                .collect();
            sights.push((
                Sights {
                    cell: Aabb { min, max },
                    segments,
                    blocked,
                },
                drawn,
            ));
        }
    }
    Ok(ObjectWitnesses {
        group,
        looked_at,
        sights,
    })
}
