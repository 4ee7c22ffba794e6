//! One tile of the plan: its samples, or the sets of its cells (2004, §4; thesis §4.2).
//!
//! A tile is a pure function of the scene, the parameters, the backend's numerics profile and the packs of the
//! tiles it needs. It runs on one worker, in one order; only the rendering of a level's cubes is spread over
//! threads.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use rayon::prelude::*;
use sightline_scene::topology::{self, Solids};
use sightline_scene::{Aabb, Scene, SceneError, overlap};
use sightline_viewcells::{CellBox, Division, Lattice, LatticePoint, Split, Tile, TileKind};

use crate::backend::{Backend, BackendError, CubeRenderer};
use crate::cache::{CacheCounters, SampleCache};
use crate::cube::VisibilitySample;
use crate::lines::surface::Surface;
use crate::lines::{self, CellStats};
use crate::params::{Sampler, SamplingParams, SupersetChoice};
use crate::refine::{Exterior, SampleSource, refine};

/// A scene with what tiles need of it, each computed when first asked for, once a worker. That uses rayon, so ask for it before any of
/// rayon's threads does: one that waits inside could come back to the same lock.
pub struct PreparedScene {
    /// The triangles.
    pub scene: Arc<Scene>,
    solids: OnceLock<Solids>,
    duplicates: OnceLock<Vec<Vec<u32>>>,
    distinct: OnceLock<Vec<u32>>,
    surface: OnceLock<Surface>,
}

/// Why an analysis cannot fail.
const CHECKED: &str = "the number of triangles was checked when the scene was prepared";

impl PreparedScene {
    /// Takes up `scene`.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when it has too many triangles to analyse.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        topology::check_size(&scene)?;
        Ok(Self {
            scene,
            solids: OnceLock::new(),
            duplicates: OnceLock::new(),
            distinct: OnceLock::new(),
            surface: OnceLock::new(),
        })
    }

    /// Which triangles bound closed solids.
    #[expect(clippy::expect_used, reason = "new() has checked the only thing that can fail")]
    pub fn solids(&self) -> &Solids {
        self.solids.get_or_init(|| Solids::of(&self.scene).expect(CHECKED))
    }

    /// Classes of triangles with the same three vertices: seen together or not at all.
    #[expect(clippy::expect_used, reason = "new() has checked the only thing that can fail")]
    pub fn duplicates(&self) -> &[Vec<u32>] {
        self.duplicates.get_or_init(|| topology::duplicates(&self.scene).expect(CHECKED))
    }

    /// The triangles with area, without those that are duplicates of an earlier one; ascending.
    pub fn distinct(&self) -> &[u32] {
        self.distinct.get_or_init(|| {
            let mut kept = vec![true; self.scene.triangles().len()];
            self.duplicates().iter().flat_map(|class| &class[1..]).for_each(|id| kept[*id as usize] = false);
            let area = |id: &u32| !self.scene.triangles()[*id as usize].is_degenerate();
            (0..self.scene.len()).into_par_iter().filter(|id| kept[*id as usize]).filter(area).collect()
        })
    }

    /// Neighbours over edges and the order in space.
    pub fn surface(&self) -> &Surface {
        let distinct = self.distinct();
        self.surface.get_or_init(|| Surface::of(&self.scene, distinct))
    }
}

/// What all tiles of a job share.
pub struct JobContext<'a> {
    /// The scene.
    pub scene: &'a PreparedScene,
    /// How the view box is divided.
    pub division: Division,
    /// Its lattice.
    pub lattice: Lattice,
    /// The parameters.
    pub params: &'a SamplingParams,
    /// What renders.
    pub backend: &'a dyn Backend,
    /// Seed of everything random.
    pub seed: u64,
    /// When to stop with what there is; only sight lines have it.
    pub deadline: Option<Instant>,
}

/// The samples a tile rendered, by position.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pack {
    /// Ascending by lattice position.
    pub samples: Vec<(LatticePoint, Arc<VisibilitySample>)>,
}

/// A node of a leaf tile's subtree, in preorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// An inner node; its two children follow, the one below the plane first.
    Split(Split),
    /// A view cell; the sets are in the order of these.
    Cell,
}

/// What is known of a view cell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSet {
    /// Ids seen from it or meeting it, ascending.
    pub visible: Vec<u32>,
    /// Visibility cubes on its surface.
    pub samples: u32,
    /// How sight lines came to the set.
    pub stats: CellStats,
    /// What exact queries decided beyond sampling; none when nobody asked for that.
    pub decision: Option<Decision>,
}

/// What exact queries added to what was sampled. Their counts and their evidence are opaque here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Decision {
    /// Triangles of the set that were neither seen nor proved hidden, ascending.
    pub undecided: Vec<u32>,
    /// What was counted, at most [`Decision::MOST_COUNTS`] numbers.
    pub counts: Vec<u64>,
    /// Witnesses and certificates, where they are kept.
    pub evidence: Vec<u8>,
}

impl Decision {
    /// Most numbers a decision can have.
    pub const MOST_COUNTS: usize = 64;
}

/// The result of a leaf tile.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellSets {
    /// The subtree.
    pub nodes: Vec<Node>,
    /// Its cells.
    pub cells: Vec<CellSet>,
}

/// What a tile gives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TileOutput {
    /// Of a face or separator tile.
    Pack(Pack),
    /// Of a leaf tile.
    Cells(CellSets),
}

/// Work done by a tile, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileCounters {
    /// Cubes rendered, or rays traced.
    pub rendered: u64,
    /// The sample cache's own counters.
    pub cache: CacheCounters,
}

/// Why a tile did not finish.
#[derive(Debug, thiserror::Error)]
pub enum TileError {
    /// Its lease was taken back.
    #[error("the tile was cancelled")]
    Cancelled,
    /// The backend failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
}

/// Told about progress, and asked whether to go on.
pub trait Watcher: Sync {
    /// So many more cubes were rendered, or rays traced.
    fn rendered(&self, samples: u64);
    /// One more cell is finished.
    fn cell_done(&self);
    /// Whether the tile should stop.
    fn cancelled(&self) -> bool;
}

/// Runs `tile` with the packs of the tiles it needs.
///
/// # Errors
/// [`TileError`] when it is cancelled or the backend fails.
pub fn run(
    job: &JobContext<'_>,
    tile: &Tile,
    packs: &[Pack],
    watcher: &dyn Watcher,
) -> Result<(TileOutput, TileCounters), TileError> {
    if job.params.sampler != Sampler::Cubes {
        let (sets, rendered) = lines::run(job, tile, watcher)?;
        return Ok((TileOutput::Cells(sets), TileCounters { rendered, ..TileCounters::default() }));
    }
    let mut cache = SampleCache::new(tile.cell);
    for (p, sample) in packs.iter().flat_map(|pack| &pack.samples) {
        cache.insert(*p, Arc::clone(sample));
    }
    let bits = vec![0u64; job.scene.scene.triangles().len().div_ceil(64)];
    let mut work = Work {
        job,
        min_distance: job.params.min_distance_world(&job.division, &job.lattice),
        superset: match job.params.superset {
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
            let renderer = job.backend.prepare(None)?;
            work.sample(tile.cell.face(f), &*renderer)?;
            TileOutput::Pack(work.take_pack())
        }
        TileKind::Separator(split) => {
            let seen = if work.superset {
                let inside = overlap::triangles_in_box(&job.scene.scene, None, &work.world(&tile.cell));
                work.seen_from(&tile.cell, &inside).0
            } else {
                Vec::new()
            };
            work.split(&tile.cell, split, &seen)?;
            TileOutput::Pack(work.take_pack())
        }
        TileKind::Leaf => {
            let inside = overlap::triangles_in_box(&job.scene.scene, None, &work.world(&tile.cell));
            let mut sets = CellSets::default();
            work.subtree(&tile.cell, tile.depth, &inside, &mut sets)?;
            TileOutput::Cells(sets)
        }
    };
    Ok((output, TileCounters { rendered: work.rendered, cache: work.cache.counters() }))
}

struct Work<'a> {
    job: &'a JobContext<'a>,
    min_distance: f64,
    superset: bool,
    cache: SampleCache,
    /// What this tile rendered itself; kept only by tiles that publish a pack.
    fresh: Vec<(LatticePoint, Arc<VisibilitySample>)>,
    rendered: u64,
    /// One bit a triangle, all zero between uses.
    bits: Vec<u64>,
    watcher: &'a dyn Watcher,
}

impl Work<'_> {
    fn world(&self, cell: &CellBox) -> Aabb {
        let (min, max) = cell.world(&self.job.lattice);
        Aabb { min, max }
    }

    fn take_pack(&mut self) -> Pack {
        let mut samples = std::mem::take(&mut self.fresh);
        samples.sort_unstable_by_key(|(p, _)| *p);
        Pack { samples }
    }

    /// V(C) = I(C) ∪ V(∂C) (eq. 4), ascending, and the number of samples on ∂C.
    fn seen_from(&mut self, cell: &CellBox, inside: &[u32]) -> (Vec<u32>, u32) {
        let samples = self.cache.on_surface(cell);
        let count = samples.len() as u32;
        let ids = samples.iter().flat_map(|s| &s.ids).chain(inside);
        for id in ids {
            self.bits[*id as usize / 64] |= 1 << (id % 64);
        }
        for class in self.job.scene.duplicates() {
            if class.iter().any(|id| self.bits[*id as usize / 64] >> (id % 64) & 1 == 1) {
                class.iter().for_each(|id| self.bits[*id as usize / 64] |= 1 << (id % 64));
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

    fn subtree(
        &mut self,
        cell: &CellBox,
        depth: u32,
        inside: &[u32],
        out: &mut CellSets,
    ) -> Result<(), TileError> {
        let (seen, samples) = self.seen_from(cell, inside);
        let division = self.job.division;
        let split = division
            .split(&self.job.lattice, cell, depth)
            .filter(|_| division.wants_split(seen.len(), depth));
        let Some(split) = split else {
            self.cache.finish(cell);
            out.nodes.push(Node::Cell);
            out.cells.push(CellSet { visible: seen, samples, ..CellSet::default() });
            self.watcher.cell_done();
            return Ok(());
        };
        self.split(cell, split, &seen)?;
        // A leaf tile publishes nothing: what it needs again is in the cache.
        self.fresh.clear();
        drop(seen);
        out.nodes.push(Node::Split(split));
        for child in cell.children(split) {
            let within = overlap::triangles_in_box(&self.job.scene.scene, Some(inside), &self.world(&child));
            self.subtree(&child, depth + 1, &within, out)?;
        }
        Ok(())
    }

    /// Samples the rectangle that splits `cell`, with V(C) only when superset simplification is on.
    fn split(&mut self, cell: &CellBox, split: Split, seen: &[u32]) -> Result<(), TileError> {
        let renderer = self.job.backend.prepare(self.superset.then_some(seen))?;
        self.sample(cell.cut(split), &*renderer)
    }

    fn sample(
        &mut self,
        rect: sightline_viewcells::Rect,
        renderer: &dyn CubeRenderer,
    ) -> Result<(), TileError> {
        let exterior = SolidExterior { scene: self.job.scene, lattice: &self.job.lattice };
        let (job, min_distance) = (self.job, self.min_distance);
        let mut source = CachedSource { work: self, renderer };
        refine(rect, &job.lattice, min_distance, job.params, &exterior, &mut source)
    }
}

/// Samples from the cache, or rendered and put there.
struct CachedSource<'w, 'a> {
    work: &'w mut Work<'a>,
    renderer: &'w dyn CubeRenderer,
}

/// Cubes rendered between two looks at whether the tile is still wanted.
const BATCH: usize = 64;

impl SampleSource for CachedSource<'_, '_> {
    type Error = TileError;

    fn samples(&mut self, points: &[LatticePoint]) -> Result<Vec<Arc<VisibilitySample>>, TileError> {
        let mut found: Vec<_> = points.iter().map(|p| self.work.cache.get(*p)).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|i| found[*i].is_none()).collect();
        for batch in missing.chunks(BATCH) {
            if self.work.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            let positions: Vec<_> =
                batch.iter().map(|i| self.work.job.lattice.position(points[*i])).collect();
            for (i, sample) in batch.iter().zip(self.renderer.samples(&positions)?) {
                let sample = Arc::new(sample);
                self.work.cache.insert(points[*i], Arc::clone(&sample));
                self.work.fresh.push((points[*i], Arc::clone(&sample)));
                found[*i] = Some(sample);
            }
            self.work.rendered += batch.len() as u64;
            self.work.watcher.rendered(batch.len() as u64);
        }
        // A backend that gives fewer samples than it was asked for would leave holes; it is not trusted to.
        found.into_iter().collect::<Option<Vec<_>>>().ok_or_else(|| {
            TileError::Backend(BackendError::Failed {
                profile: self.work.job.backend.profile().to_owned(),
                reason: "it gave fewer samples than points".to_owned(),
            })
        })
    }
}

/// §3.6: a sample is interior when the triangle that covers most of its pixels belongs to a closed solid and shows
/// its inner side.
struct SolidExterior<'a> {
    scene: &'a PreparedScene,
    lattice: &'a Lattice,
}

impl Exterior for SolidExterior<'_> {
    fn is_exterior(&self, p: LatticePoint, sample: &VisibilitySample) -> bool {
        // In the plane of the triangle, or with no solid in sight, a viewpoint may be there.
        sample
            .dominant
            .and_then(|id| self.scene.solids().exterior(&self.scene.scene, id, self.lattice.position(p)))
            .unwrap_or(true)
    }
}
