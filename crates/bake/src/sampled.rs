//! The computation of a tile of a job that samples: the sets of cells, or samples for other tiles.
//!
//! With exact methods, the tile also decides about every triangle that sampling did not show.

use std::time::Instant;

use sightline_model::{CellSet, Method, Pack, PlannedJob, Sampling, TileOutput, Visibility, codec};
use sightline_portals::{NoPartition, OpenFaces};
use sightline_sample::crew::{Crew, Phase};
use sightline_sample::lines::hits;
use sightline_sample::{JobContext, TileError, Watcher, tile};
use sightline_trace::{Tracer, TracerError};
use sightline_viewcells::{Plan, TileIndex, TileKind};

use crate::cell_decider::{self, CellDecider};
use crate::choices::sampling_deadline;
use crate::deciding::Deciding;
use crate::inputs::{Inputs, PackBytes};
use crate::job_region::JobRegion;
use crate::outcome::tile_error;
use crate::scope::TileScope;
use crate::{BakeError, Control, PackDigest, TileDone, groups, portals};

/// Computes tile `number` of a job that samples.
pub fn run(
    job: &PlannedJob,
    task: &Visibility,
    sampling: &Sampling,
    number: TileIndex,
    inputs: Inputs<'_>,
    tracer: &dyn Tracer,
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let Inputs { scene, packs, .. } = inputs;
    let scope = TileScope::new(job, task, number)?;
    let tile = &scope.tile;
    let watcher = control.watcher;
    if task.is_decided() && scene.scene().kinds().any_masked() {
        return Err(BakeError::Tile(
            "the job's method uses exact queries, which do not read alpha masks; use the method \
             aggressive, or a scene whose masked triangles are see-through"
                .to_owned(),
        ));
    }
    let exact = match task.method {
        Method::Exact { effort, .. } if tile.kind == TileKind::Leaf => Some(effort),
        _ => None,
    };
    // The members of the crew also decide the cells.
    let decides = exact.is_some() && control.deadline.is_none();
    let decided_later = Open(control.crew);
    let job_region =
        JobRegion::from_viewpoints(task.viewpoints(), scene.scene()).map_err(tile_error)?;
    let context = JobContext {
        scene: scene.sampling(),
        division: scope.division.clone(),
        lattice: scope.traced_lattice(scene.scene()).map_err(tile_error)?,
        sampler: (&sampling.sampler).into(),
        items: task.items(),
        completes: task.is_completed(),
        far: task.far.map(|far| far.get()),
        viewpoints: scope.mask.as_deref(),
        region: job_region.as_ref().map(|region| region as _),
        pairs: task.pair_cells(),
        backend: tracer,
        seed: scope.seed,
        deadline: sampling_deadline(task.is_decided(), control.deadline),
        crew: if decides {
            &decided_later
        } else {
            control.crew
        },
    };
    if packs.len() != tile.needs.len() {
        return Err(BakeError::Tile(format!(
            "the tile needs {} packs, but the caller passed {}; pass one for each needed tile",
            tile.needs.len(),
            packs.len()
        )));
    }
    let mut recomputed = Vec::new();
    let mut decoded = Vec::with_capacity(packs.len());
    for (needed, pack) in tile.needs.iter().zip(packs) {
        let fresh;
        let bytes = match pack {
            PackBytes::Present(bytes) => *bytes,
            PackBytes::Lost(digest) => {
                fresh = recompute_pack(&context, job.plan(), TileIndex(*needed), *digest, watcher)?;
                recomputed.push((*digest, fresh.clone()));
                &fresh
            }
        };
        decoded
            .push(codec::decode_pack(bytes, scene.scene().len(), &tile.cell).map_err(tile_error)?);
    }
    let sampling_only = WithoutCells(watcher);
    let sampling_watcher: &dyn Watcher = if exact.is_some() {
        &sampling_only
    } else {
        watcher
    };
    let (mut output, counters) = tile::run(&context, tile, &decoded, sampling_watcher)?;
    tracing::debug!(tile = number.0, ?counters, "tile sampled");
    if let (Some(effort), TileOutput::Cells(sets)) = (exact, &mut output) {
        let prepared = scene.exact().map_err(BakeError::Tile)?;
        let region = job_region.as_ref().map(JobRegion::exact);
        let faces = scope
            .is_open
            .then(|| OpenFaces::new(scene.scene(), scope.view_box, region));
        let region = faces.as_ref().map(|faces| faces as _).or(region);
        // Portals save time if walls enclose the viewpoints. Otherwise portals hide few triangles that cell
        // groups do not hide (docs/experiments/portals.md). Jobs with a region store no certificates, which
        // portals could not provide.
        let late = || control.deadline.is_some_and(|end| Instant::now() >= end);
        let made = job_region
            .is_some()
            .then(|| scene.partition(task, &|| watcher.cancelled() || late()));
        let partition = match made {
            None | Some(Err(NoPartition::Stopped)) => None,
            Some(made) => Some(made.map_err(tile_error)?),
        };
        if task.has_portals() && number == TileIndex(0) {
            sets.portals = portals::encoded(partition.as_deref(), scene.scene());
        }
        let decider = CellDecider {
            deciding: &Deciding::new(task, effort, &scope),
            scene: prepared,
            region,
            partition: partition.as_deref(),
            watcher,
        };
        cell_decider::cells(decider, &tile.cell, sets, control.deadline, control.crew)?;
        if watcher.cancelled() {
            return Err(BakeError::Cancelled);
        }
        if decides {
            control.crew.end()?;
        }
        tracing::debug!(tile = number.0, "tile decided");
    }
    let mut samples = counters.rendered;
    if let (true, TileOutput::Cells(sets)) = (sampling.contributions, &mut output) {
        let (boxes, _) = groups::cells_and_groups(&tile.cell, &sets.nodes);
        samples += hits::count(&context, &boxes, &mut sets.cells, watcher)?;
        if task.is_completed() {
            sets.cells.iter_mut().for_each(remove_met);
        }
    }
    let bytes = codec::encode(&output).map_err(tile_error)?;
    tracing::debug!(tile = number.0, bytes = bytes.len(), "tile encoded");
    Ok(TileDone {
        bytes,
        samples,
        recomputed,
    })
}

/// Removes the items that a contribution line met from the undecided items of a cell.
fn remove_met(cell: &mut CellSet) {
    if let Some(hits) = &cell.hits {
        let is_met = |item: &u32| {
            let at = cell.visible.binary_search(item);
            at.is_ok_and(|at| hits.counts[at][0] > 0)
        };
        cell.undecided.retain(|item| !is_met(item));
    }
}

/// Computes a lost pack again and checks its digest.
fn recompute_pack(
    job: &JobContext<'_>,
    plan: &Plan,
    number: TileIndex,
    digest: PackDigest,
    watcher: &dyn Watcher,
) -> Result<Vec<u8>, BakeError> {
    tracing::warn!("the pack of tile {number} is lost and is computed again");
    let bytes = recompute(job, plan, number, watcher)?;
    if *blake3::hash(&bytes).as_bytes() == digest {
        return Ok(bytes);
    }
    Err(BakeError::Tile(format!(
        "the pack of tile {number} was computed again with different bytes; the machine, driver or \
         program of a worker differs from its profile"
    )))
}

/// Computes the encoded output of a tile together with the packs that it needs. The depth of the kd-tree
/// bounds the recursion, and the plan lists every tile after the tiles that it needs.
fn recompute(
    job: &JobContext<'_>,
    plan: &Plan,
    number: TileIndex,
    watcher: &dyn Watcher,
) -> Result<Vec<u8>, BakeError> {
    let tile = &plan.tiles[number.at()];
    let mut packs: Vec<Pack> = Vec::with_capacity(tile.needs.len());
    for need in &tile.needs {
        let bytes = recompute(job, plan, TileIndex(*need), watcher)?;
        packs
            .push(codec::decode_pack(&bytes, job.scene.scene().len(), &tile.cell).map_err(broken)?);
    }
    let (output, _) = tile::run(job, tile, &packs, watcher)?;
    codec::encode(&output).map_err(broken)
}

/// Creates the error of a pack that this worker encoded and cannot decode.
fn broken(e: impl std::fmt::Display) -> BakeError {
    BakeError::Backend(TracerError::Failed {
        profile: "this worker".to_owned(),
        reason: e.to_string(),
    })
}

/// A crew that ignores the end that the sampler reports, because the members still decide the cells.
struct Open<'a>(&'a dyn Crew);

impl Crew for Open<'_> {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        self.0.run(phase)
    }

    fn end(&self) -> Result<(), TileError> {
        Ok(())
    }
}

/// A watcher of the sampling of a tile. This watcher does not count cells as done, because the tile still has
/// to decide them.
struct WithoutCells<'a>(&'a dyn Watcher);

impl Watcher for WithoutCells<'_> {
    fn rendered(&self, samples: u64) {
        self.0.rendered(samples);
    }
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
