//! The assembly of a result from the tiles of a planned bake.

use std::io::Write as _;
use std::path::Path;

use serde::Serialize;
use sightline_assemble::check::{SceneSize, check};
use sightline_assemble::{
    AssembleError, Assembly, OutputState, Outputs, SceneSummary, items, write,
};
use sightline_pvs::PvsError;
use sightline_viewcells::TileIndex;

use super::place::PlanPlace;
use super::planned::PlannedBake;
use super::tile_file::TileFile;
use crate::error::Error;
use crate::output::{Format, Output};
use crate::process::{threads, use_threads};

/// Maximum number of missing tiles that an error lists.
const NAMED: usize = 10;

/// The outputs of a planned bake whose folder contains the files of all tiles.
struct FolderOutputs<'a> {
    bake: &'a PlannedBake,
    scene: SceneSize,
}

impl FolderOutputs<'_> {
    /// Reads a tile.
    fn tile(&self, tile: TileIndex) -> Result<TileFile, Error> {
        let wrong = |e: &dyn std::fmt::Display| self.wrong(tile, e);
        let found = self
            .bake
            .tile(tile)?
            .ok_or_else(|| wrong(&"the file is missing"))?;
        found.map_err(|e| wrong(&e))
    }

    /// Reads and checks a tile. Returns the number of its samples.
    fn checked(&self, tile: TileIndex) -> Result<u64, Error> {
        let found = self.tile(tile)?;
        let checked = check(
            self.bake.task()?,
            tile,
            &self.bake.job.plan().tiles[tile.at()],
            self.scene,
            &found.output,
            u64::MAX,
        );
        checked.map_err(|e| self.wrong(tile, &e))?;
        Ok(found.samples)
    }

    fn wrong(&self, tile: TileIndex, e: &dyn std::fmt::Display) -> Error {
        let name = self.bake.place.name(&PlannedBake::file(tile));
        Error::input(format!(
            "{name}: {e}; `sightline tile DIR {tile}` computes the tile again"
        ))
    }
}

impl Outputs for FolderOutputs<'_> {
    type Error = Error;

    fn state(&self, _tile: TileIndex) -> OutputState {
        OutputState::Done
    }

    fn read(&self, tile: TileIndex) -> Result<Vec<u8>, Error> {
        self.tile(tile).map(|found| found.output)
    }
}

/// An assembled result. Its serialisation is the document that `sightline assemble --json` prints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Assembled {
    /// The path of the result file.
    pub output: String,
    /// The size of the file, in bytes.
    pub bytes: u64,
}

/// Joins the tiles of the plan in a folder or bucket to a result. The result has the same bytes as the result
/// of a bake. The [module](super) has an example.
///
/// # Errors
/// [`crate::ErrorKind::Input`] with the tiles, if tiles are absent, damaged or of another job, or
/// [`crate::ErrorKind::Usage`] if the path cannot be written.
pub fn assemble(dir: &str, path: &Path) -> Result<Assembled, Error> {
    use_threads(threads(None))?;
    let output = Output::check(path, Format::Pvs, None)?;
    let bake = PlannedBake::read(PlanPlace::open(dir)?)?;
    let task = bake.task()?;
    let tiles = (0..bake.job.plan().tiles.len() as u32).map(TileIndex);
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
        return Err(Error::input(format!(
            "tiles are missing in {dir}: {}{more}; compute them with `sightline tile {dir} N`",
            absent.join(", ")
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
            true => Some(tempfile::tempfile().map_err(Error::internal)?),
            false => None,
        },
    };
    let mut file = output.begin()?;
    let written = write(assembly, task, &mut file).map_err(|e| match e {
        AssembleError::Read(e) => e,
        AssembleError::Pvs(PvsError::Write(e)) => Error::writing(path, &e),
        e => Error::input(e.to_string()),
    })?;
    file.flush().map_err(|e| Error::writing(path, &e))?;
    file.place()?;
    Ok(Assembled {
        output: path.display().to_string(),
        bytes: written,
    })
}
