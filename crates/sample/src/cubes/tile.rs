//! Sampling of one tile with visibility cubes: its samples, or the sets of its cells.
//!
//! The method follows Nirenstein and Blake 2004, section 4, and Nirenstein 2003, section 4.2.
//!
//! One worker computes the tile, in one order. Only the cubes of a level are rendered by several threads.

use std::sync::Arc;

use sightline_model::{
    CellSet, CellSets, CubeParams, Granularity, Pack, SubtreeNode, SupersetChoice, TileOutput,
    VisibilitySample,
};
use sightline_scene::topology::Solids;
use sightline_scene::{Aabb, Scene, TriangleId, overlap};
use sightline_trace::CubeRenderer;
use sightline_trace::CubeScene;
use sightline_trace::TracerError;
use sightline_trace::cube::CubeSpec;
use sightline_trace::layers;
use sightline_trace::sight::SightLineTracer;
use sightline_viewcells::{
    CellBox, Division, Lattice, LatticePoint, Split, Tile, TileKind, UNITS_PER_CELL,
};

use super::cache::{CacheCounters, SampleCache};
use super::refine::{Exterior, SampleSource, refine};
use crate::context::{JobContext, TileError, Watcher};
use crate::lines::cell_joins;
use crate::lines::pairs::of_tile;

/// The counters of the work of a tile, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CubeCounters {
    /// The number of rendered cubes.
    pub rendered: u64,
    /// The counters of the sample cache.
    pub cache: CacheCounters,
}

/// Returns [`CubeParams::min_distance`], a fraction of a cell's size, as a length in world units. In an
/// adaptive tree, the cells of the deepest level determine the size.
pub fn min_distance(params: &CubeParams, division: &Division, lattice: &Lattice) -> f64 {
    let sides = [0, 1, 2].map(|a| lattice.length(a, lattice.units()[a]));
    let cells = match *division {
        // A specification cannot combine cubes with the boxes of a tree.
        Division::Tree(ref tree) => tree.boxes() as f64,
        Division::Grid(cells) => cells.map(f64::from).iter().product(),
        // The number of cells that the tree would have if all cells were on the deepest level.
        Division::Adaptive { max_depth, .. } => f64::from(1u32 << max_depth.min(31)),
    };
    // The mean is used instead of the longest side. Cells of a street or a storey are long and flat, and
    // visibility changes along their long sides as fast as in a cube of the same volume.
    let side = (sides.iter().product::<f64>() / cells).cbrt();
    // The distance is slightly larger, so that rounding of the cube root does not split a side that is meant
    // to equal the distance.
    side * params.min_distance.get() * (1.0 + 1.0 / f64::from(1 << 20))
}

/// Computes `tile` with the packs of the tiles that it needs.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
pub fn run(
    job: &JobContext<'_>,
    params: &CubeParams,
    tile: &Tile,
    packs: &[Pack],
    watcher: &dyn Watcher,
) -> Result<(TileOutput, CubeCounters), TileError> {
    let scene = job.scene.for_cubes(params.solids);
    let mut cache = SampleCache::new(tile.cell);
    for (p, sample) in packs.iter().flat_map(|pack| &pack.samples) {
        cache.insert(*p, Arc::clone(sample));
    }
    let bits = vec![0u64; job.scene.scene().triangles().len().div_ceil(64)];
    let mut work = CubeWork {
        job,
        params,
        scene,
        min_distance: min_distance(params, &job.division, &job.lattice),
        superset: match params.superset {
            SupersetChoice::On => true,
            SupersetChoice::Off => false,
            SupersetChoice::Auto => job.backend.profile().starts_with("gpu/"),
        },
        cache,
        fresh: Vec::new(),
        rendered: 0,
        bits,
        watcher,
    };
    let output = match tile.kind {
        TileKind::Face(f) => {
            let renderer = renderer(job, params, None)?;
            work.sample(tile.cell.face(f), &*renderer)?;
            TileOutput::Pack(work.take_pack())
        }
        TileKind::Separator(split) => {
            let seen = if work.superset {
                let inside = work.inside(&tile.cell);
                work.seen_from(&tile.cell, &inside).0
            } else {
                Vec::new()
            };
            work.split(&tile.cell, split, &seen)?;
            TileOutput::Pack(work.take_pack())
        }
        TileKind::Leaf => {
            let inside = work.inside(&tile.cell);
            let mut sets = CellSets::default();
            work.subtree(&tile.cell, tile.depth, &inside, &mut sets)?;
            if job.items != Granularity::Triangles {
                let rows = job.rows();
                for cell in &mut sets.cells {
                    cell.visible
                        .iter_mut()
                        .for_each(|t| *t = rows.item(TriangleId(*t)));
                    cell.visible.sort_unstable();
                    cell.visible.dedup();
                }
            }
            if let Some(pairs) = cell_joins::table(job) {
                let sight = SightLineTracer::new(job.backend, job.scene.traced())?.up_to(job.far);
                work.rendered += cell_joins::search(
                    job,
                    &sight,
                    &pairs,
                    &tile.cell,
                    cell_joins::MANY_ROUNDS,
                    watcher,
                    None,
                )?;
                sets.pairs = of_tile(job, Some(&pairs));
            }
            TileOutput::Cells(sets)
        }
    };
    Ok((
        output,
        CubeCounters {
            rendered: work.rendered,
            cache: work.cache.counters(),
        },
    ))
}

/// Creates the renderer of a job's cubes.
fn renderer<'a>(
    job: &JobContext<'a>,
    params: &CubeParams,
    superset: Option<&[u32]>,
) -> Result<Box<dyn CubeRenderer + 'a>, TracerError> {
    layers::renderer(
        job.backend,
        job.scene,
        CubeSpec::new(params),
        superset,
        job.far,
    )
}

struct CubeWork<'a> {
    job: &'a JobContext<'a>,
    params: &'a CubeParams,
    scene: CubeScene<'a>,
    min_distance: f64,
    superset: bool,
    cache: SampleCache,
    /// The samples that this tile rendered itself, only for tiles that publish a pack.
    fresh: Vec<(LatticePoint, Arc<VisibilitySample>)>,
    rendered: u64,
    /// A bit per triangle, all zero between uses.
    bits: Vec<u64>,
    watcher: &'a dyn Watcher,
}

impl CubeWork<'_> {
    fn world(&self, cell: &CellBox) -> Aabb {
        let (min, max) = cell.world(&self.job.lattice);
        Aabb { min, max }
    }

    /// Returns the triangles that show and meet a cell, I(C), in ascending order.
    fn inside(&self, cell: &CellBox) -> Vec<u32> {
        let scene = self.job.scene.scene();
        let mut inside = overlap::triangles_in_box(scene, None, &self.world(cell));
        inside.retain(|t| scene.kinds().kind(TriangleId(*t)).shows());
        inside
    }

    fn take_pack(&mut self) -> Pack {
        let mut samples = std::mem::take(&mut self.fresh);
        samples.sort_unstable_by_key(|(p, _)| *p);
        Pack { samples }
    }

    /// Computes V(C) = I(C) ∪ V(∂C) (Nirenstein and Blake 2004, equation 4), in ascending order, and the
    /// number of samples on ∂C.
    fn seen_from(&mut self, cell: &CellBox, inside: &[u32]) -> (Vec<u32>, u32) {
        let samples = self.cache.on_surface(cell);
        let count = samples.len() as u32;
        let ids = samples.iter().flat_map(|s| &s.ids).chain(inside);
        for id in ids {
            self.bits[*id as usize / 64] |= 1 << (id % 64);
        }
        for class in self.scene.duplicates {
            if class
                .iter()
                .any(|id| self.bits[*id as usize / 64] >> (id % 64) & 1 == 1)
            {
                class
                    .iter()
                    .for_each(|id| self.bits[*id as usize / 64] |= 1 << (id % 64));
            }
        }
        let mut seen = Vec::new();
        for (word, bits) in self.bits.iter_mut().enumerate() {
            let mut rest = std::mem::take(bits);
            while rest != 0 {
                seen.push(word as u32 * 64 + rest.trailing_zeros());
                rest &= rest - 1;
            }
        }
        (seen, count)
    }

    /// Returns true if a grid cell in a box has viewpoints.
    fn is_reached(&self, within: &CellBox) -> bool {
        let Some(marks) = self.job.viewpoints else {
            return true;
        };
        let [nx, ny, _] = marks.cells();
        let range = |a: usize| within.lo[a] / UNITS_PER_CELL..within.hi[a] / UNITS_PER_CELL;
        let index = |x: u32, y: u32, z: u32| ((z * ny + y) * nx + x) as usize;
        range(2).any(|z| range(1).any(|y| range(0).any(|x| marks.parts(index(x, y, z)) != 0)))
    }

    fn subtree(
        &mut self,
        cell: &CellBox,
        depth: u32,
        inside: &[u32],
        out: &mut CellSets,
    ) -> Result<(), TileError> {
        let (seen, samples) = self.seen_from(cell, inside);
        let division = self.job.division.clone();
        let split = division
            .split(&self.job.lattice, cell, depth)
            .filter(|_| division.wants_split(seen.len(), depth));
        let Some(split) = split else {
            self.cache.finish(cell);
            let unreached = !self.is_reached(cell);
            let visible = if unreached { Vec::new() } else { seen };
            out.nodes.push(SubtreeNode::Cell);
            out.cells.push(CellSet {
                visible,
                samples,
                unreached,
                ..CellSet::default()
            });
            self.watcher.cell_done();
            return Ok(());
        };
        // If no cell below has viewpoints, the tree is split without sampling.
        if self.is_reached(cell) {
            self.split(cell, split, &seen)?;
        }
        // A leaf tile publishes no pack. The samples that it needs again are in the cache.
        self.fresh.clear();
        drop(seen);
        out.nodes.push(SubtreeNode::Split(split));
        for child in cell.children(split) {
            let within = overlap::triangles_in_box(
                self.job.scene.scene(),
                Some(inside),
                &self.world(&child),
            );
            self.subtree(&child, depth + 1, &within, out)?;
        }
        Ok(())
    }

    /// Samples the rectangle that splits `cell`. With superset simplification, only the triangles of V(C) are
    /// rendered.
    fn split(&mut self, cell: &CellBox, split: Split, seen: &[u32]) -> Result<(), TileError> {
        let renderer = renderer(self.job, self.params, self.superset.then_some(seen))?;
        self.sample(cell.cut(split), &*renderer)
    }

    fn sample(
        &mut self,
        rect: sightline_viewcells::Rect,
        renderer: &dyn CubeRenderer,
    ) -> Result<(), TileError> {
        let exterior = SolidExterior {
            solids: self.scene.solids,
            scene: self.job.scene.scene(),
            lattice: &self.job.lattice,
        };
        let (job, params, min_distance) = (self.job, self.params, self.min_distance);
        let mut source = CachedSource {
            work: self,
            renderer,
        };
        refine(
            rect,
            &job.lattice,
            min_distance,
            params,
            &exterior,
            &mut source,
        )
    }
}

/// A source of samples from the cache. Missing samples are rendered and inserted.
struct CachedSource<'w, 'a> {
    work: &'w mut CubeWork<'a>,
    renderer: &'w dyn CubeRenderer,
}

/// The number of cubes rendered between two checks for cancellation.
const BATCH: usize = 256;

impl SampleSource for CachedSource<'_, '_> {
    type Error = TileError;

    fn samples(
        &mut self,
        points: &[LatticePoint],
    ) -> Result<Vec<Arc<VisibilitySample>>, TileError> {
        let mut found: Vec<_> = points.iter().map(|p| self.work.cache.get(*p)).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|i| found[*i].is_none()).collect();
        for batch in missing.chunks(BATCH) {
            if self.work.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            let positions: Vec<_> = batch
                .iter()
                .map(|i| self.work.job.lattice.position(points[*i]))
                .collect();
            for (i, sample) in batch.iter().zip(self.renderer.samples(&positions)?) {
                let sample = Arc::new(sample);
                self.work.cache.insert(points[*i], Arc::clone(&sample));
                self.work.fresh.push((points[*i], Arc::clone(&sample)));
                found[*i] = Some(sample);
            }
            self.work.rendered += batch.len() as u64;
            self.work.watcher.rendered(batch.len() as u64);
        }
        // A backend that returns fewer samples than requested would leave holes without an error.
        found
            .into_iter()
            .collect::<Option<Vec<_>>>()
            .ok_or_else(|| {
                TileError::Backend(TracerError::Failed {
                    profile: self.work.job.backend.profile().to_owned(),
                    reason: "the backend returned fewer samples than requested points".to_owned(),
                })
            })
    }
}

/// The test for interior samples.
///
/// A sample is interior if the triangle that covers most of its pixels belongs to a closed solid and shows
/// its inner side (Nirenstein and Blake 2004, section 3.6).
struct SolidExterior<'a> {
    solids: Option<&'a Solids>,
    scene: &'a Scene,
    lattice: &'a Lattice,
}

impl Exterior for SolidExterior<'_> {
    fn is_exterior(&self, p: LatticePoint, sample: &VisibilitySample) -> bool {
        // In the plane of the triangle, or without a visible solid, the sample counts as exterior.
        let judged = self.solids.zip(sample.dominant);
        judged
            .and_then(|(solids, id)| {
                solids.exterior(self.scene, TriangleId(id), self.lattice.position(p))
            })
            .unwrap_or(true)
    }
}
