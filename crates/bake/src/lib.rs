//! One tile from start to end: sampling, exact queries, ambient occlusion, and the bytes that come out.
//!
//! [`run_tile`], [`run_portal_tile`] and [`run_ambient_tile`] are the only places where choices that change
//! bytes meet. Their values are in [`choices`], beside the version of the algorithm. This crate keeps nothing
//! between two tiles; a worker owns scenes, backends, packs and receivers.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_bake::{Alone, BakeScene, Control, Watcher, run_tile};
//! use sightline_model::JobSpec;
//! use sightline_sampling::{CubeSpec, embree::CpuBackend};
//! use sightline_viewcells::Division;
//!
//! struct Unwatched;
//! impl Watcher for Unwatched {
//!     fn rendered(&self, _samples: u64) {}
//!     fn cell_done(&self) {}
//!     fn cancelled(&self) -> bool {
//!         false
//!     }
//! }
//!
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let spec = JobSpec::new(scene.digest().0, Division::Grid([8, 8, 8]), scene.bounds());
//! let backend = CpuBackend::new(Arc::clone(&scene), CubeSpec::of(&spec.sampling))?;
//! let control = Control { watcher: &Unwatched, deadline: None, crew: &Alone };
//! let done = run_tile(&spec, 0, &BakeScene::new(scene)?, &backend, &[], control)?;
//! println!("{} bytes from {} rays", done.bytes.len(), done.samples);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ambient;
mod boxes;
mod cell_phase;
pub mod choices;
mod decide;
mod decide_pairs;
mod groups;
mod outcome;
mod portals;
pub mod scene;
mod within;

use std::time::Instant;

pub use ambient::run_ambient_tile;
use outcome::tile_error;
pub use outcome::{BakeError, Control, PackDigest, TileDone};
pub use portals::run_portal_tile;
pub use scene::BakeScene;
use sightline_model::{JobSpec, Method, Pack, TileOutput, codec};
use sightline_portals::{NoPartition, OpenFaces};
pub use sightline_sampling::Watcher;
use sightline_sampling::crew::Phase;
pub use sightline_sampling::crew::{Alone, Crew};
use sightline_sampling::lines::hits;
use sightline_sampling::{Backend, BackendError, JobContext, TileError, tile};
use sightline_viewcells::{Division, Plan, TileKind};

use crate::boxes::off_walls;
use crate::within::Within;

/// The pack of a tile that another tile needs.
#[derive(Clone, Copy, Debug)]
pub enum PackBytes<'a> {
    /// Its bytes.
    Present(&'a [u8]),
    /// The digest of a pack that nobody has any more: it is computed again and must have this digest.
    Lost(PackDigest),
}

/// Computes tile `number` of the job's plan. `packs` holds the packs of the tiles it needs, in the plan's
/// order.
///
/// The bytes are a pure function of the specification, the scene and the backend's numerics profile, unless
/// the job has a time budget.
///
/// # Errors
/// [`BakeError`]; a cancelled tile is one.
///
/// # Panics
/// On a thread of rayon's pool, which could wait for itself.
pub fn run_tile(
    spec: &JobSpec,
    number: u32,
    scene: &BakeScene,
    backend: &dyn Backend,
    packs: &[PackBytes<'_>],
    control: Control<'_>,
) -> Result<TileDone, BakeError> {
    let (lattice, plan) = spec.plan().map_err(tile_error)?;
    let tile = plan.tiles.get(number as usize);
    let tile = tile.ok_or_else(|| BakeError::Tile("the plan has no such tile".to_owned()))?;
    let whole = spec;
    let own = boxes::of_box(whole, &lattice, tile).map_err(tile_error)?;
    let (spec, (lattice, plan), at) = match &own {
        // The job of a box has one tile.
        Some(own) => (own, own.plan().map_err(tile_error)?, 0),
        None => (whole, (lattice, plan), number),
    };
    let tile = &plan.tiles[at as usize];
    let watcher = control.watcher;
    if spec.ambient.is_some() {
        return Err(BakeError::Tile(
            "a job of receivers has no cells; run its tiles with them".to_owned(),
        ));
    }
    if spec.method == Method::Portals {
        return Err(BakeError::Tile(
            "the method portals needs no backend; run its tiles without".to_owned(),
        ));
    }
    if spec.method != Method::Aggressive && scene.scene().kinds().any_masked() {
        return Err(BakeError::Tile(
            "the method decides exactly, and exact queries do not read alpha masks; use the method \
             aggressive, or a scene whose masked triangles are see-through"
                .to_owned(),
        ));
    }
    let exact = spec.method != Method::Aggressive && tile.kind == TileKind::Leaf;
    // The members of the crew decide the cells as well.
    let decides = exact && control.deadline.is_none();
    let decided_later = Open(control.crew);
    let places = Within::of(spec, scene.scene()).map_err(tile_error)?;
    let is_open = matches!(whole.division, Division::Tree(_));
    let traced = if is_open {
        off_walls(spec, scene.scene()).map_err(tile_error)?
    } else {
        lattice.clone()
    };
    let job = JobContext {
        scene: scene.sampling(),
        division: spec.division.clone(),
        lattice: traced,
        params: &spec.sampling,
        viewpoints: spec.viewpoints.as_deref(),
        places: places.as_ref().map(|p| p as _),
        pairs: whole.pair_cells(),
        backend,
        seed: spec.seed,
        deadline: choices::sampling_deadline(spec.method, control.deadline),
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
                fresh = again(&job, &plan, *needed, *digest, watcher)?;
                recomputed.push((*digest, fresh.clone()));
                &fresh
            }
        };
        decoded
            .push(codec::decode_pack(bytes, scene.scene().len(), &tile.cell).map_err(tile_error)?);
    }
    let sampling_only = WithoutCells(watcher);
    let sampling_watcher: &dyn Watcher = if exact { &sampling_only } else { watcher };
    let (mut output, counters) = tile::run(&job, tile, &decoded, sampling_watcher)?;
    tracing::debug!(tile = number, ?counters, "tile sampled");
    if let (true, TileOutput::Cells(sets)) = (exact, &mut output) {
        let prepared = scene.exact().map_err(BakeError::Tile)?;
        let with = (control.deadline, watcher, control.crew);
        let within = places.as_ref().map(Within::places);
        let faces = is_open.then(|| OpenFaces::new(scene.scene(), spec.view_box, within));
        let within = faces.as_ref().map(|faces| faces as _).or(within);
        // Portals save time where walls enclose the viewpoints; elsewhere they hide little that groups of
        // cells do not (docs/experiments/portals.md). A region has no certificates, which portals could not
        // give.
        let late = || control.deadline.is_some_and(|end| Instant::now() >= end);
        let made = places
            .is_some()
            .then(|| scene.partition(whole, &|| watcher.cancelled() || late()));
        let partition = match made {
            None | Some(Err(NoPartition::Stopped)) => None,
            Some(made) => Some(made.map_err(tile_error)?),
        };
        let of = (prepared, partition.as_deref(), is_open);
        if whole.has_portals() && number == 0 {
            sets.portals = portals::encoded(of.1, scene.scene());
        }
        decide::cells((spec, within), &lattice, &tile.cell, sets, of, with)?;
        if watcher.cancelled() {
            return Err(BakeError::Cancelled);
        }
        if decides {
            control.crew.end()?;
        }
        tracing::debug!(tile = number, "tile decided");
    }
    let mut samples = counters.rendered;
    if let (true, TileOutput::Cells(sets)) = (spec.sampling.contributions, &mut output) {
        let (boxes, _) = groups::cells_and_groups(&tile.cell, &sets.nodes);
        samples += hits::count(&job, &boxes, &mut sets.cells, watcher)?;
    }
    let bytes = codec::encode(&output).map_err(tile_error)?;
    tracing::debug!(tile = number, bytes = bytes.len(), "tile encoded");
    Ok(TileDone {
        bytes,
        samples,
        recomputed,
    })
}

/// The bytes of a lost pack, computed again.
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

/// The encoded output of a tile, computed together with the packs that it needs. The depth of the kd-tree
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

/// A pack that was encoded here and cannot be read here.
fn broken(e: impl std::fmt::Display) -> BakeError {
    BakeError::Backend(BackendError::Failed {
        profile: "this worker".to_owned(),
        reason: e.to_string(),
    })
}

/// A crew that goes on after the sampler has ended it.
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
