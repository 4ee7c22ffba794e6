//! A tile of a job that samples: its sets or samples, and, with exact methods, the decision about every
//! triangle that sampling did not show.

use std::time::Instant;

use sightline_model::{Method, Pack, PlannedJob, Sampling, TileOutput, Visibility, codec};
use sightline_portals::{NoPartition, OpenFaces};
use sightline_sample::crew::{Crew, Phase};
use sightline_sample::lines::hits;
use sightline_sample::{JobContext, TileError, Watcher, tile};
use sightline_trace::{Backend, BackendError};
use sightline_viewcells::{Plan, TileKind};

use crate::choices::sampling_deadline;
use crate::decide;
use crate::deciding::Deciding;
use crate::inputs::{Inputs, PackBytes};
use crate::outcome::tile_error;
use crate::scope::TileScope;
use crate::within::JobRegion;
use crate::{BakeError, Control, PackDigest, TileDone, groups, portals};

/// Computes tile `number` of a job.
pub fn run(
    job: &PlannedJob,
    (task, sampling): (&Visibility, &Sampling),
    number: u32,
    (inputs, backend): (Inputs<'_>, &dyn Backend),
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let Inputs { scene, packs, .. } = inputs;
    let scope = TileScope::new(job, task, number)?;
    let tile = &scope.tile;
    let watcher = control.watcher;
    if task.is_decided() && scene.scene().kinds().any_masked() {
        return Err(BakeError::Tile(
            "the method decides exactly, and exact queries do not read alpha masks; use the method \
             aggressive, or a scene whose masked triangles are see-through"
                .to_owned(),
        ));
    }
    let exact = match task.method {
        Method::Exact { effort, .. } if tile.kind == TileKind::Leaf => Some(effort),
        _ => None,
    };
    // The members of the crew decide the cells as well.
    let decides = exact.is_some() && control.deadline.is_none();
    let decided_later = Open(control.crew);
    let places = JobRegion::of(task.viewpoints(), scene.scene()).map_err(tile_error)?;
    let context = JobContext {
        scene: scene.sampling(),
        division: scope.division.clone(),
        lattice: scope.traced_lattice(scene.scene()).map_err(tile_error)?,
        sampler: (&sampling.sampler).into(),
        items: task.items(),
        far: task.far.map(|far| far.get()),
        viewpoints: scope.mask.as_deref(),
        places: places.as_ref().map(|p| p as _),
        pairs: task.pair_cells(),
        backend,
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
            "it needs {} packs and was given {}; give one for each tile that it needs",
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
                fresh = again(&context, job.plan(), *needed, *digest, watcher)?;
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
    tracing::debug!(tile = number, ?counters, "tile sampled");
    if let (Some(effort), TileOutput::Cells(sets)) = (exact, &mut output) {
        let prepared = scene.exact().map_err(BakeError::Tile)?;
        let with = (control.deadline, watcher, control.crew);
        let within = places.as_ref().map(JobRegion::places);
        let faces = scope
            .is_open
            .then(|| OpenFaces::new(scene.scene(), scope.view_box, within));
        let within = faces.as_ref().map(|faces| faces as _).or(within);
        // Portals save time where walls enclose the viewpoints; elsewhere they hide little that groups of
        // cells do not (docs/experiments/portals.md). A region has no certificates, which portals could not
        // give.
        let late = || control.deadline.is_some_and(|end| Instant::now() >= end);
        let made = places
            .is_some()
            .then(|| scene.partition(task, &|| watcher.cancelled() || late()));
        let partition = match made {
            None | Some(Err(NoPartition::Stopped)) => None,
            Some(made) => Some(made.map_err(tile_error)?),
        };
        if task.has_portals() && number == 0 {
            sets.portals = portals::encoded(partition.as_deref(), scene.scene());
        }
        let exact_inputs = (prepared, partition.as_deref(), scope.is_open);
        let deciding = Deciding::new(task, effort, &scope);
        decide::cells((&deciding, within), &tile.cell, sets, exact_inputs, with)?;
        if watcher.cancelled() {
            return Err(BakeError::Cancelled);
        }
        if decides {
            control.crew.end()?;
        }
        tracing::debug!(tile = number, "tile decided");
    }
    let mut samples = counters.rendered;
    if let (true, TileOutput::Cells(sets)) = (sampling.contributions, &mut output) {
        let (boxes, _) = groups::cells_and_groups(&tile.cell, &sets.nodes);
        samples += hits::count(&context, &boxes, &mut sets.cells, watcher)?;
    }
    let bytes = codec::encode(&output).map_err(tile_error)?;
    tracing::debug!(tile = number, bytes = bytes.len(), "tile encoded");
    Ok(TileDone {
        bytes,
        samples,
        recomputed,
    })
}

/// Computes the bytes of a lost pack again.
fn again(
    job: &JobContext<'_>,
    plan: &Plan,
    number: u32,
    digest: PackDigest,
    watcher: &dyn Watcher,
) -> Result<Vec<u8>, BakeError> {
    tracing::warn!("the pack of tile {number} is lost and is computed again");
    let bytes = recompute(job, plan, number, watcher)?;
    if *blake3::hash(&bytes).as_bytes() == digest {
        return Ok(bytes);
    }
    Err(BakeError::Tile(format!(
        "the pack of tile {number} was computed again and came out different; the machine, driver or \
            program of a \
         worker differs from its profile"
    )))
}

/// Computes the encoded output of a tile together with the packs that it needs. The depth of the kd-tree
/// bounds their number, and the plan puts every tile after those it needs.
fn recompute(
    job: &JobContext<'_>,
    plan: &Plan,
    number: u32,
    watcher: &dyn Watcher,
) -> Result<Vec<u8>, BakeError> {
    let tile = &plan.tiles[number as usize];
    let mut packs: Vec<Pack> = Vec::with_capacity(tile.needs.len());
    for need in &tile.needs {
        let bytes = recompute(job, plan, *need, watcher)?;
        packs
            .push(codec::decode_pack(&bytes, job.scene.scene().len(), &tile.cell).map_err(broken)?);
    }
    let (output, _) = tile::run(job, tile, &packs, watcher)?;
    codec::encode(&output).map_err(broken)
}

/// Makes the error of a pack that was encoded here and cannot be read here.
fn broken(e: impl std::fmt::Display) -> BakeError {
    BakeError::Backend(BackendError::Failed {
        profile: "this worker".to_owned(),
        reason: e.to_string(),
    })
}

/// A crew that continues after the sampler has ended it.
struct Open<'a>(&'a dyn Crew);

impl Crew for Open<'_> {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        self.0.run(phase)
    }

    fn end(&self) -> Result<(), TileError> {
        Ok(())
    }
}

/// Watches the sampling of a tile whose cells are finished only when they are decided.
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
