//! `sightline assemble`: joins the tiles of a planned bake to a result.

use std::io::Write as _;

use serde_json::json;
use sightline_assemble::check::{SceneSize, check};
use sightline_assemble::{
    AssembleError, Assembly, OutputState, Outputs, SceneSummary, items, write,
};

use sightline_pvs::PvsError;

use super::place::PlanPlace;
use super::planned::PlannedBake;
use super::tile_file::TileFile;
use crate::error::CliError;
use crate::output::{Format, Output};
use crate::serve::{self, threads};
use crate::tiles_args::AssembleArgs;

/// Absent tiles that an error names.
const NAMED: usize = 10;

/// The outputs in a folder, all of which are there.
struct FolderOutputs<'a> {
    bake: &'a PlannedBake,
    scene: SceneSize,
}

impl FolderOutputs<'_> {
    /// Reads a tile.
    fn tile(&self, tile: u32) -> Result<TileFile, CliError> {
        let wrong = |e: &dyn std::fmt::Display| self.wrong(tile, e);
        let found = self
            .bake
            .tile(tile)?
            .ok_or_else(|| wrong(&"it is absent"))?;
        found.map_err(|e| wrong(&e))
    }

    /// Reads and checks a tile; returns its samples.
    fn checked(&self, tile: u32) -> Result<u64, CliError> {
        let found = self.tile(tile)?;
        let planned = (tile, &self.bake.job.plan().tiles[tile as usize]);
        let checked = check(
            self.bake.task()?,
            planned,
            self.scene,
            &found.output,
            u64::MAX,
        );
        checked.map_err(|e| self.wrong(tile, &e))?;
        Ok(found.samples)
    }

    fn wrong(&self, tile: u32, e: &dyn std::fmt::Display) -> CliError {
        let name = self.bake.place.name(&PlannedBake::file(tile));
        CliError::Input(format!(
            "{name}: {e}; `sightline tile DIR {tile}` computes it again"
        ))
    }
}

impl Outputs for FolderOutputs<'_> {
    type Error = CliError;

    fn state(&self, _tile: u32) -> OutputState {
        OutputState::Done
    }

    fn read(&self, tile: u32) -> Result<Vec<u8>, CliError> {
        self.tile(tile).map(|found| found.output)
    }
}

/// Writes the result of a planned bake.
///
/// # Errors
/// [`CliError::Input`] naming the tiles that are absent, damaged or of another job.
pub fn assemble(args: &AssembleArgs, json: bool) -> Result<(), CliError> {
    serve::use_threads(threads(None))?;
    let output = Output::check(&args.output, Format::Pvs, None)?;
    let bake = PlannedBake::read(PlanPlace::open(&args.dir)?)?;
    let task = bake.task()?;
    let tiles = 0..bake.job.plan().tiles.len() as u32;
    let mut absent = Vec::new();
    for tile in tiles.clone() {
        if !bake.place.has(&PlannedBake::file(tile))? {
            absent.push(tile.to_string());
        }
    }
    if !absent.is_empty() {
        let more = match absent.len() {
            0..=NAMED => String::new(),
            n => format!(" and {} more", n - NAMED),
        };
        absent.truncate(NAMED);
        return Err(CliError::Input(format!(
            "tiles are absent in {}: {}{more}; compute them with `sightline tile {} N`",
            args.dir,
            absent.join(", "),
            args.dir
        )));
    }
    let scene = bake.scene()?;
    let outputs = FolderOutputs {
        bake: &bake,
        scene: SceneSize {
            triangles: scene.len(),
            objects: scene.objects().len() as u32,
        },
    };
    let mut samples = 0u64;
    for tile in tiles {
        samples = samples.saturating_add(outputs.checked(tile)?);
    }
    let assembly = Assembly {
        job: &bake.job,
        profile: &bake.profile,
        samples,
        scene: &SceneSummary::from(&scene),
        items: items(&scene, task.items()),
        outputs: &outputs,
        scratch: match task.has_certificates() {
            true => Some(tempfile::tempfile().map_err(CliError::internal)?),
            false => None,
        },
    };
    let mut file = output.begin()?;
    let written = write(assembly, task, &mut file).map_err(|e| match e {
        AssembleError::Read(e) => e,
        AssembleError::Pvs(PvsError::Write(e)) => CliError::writing(&args.output, &e),
        e => CliError::Input(e.to_string()),
    })?;
    file.flush()
        .map_err(|e| CliError::writing(&args.output, &e))?;
    file.place()?;
    let name = args.output.display().to_string();
    if json {
        return serve::print(&json!({ "output": name, "bytes": written }).to_string());
    }
    serve::print(&format!(
        "{name}: {written} bytes; `sightline info {name}` describes it"
    ))
}
