//! The computation of one tile of a planned bake.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde::Serialize;
use sightline_bake::{BakeError, Control, Inputs, PackBytes, SoleMember, TileDone, Watcher};
use sightline_model::TracerChoice;
use sightline_trace::CubeSpec;
use sightline_trace::gpu::AdapterChoice;
use sightline_viewcells::TileIndex;
use sightline_worker::{Backends, TracedScene, TracerSelection};

use super::place::PlanPlace;
use super::planned::PlannedBake;
use super::tile_file::TileFile;
use crate::error::Error;
use crate::observer::{Observer, note};
use crate::process::{threads, use_threads};
use crate::progress::Counter;

/// A computed tile. Its serialisation is the document that `sightline tile --json` prints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TileReport {
    /// The number of the tile.
    pub tile: TileIndex,
    /// The path of the tile's file.
    pub output: String,
    /// False if a complete file already existed.
    pub computed: bool,
    /// The number of samples.
    pub samples: u64,
    /// The size of the tile's output, in bytes.
    pub bytes: u64,
}

/// Computes a tile of the plan in a folder or bucket, unless a complete file of the tile exists. The
/// [module](super) has an example.
///
/// # Errors
/// [`crate::ErrorKind::Usage`] if the plan has no tile with this number. [`crate::ErrorKind::Input`] if the
/// plan cannot be read, a needed tile is absent, or the machine lacks the plan's tracer.
/// [`crate::ErrorKind::Job`] if the tile fails. [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn run_tile(
    dir: &str,
    number: TileIndex,
    observer: &dyn Observer,
) -> Result<TileReport, Error> {
    use_threads(threads(None))?;
    let bake = PlannedBake::read(PlanPlace::open(dir)?)?;
    let count = bake.job.plan().tiles.len();
    if number.at() >= count {
        return Err(Error::usage(format!(
            "there is no tile {number}: the plan has {count} tiles, numbered from 0"
        )));
    }
    let name = bake.place.name(&PlannedBake::file(number));
    match bake.tile(number)? {
        Some(Ok(stored)) => return Ok(report(&bake, &stored, false)),
        Some(Err(e)) => note(
            observer,
            format!("note: {name}: {e}; this run computes the tile again"),
        ),
        None => {}
    }
    let packs = needed(&bake, number)?;
    let done = compute(&bake, number, &packs, observer)?;
    let file = TileFile {
        bake: bake.identity(),
        tile: number,
        samples: done.samples,
        output: done.bytes,
    };
    bake.place
        .write(&PlannedBake::file(number), file.encode())?;
    Ok(report(&bake, &file, true))
}

fn report(bake: &PlannedBake, tile: &TileFile, computed: bool) -> TileReport {
    TileReport {
        tile: tile.tile,
        output: bake.place.name(&PlannedBake::file(tile.tile)),
        computed,
        samples: tile.samples,
        bytes: tile.output.len() as u64,
    }
}

/// Reads the outputs of the tiles that a tile depends on.
fn needed(bake: &PlannedBake, number: TileIndex) -> Result<Vec<Vec<u8>>, Error> {
    let needs = &bake.job.plan().tiles[number.at()].needs;
    let mut absent = Vec::new();
    let mut packs = Vec::with_capacity(needs.len());
    for need in needs.iter().copied().map(TileIndex) {
        match bake.tile(need)? {
            Some(Ok(tile)) => packs.push(tile.output),
            Some(Err(e)) => {
                return Err(Error::input(format!(
                    "{}, which tile {number} needs: {e}; `sightline tile DIR {need}` computes tile {need} \
                     again",
                    bake.place.name(&PlannedBake::file(need))
                )));
            }
            None => absent.push(need.to_string()),
        }
    }
    match absent.is_empty() {
        true => Ok(packs),
        false => Err(Error::input(format!(
            "tile {number} needs tiles that are missing: {}; compute these tiles first",
            absent.join(", ")
        ))),
    }
}

/// The number of finished cells of a tile, and the observer of the call.
struct Counts<'a> {
    cells: AtomicU64,
    observer: &'a dyn Observer,
}

impl Watcher for Counts<'_> {
    fn rendered(&self, _samples: u64) {}

    fn cell_done(&self) {
        self.cells.fetch_add(1, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        self.observer.is_cancelled()
    }
}

fn compute(
    bake: &PlannedBake,
    number: TileIndex,
    packs: &[Vec<u8>],
    observer: &dyn Observer,
) -> Result<TileDone, Error> {
    let scene = Arc::new(bake.scene()?);
    let loaded = TracedScene::new(scene)?;
    let tracer = match bake.task()?.sampling() {
        Some(sampling) => {
            let backends = Backends::probe(selection(&bake.profile), AdapterChoice::default());
            if !backends.profiles().contains(&bake.profile) {
                return Err(Error::input(format!(
                    "the plan is for the numerics profile {}, but this machine has: {}; compute the tile \
                     on a machine with that profile, or plan the bake on this machine",
                    bake.profile,
                    backends.profiles().join(", ")
                )));
            }
            let cubes = CubeSpec::from_sampler(&sampling.sampler);
            let tracer = loaded.backend(&backends, &bake.profile, cubes, "");
            Some(tracer.map_err(Error::internal)?)
        }
        None => None,
    };
    let packs: Vec<PackBytes<'_>> = packs
        .iter()
        .map(|bytes| PackBytes::Present(bytes))
        .collect();
    let inputs = Inputs {
        tracer: tracer.as_deref(),
        ..Inputs::new(&loaded.scene).with_packs(&packs)
    };
    let counter = Counter::new("cells", observer);
    let counts = Counts {
        cells: AtomicU64::new(0),
        observer,
    };
    let cells = bake.job.plan().tiles[number.at()].cells;
    let done = std::thread::scope(|scope| {
        let tile = scope.spawn(|| {
            let control = Control {
                watcher: &counts,
                deadline: None,
                crew: &SoleMember,
            };
            sightline_bake::run(&bake.job, number, inputs, control)
        });
        while !tile.is_finished() {
            if cells > 0 {
                counter.show(counts.cells.load(Ordering::Relaxed), cells);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        tile.join()
    });
    let done = done.map_err(|_| {
        Error::internal(
            "the computation of the tile panicked; report this \
     fault",
        )
    })?;
    done.map_err(|e| match e {
        BakeError::Cancelled => Error::cancelled("interrupted; no file of the tile was written"),
        BakeError::Backend(_) => Error::internal(e),
        BakeError::Tile(_) => Error::job(e.to_string()),
    })
}

/// Returns the kind of backend of a numerics profile.
fn selection(profile: &str) -> TracerSelection {
    let choices = [TracerChoice::Gpu, TracerChoice::Embree];
    let choice = choices.into_iter().find(|c| c.accepts(profile));
    crate::tracers::selection(choice.unwrap_or(TracerChoice::Cpu))
}
