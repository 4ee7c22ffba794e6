//! Blame: the objects that cost most, from how many cells each is seen, through which opening, and what
//! closing that would save.
//!
//! All this is an estimate. For the costliest objects and some of the cells that see them, segments are drawn
//! from points of the cell to points of the object's triangles in the set, and those that are free are
//! *witnesses*. An opening is a box that the witnesses of most cells pass. Closing it would hide an object
//! from a cell if all witnesses of the two pass it; what such pairs draw, scaled from the cells that were
//! looked at to all that see the object, is the saving. Small parts that few segments hit count as seen
//! through the opening when their one witness does, so savings are rather too large than too small.

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

/// Objects that are looked at.
const OBJECTS: usize = 48;
/// Cells that are looked at of each object.
const CELLS: usize = 64;
/// Segments that are tried of each pair.
const TRIED: usize = 16 * LANES;
/// Attempts to find a viewpoint in a cell.
const PLACES: u32 = 8;
/// A segment that comes so close to its end, as a fraction, has met nothing else.
const FREE: f32 = 1.0 - 1e-3;

/// An object and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Blamed {
    /// Its name, or where the cluster is.
    pub name: String,
    /// Cells that see it.
    pub cells: u32,
    /// Triangles of it that these draw, summed.
    pub drawn: u64,
    /// The fraction of all that is drawn.
    pub share: f64,
    /// Cells that were looked at.
    pub looked_at: u32,
    /// Those of them from which a free segment was found.
    pub joined: u32,
    /// The number of the opening that most of them see it through.
    pub through: Option<usize>,
}

/// An opening and what closing it would save.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Closed {
    /// The box.
    pub opening: Opening,
    /// The estimated fraction of all that is drawn.
    pub saves: f64,
    /// Objects that most cells see through it.
    pub objects: usize,
}

/// Who is to blame.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Blame {
    /// Whether the objects are clusters of a scene with few objects.
    pub are_clusters: bool,
    /// The costliest first.
    pub objects: Vec<Blamed>,
    /// The ones that save most first.
    pub openings: Vec<Closed>,
}

/// The witnesses of an object.
struct Seen {
    group: usize,
    looked_at: u32,
    /// Each cell with its witnesses, and how many triangles of the object it draws.
    sights: Vec<(Sights, u32)>,
}

/// Looks for openings. `is_place` returns true where viewpoints can be; `step` is as for
/// [`SightLineTracer::trace_each`].
///
/// # Errors
/// [`ReportError`].
pub fn blame(
    sight: &SightLineTracer<'_>,
    (pvs, scene): (&Pvs, &Scene),
    costs: &Costs,
    (seed, step): (u64, f32),
    is_place: &(dyn Fn(Vec3) -> bool + Sync),
) -> Result<Blame, ReportError> {
    let by_group = costs.by_group();
    let mut order: Vec<usize> = (0..by_group.len()).filter(|g| by_group[*g].0 > 0).collect();
    order.sort_by_key(|g| (std::cmp::Reverse(by_group[*g].1), *g));
    order.truncate(OBJECTS);
    let seen: Vec<Seen> = order
        .par_iter()
        .map(|group| look(sight, (pvs, scene), costs, *group, (seed, step), is_place))
        .collect::<Result<_, _>>()?;
    let bounds = scene.bounds();
    let mut openings: Vec<Closed> = Vec::new();
    let mut objects = Vec::new();
    for of in &seen {
        let triangles = &costs.groups[of.group].triangles;
        let object = Aabb::around(
            triangles
                .iter()
                .flat_map(|t| scene.triangles()[*t as usize].v),
        );
        let sights: Vec<&Sights> = of.sights.iter().map(|(sights, _)| sights).collect();
        let through = find(bounds, object, &sights).map(|opening| {
            // Boxes that meet are taken to be one opening: the first that was found.
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
        let (cells, drawn) = by_group[of.group];
        objects.push(Blamed {
            name: costs.groups[of.group].name.clone(),
            cells,
            drawn,
            share: drawn as f64 / costs.total.max(1) as f64,
            looked_at: of.looked_at,
            joined: of.sights.len() as u32,
            through,
        });
    }
    for closed in &mut openings {
        let saved: f64 = seen
            .iter()
            .map(|of| saved_by(closed.opening, of, by_group[of.group].0))
            .sum();
        closed.saves = saved / costs.total.max(1) as f64;
    }
    // Numbers follow the order.
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

/// Triangles that would not be drawn of an object that `cells` cells see.
fn saved_by(opening: Opening, of: &Seen, cells: u32) -> f64 {
    let is_hidden = |s: &&(Sights, u32)| {
        s.0.segments
            .iter()
            .all(|segment| opening.is_passed(*segment))
    };
    let hidden: u64 = of
        .sights
        .iter()
        .filter(is_hidden)
        .map(|(_, drawn)| u64::from(*drawn))
        .sum();
    // Cells without a witness say nothing, and count as cells that go on seeing the object.
    hidden as f64 * f64::from(cells) / f64::from(of.looked_at.max(1))
}

/// Draws segments between some of the cells that see an object and the object.
fn look(
    sight: &SightLineTracer<'_>,
    (pvs, scene): (&Pvs, &Scene),
    costs: &Costs,
    group: usize,
    (seed, step): (u64, f32),
    is_place: &(dyn Fn(Vec3) -> bool + Sync),
) -> Result<Seen, ReportError> {
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
            // Uniform over the triangle (Turk 1990).
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
    Ok(Seen {
        group,
        looked_at,
        sights,
    })
}
