//! The share of the view that each visible item covers, for each cell.
//!
//! The share is computed from counts of the lines that meet the item, from viewpoints spread over the cell.
//!
//! The lines of a viewpoint are spread evenly over the pixels of a cube, as in the error measure. The
//! fraction of lines that meet an item is therefore its share of the pixels. Items that no line meets have no
//! hits, because their share is small or they are visible only from small parts of the cell. Hits do not
//! affect a set.

use std::collections::BTreeMap;

use rayon::prelude::*;
use sightline_model::{CellSet, Hits};
use sightline_scene::TriangleId;
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::lines::grid::Slot;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::rows::Rows;
use sightline_trace::sequence::{Hashed, spread3};
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_viewcells::{CellBox, UNITS_PER_CELL};

use super::block::LEAST_STEP;
use super::cell_table::Cell;
use crate::context::{JobContext, TileError, ViewRegion, Watcher};

/// The number of viewpoints of a cell.
const VIEWPOINTS: u32 = 32;
/// The number of tiles of 4×4 lines along a side of a cube's face: 1536 lines from each viewpoint.
const TILES: u32 = 4;
/// The name of the stream of random numbers.
const HITS: u64 = 8;

/// Counts the hits of the items in `sets`, whose cells are `cells`. Returns the number of rays.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
pub fn count(
    job: &JobContext<'_>,
    cells: &[CellBox],
    sets: &mut [CellSet],
    watcher: &dyn Watcher,
) -> Result<u64, TileError> {
    let sight = SightLineTracer::new(job.backend, job.scene.traced())?.up_to(job.far);
    let rows = job.rows();
    let classes = job.scene.for_cubes(false).duplicates;
    let twins: BTreeMap<u32, &[u32]> = classes
        .iter()
        .flat_map(|c| c.iter().map(|t| (*t, c.as_slice())))
        .collect();
    let units = job.lattice.units();
    let whole = units.map(|u| u / UNITS_PER_CELL);
    let shown: Vec<Hits> = cells
        .par_iter()
        .zip(&*sets)
        .with_max_len(1)
        .map(|(at, set)| {
            if watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            let [x, y, z] = at.lo.map(|u| u / UNITS_PER_CELL);
            let number = u64::from((z * whole[1] + y) * whole[0] + x);
            let parts = job
                .viewpoints
                .map_or(u64::MAX, |marks| marks.parts(number as usize));
            let (lo, hi) = at.world(&job.lattice);
            let random = Hashed::new(&[
                job.seed,
                at.lo.map(u64::from).into_iter().fold(0, mixed),
                HITS,
            ]);
            let cell = Cell {
                at: [0; 3],
                slot: Slot { word: 0, bit: 0 },
                lo,
                size: hi - lo,
                number,
                parts,
            };
            let step = (hi - lo).max_element() * LEAST_STEP;
            let (region, visible) = (job.region, set.visible.as_slice());
            let mut counter = Counter {
                rows,
                twins: &twins,
                region,
                visible,
                counts: Vec::new(),
            };
            counter.from(&cell, &sight, step, random)
        })
        .collect::<Result<_, TileError>>()?;
    let rays = u64::from(VIEWPOINTS * 6 * TILES * TILES) * LANES as u64 * cells.len() as u64;
    watcher.rendered(rays);
    for (set, hits) in sets.iter_mut().zip(shown) {
        set.hits = Some(hits);
    }
    Ok(rays)
}

/// Combines a lattice coordinate with the hash of the previous coordinates.
fn mixed(so_far: u64, coordinate: u64) -> u64 {
    so_far << 21 ^ so_far >> 43 ^ coordinate
}

struct Counter<'a> {
    rows: &'a Rows,
    /// For each triangle with duplicates, all triangles of its class.
    twins: &'a BTreeMap<u32, &'a [u32]>,
    /// The region that contains all viewpoints; `None` if viewpoints are not restricted to a region.
    region: Option<&'a dyn ViewRegion>,
    visible: &'a [u32],
    /// For each visible item, three numbers of lines that meet the item: from all viewpoints so far, from the
    /// current viewpoint, and the maximum from one viewpoint.
    counts: Vec<[u32; 3]>,
}

impl Counter<'_> {
    fn from(
        &mut self,
        cell: &Cell,
        sight: &SightLineTracer<'_>,
        step: f32,
        mut random: Hashed,
    ) -> Result<Hits, TileError> {
        self.counts = vec![[0; 3]; self.visible.len()];
        let shift = [random.unit(), random.unit(), random.unit()];
        let pixel = 2.0 / (4 * TILES) as f32;
        let (mut packets, mut passed) = (Vec::new(), Passed::default());
        // A cell without viewpoints has no visible items.
        let viewpoints = if self.visible.is_empty() {
            0
        } else {
            VIEWPOINTS
        };
        for number in 0..viewpoints {
            let origin = cell.origin(self.region, spread3(number.into(), shift));
            packets.clear();
            for k in 0..6 * TILES * TILES {
                let (face, tile) = (k / (TILES * TILES), k % (TILES * TILES));
                let [forward, right, up] = face_basis(face);
                let mut packet = Packet::default();
                for lane in 0..LANES as u32 {
                    let x = ((tile % TILES * 4 + lane % 4) as f32 + random.unit()) * pixel - 1.0;
                    let y = ((tile / TILES * 4 + lane / 4) as f32 + random.unit()) * pixel - 1.0;
                    packet.push(origin, (forward + right * x + up * y).to_array());
                }
                packets.push(packet);
            }
            sight.trace(&mut packets, &mut passed, step)?;
            for (k, packet) in packets.iter().enumerate() {
                for lane in 0..LANES {
                    let mut met: Vec<u32> = Vec::new();
                    let on = std::iter::once(packet.triangle[lane]).chain(passed.on(k, lane));
                    on.filter(|t| *t != SKY)
                        .for_each(|t| self.items(t, &mut met));
                    // A line through several triangles of an item meets it once.
                    met.sort_unstable();
                    met.dedup();
                    for item in met {
                        if let Ok(place) = self.visible.binary_search(&item) {
                            self.counts[place][1] += 1;
                        }
                    }
                }
            }
            for [all, here, most] in &mut self.counts {
                *all += *here;
                *most = (*most).max(*here);
                *here = 0;
            }
        }
        let counts = self
            .counts
            .iter()
            .map(|[all, _, most]| [*all, *most])
            .collect();
        Ok(Hits {
            viewpoints: VIEWPOINTS,
            lines: 6 * TILES * TILES * LANES as u32,
            counts,
        })
    }

    /// Appends the items of a triangle and of its duplicates.
    fn items(&self, triangle: u32, out: &mut Vec<u32>) {
        match self.twins.get(&triangle) {
            Some(class) => out.extend(class.iter().map(|t| self.rows.item(TriangleId(*t)))),
            None => out.push(self.rows.item(TriangleId(triangle))),
        }
    }
}
