//! A planned bake in a folder: the job's message, the scene, and `plan.json`.

use prost::Message as _;
use serde::{Deserialize, Serialize};
use sightline_model::{ALGORITHM_VERSION, JobSpec, PlannedJob, SceneFacts, Task, Visibility};
use sightline_proto::v1;
use sightline_scene::Scene;
use sightline_viewcells::{TileIndex, TileKind};

use super::place::PlanPlace;
use super::tile_file::{TileFile, TileFileError};
use crate::error::Error;

/// The name of the format of `plan.json`.
const FORMAT: &str = "sightline.plan";
/// The version of the format.
const VERSION: u32 = 1;
/// The name of the file that is written last and marks the folder as complete.
const PLAN: &str = "plan.json";
/// The name of the file with the job's message.
const JOB: &str = "job.bin";
/// The name of the file with the scene's canonical bytes.
const SCENE: &str = "scene.bin";

/// The document `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanFile {
    /// The name of the format: `sightline.plan`.
    pub format: String,
    /// The version of the format: 1.
    pub version: u32,
    /// The version of the algorithms (`ALGORITHM_VERSION`) of the program that wrote the plan.
    pub algorithm: u32,
    /// The job's key, in hexadecimal.
    pub key: String,
    /// The numerics profile with which every tile must be computed.
    pub profile: String,
    /// The job's specification, in the same form as in results.
    pub spec: serde_json::Value,
    /// The tiles in the order of the plan.
    pub tiles: Vec<PlanTile>,
}

/// A tile of the document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanTile {
    /// The numbers of the tiles whose outputs this tile reads.
    pub needs: Vec<u32>,
    /// The kind of the tile: `leaf` for cells, `face` or `separator` for samples.
    pub kind: String,
    /// The number of the tile's cells: 1 for a leaf of an adaptive tree, and 0 for a face or separator.
    pub cells: u64,
}

/// A planned bake.
pub struct PlannedBake {
    /// The location of the files.
    pub place: PlanPlace,
    /// The job.
    pub job: PlannedJob,
    /// The numerics profile.
    pub profile: String,
}

impl PlannedBake {
    /// Writes a planned bake. If the folder contains the same bake, its files are written again, so that
    /// damaged ones are replaced.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the folder contains another bake.
    pub fn write(&self, scene: &Scene) -> Result<(), Error> {
        let plan = self.document();
        let there = self.place.read(PLAN)?;
        let there = there.and_then(|there| serde_json::from_slice::<PlanFile>(&there).ok());
        if there.is_some_and(|there| (&there.key, &there.profile) != (&plan.key, &plan.profile)) {
            return Err(Error::input(format!(
                "{} belongs to another bake; give another folder, or delete the folder",
                self.place.name(PLAN)
            )));
        }
        self.place
            .write(JOB, self.job.spec().to_message().encode_to_vec())?;
        self.place.write(SCENE, scene.to_blob())?;
        let text = serde_json::to_vec_pretty(&plan).map_err(Error::internal)?;
        self.place.write(PLAN, text)
    }

    fn document(&self) -> PlanFile {
        let kind = |kind: TileKind| match kind {
            TileKind::Leaf => "leaf",
            TileKind::Face(_) => "face",
            TileKind::Separator(_) => "separator",
        };
        let tiles = self.job.plan().tiles.iter().map(|tile| PlanTile {
            needs: tile.needs.clone(),
            kind: kind(tile.kind).to_owned(),
            cells: tile.cells,
        });
        PlanFile {
            format: FORMAT.to_owned(),
            version: VERSION,
            algorithm: ALGORITHM_VERSION,
            key: hex(&self.job.key()),
            profile: self.profile.clone(),
            spec: self.job.spec().to_json(),
            tiles: tiles.collect(),
        }
    }

    /// Reads a planned bake.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the folder contains no planned bake, or one of another version.
    pub fn read(place: PlanPlace) -> Result<Self, Error> {
        let wrong = |file: &str, why: &dyn std::fmt::Display| {
            Error::input(format!("{}: {why}; plan the bake again", place.name(file)))
        };
        let Some(plan) = place.read(PLAN)? else {
            return Err(Error::input(format!(
                "{} is missing; `sightline plan SCENE -o DIR` writes the plan",
                place.name(PLAN)
            )));
        };
        let plan: PlanFile = serde_json::from_slice(&plan).map_err(|e| wrong(PLAN, &e))?;
        if plan.format != FORMAT || plan.version != VERSION {
            let found = format!("format {:?}, version {}", plan.format, plan.version);
            return Err(wrong(
                PLAN,
                &format!(
                    "the file has {found}, but this program reads format {FORMAT:?}, version \
                {VERSION}"
                ),
            ));
        }
        if plan.algorithm != ALGORITHM_VERSION {
            return Err(wrong(
                PLAN,
                &format!(
                    "the plan has the algorithm version {}, but this program has {ALGORITHM_VERSION}",
                    plan.algorithm
                ),
            ));
        }
        let message = place
            .read(JOB)?
            .ok_or_else(|| wrong(JOB, &"the file is missing"))?;
        let message = v1::JobSpec::decode(&*message).map_err(|e| wrong(JOB, &e))?;
        let spec = JobSpec::from_message(&message, &SceneFacts::default());
        let job = PlannedJob::stored(spec.map_err(|e| wrong(JOB, &e))?);
        if hex(&job.key()) != plan.key {
            return Err(wrong(
                JOB,
                &"the key of the job differs from the key in plan.json",
            ));
        }
        let profile = plan.profile;
        Ok(Self {
            place,
            job,
            profile,
        })
    }

    /// Reads the scene.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the bytes are not the scene of the job.
    pub fn scene(&self) -> Result<Scene, Error> {
        let name = self.place.name(SCENE);
        let wrong = |why: &str| Error::input(format!("{name}: {why}; plan the bake again"));
        let bytes = self
            .place
            .read(SCENE)?
            .ok_or_else(|| wrong("the file is missing"))?;
        let scene = Scene::from_blob(&name, &bytes).map_err(|e| Error::input(e.to_string()))?;
        match scene.digest().0 == self.job.spec().scene {
            true => Ok(scene),
            false => Err(wrong("the file contains another scene, or is damaged")),
        }
    }

    /// Returns the visibility task of the job. `plan` writes no jobs with other tasks.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the job has another task.
    pub fn task(&self) -> Result<&Visibility, Error> {
        match &self.job.spec().task {
            Task::Visibility(task) => Ok(task),
            Task::Ambient(_) => Err(Error::input(format!(
                "{} is a job of ambient occlusion, which cannot be planned in a folder; use `sightline \
                 ambient`",
                self.place.name(JOB)
            ))),
        }
    }

    /// Returns the digest of the job's key and the numerics profile, which determine the bytes of its tiles.
    pub fn identity(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.job.key());
        hasher.update(self.profile.as_bytes());
        *hasher.finalize().as_bytes()
    }

    /// Returns the name of a tile's file.
    pub fn file(tile: TileIndex) -> String {
        format!("tiles/{tile}.tile")
    }

    /// Reads the file of a tile, or returns `None` if the file is absent.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] if the file cannot be read. The inner [`TileFileError`] if the bytes are
    /// not this tile.
    pub fn tile(&self, tile: TileIndex) -> Result<Option<Result<TileFile, TileFileError>>, Error> {
        let bytes = self.place.read(&Self::file(tile))?;
        Ok(bytes.map(|bytes| TileFile::decode(&bytes, &self.identity(), tile)))
    }
}

fn hex(bytes: &[u8; 32]) -> String {
    blake3::Hash::from_bytes(*bytes).to_hex().to_string()
}
