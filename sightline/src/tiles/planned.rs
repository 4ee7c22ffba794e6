//! A planned bake as its folder has it: the job's message, the scene, and `plan.json`.

use prost::Message as _;
use serde::{Deserialize, Serialize};
use sightline_model::{ALGORITHM_VERSION, JobSpec, PlannedJob, SceneFacts, Task, Visibility};
use sightline_proto::v1;
use sightline_scene::Scene;
use sightline_viewcells::TileKind;

use super::place::PlanPlace;
use super::tile_file::{TileFile, TileFileError};
use crate::error::Error;

/// The name of the format of `plan.json`.
const FORMAT: &str = "sightline.plan";
/// The version of the format.
const VERSION: u32 = 1;
/// The file that is written last: with it the folder is complete.
const PLAN: &str = "plan.json";
/// The file of the job's message.
const JOB: &str = "job.bin";
/// The file of the scene's canonical bytes.
const SCENE: &str = "scene.bin";

/// The document `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanFile {
    /// `sightline.plan`.
    pub format: String,
    /// 1.
    pub version: u32,
    /// The version of the algorithms.
    pub algorithm: u32,
    /// The job's key, in hexadecimal.
    pub key: String,
    /// The numerics profile with which every tile must be computed.
    pub profile: String,
    /// The job, as results have it.
    pub spec: serde_json::Value,
    /// The tiles in the order of the plan.
    pub tiles: Vec<PlanTile>,
}

/// A tile of the document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanTile {
    /// The numbers of the tiles whose outputs it reads.
    pub needs: Vec<u32>,
    /// `leaf` for a tile of cells, `face` or `separator` for one of samples.
    pub kind: String,
    /// The number of its cells, 1 in an adaptive tree.
    pub cells: u64,
}

/// A planned bake.
pub struct PlannedBake {
    /// The folder or bucket.
    pub place: PlanPlace,
    /// The job.
    pub job: PlannedJob,
    /// The numerics profile.
    pub profile: String,
}

impl PlannedBake {
    /// Writes a planned bake. The files of the same bake are written again, so that damaged ones are
    /// replaced.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] for a folder that holds another bake.
    pub fn write(&self, scene: &Scene) -> Result<(), Error> {
        let plan = self.document();
        let there = self.place.read(PLAN)?;
        let there = there.and_then(|there| serde_json::from_slice::<PlanFile>(&there).ok());
        if there.is_some_and(|there| (&there.key, &there.profile) != (&plan.key, &plan.profile)) {
            return Err(Error::input(format!(
                "{} is of another bake; give another folder, or delete all of it",
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
    /// [`crate::ErrorKind::Input`] for a folder without one, or with one of another version.
    pub fn read(place: PlanPlace) -> Result<Self, Error> {
        let wrong = |file: &str, why: &dyn std::fmt::Display| {
            Error::input(format!("{}: {why}; plan the bake again", place.name(file)))
        };
        let Some(plan) = place.read(PLAN)? else {
            return Err(Error::input(format!(
                "{} is absent; `sightline plan SCENE -o DIR` writes it",
                place.name(PLAN)
            )));
        };
        let plan: PlanFile = serde_json::from_slice(&plan).map_err(|e| wrong(PLAN, &e))?;
        if plan.format != FORMAT || plan.version != VERSION {
            let found = format!("format {:?}, version {}", plan.format, plan.version);
            return Err(wrong(
                PLAN,
                &format!("{found}, and this program has {FORMAT:?}, {VERSION}"),
            ));
        }
        if plan.algorithm != ALGORITHM_VERSION {
            return Err(wrong(
                PLAN,
                &format!(
                    "algorithm {}, and this program has {ALGORITHM_VERSION}",
                    plan.algorithm
                ),
            ));
        }
        let message = place
            .read(JOB)?
            .ok_or_else(|| wrong(JOB, &"it is absent"))?;
        let message = v1::JobSpec::decode(&*message).map_err(|e| wrong(JOB, &e))?;
        let spec = JobSpec::from_message(&message, &SceneFacts::default());
        let job = PlannedJob::stored(spec.map_err(|e| wrong(JOB, &e))?);
        if hex(&job.key()) != plan.key {
            return Err(wrong(JOB, &"it is not the job of the plan"));
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
    /// [`crate::ErrorKind::Input`] for bytes that are not the scene of the job.
    pub fn scene(&self) -> Result<Scene, Error> {
        let name = self.place.name(SCENE);
        let wrong = |why: &str| Error::input(format!("{name}: {why}; plan the bake again"));
        let bytes = self
            .place
            .read(SCENE)?
            .ok_or_else(|| wrong("it is absent"))?;
        let scene = Scene::from_blob(&name, &bytes).map_err(|e| Error::input(e.to_string()))?;
        match scene.digest().0 == self.job.spec().scene {
            true => Ok(scene),
            false => Err(wrong("it is not the scene of the plan, or it is damaged")),
        }
    }

    /// Returns the task, which is visibility: `plan` makes no other.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] for a job of another task.
    pub fn task(&self) -> Result<&Visibility, Error> {
        match &self.job.spec().task {
            Task::Visibility(task) => Ok(task),
            Task::Ambient(_) => Err(Error::input(format!(
                "{} is a job of ambient occlusion, which has no plan in a folder",
                self.place.name(JOB)
            ))),
        }
    }

    /// Returns the digest of the job's key and the numerics profile, which decide the bytes of its tiles.
    pub fn identity(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.job.key());
        hasher.update(self.profile.as_bytes());
        *hasher.finalize().as_bytes()
    }

    /// Returns the name of a tile's file.
    pub fn file(tile: u32) -> String {
        format!("tiles/{tile}.tile")
    }

    /// Reads the file of a tile; `None` when it is absent.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Input`] for a file that cannot be read; the inner error for bytes that are not the
    /// tile's.
    pub fn tile(&self, tile: u32) -> Result<Option<Result<TileFile, TileFileError>>, Error> {
        let bytes = self.place.read(&Self::file(tile))?;
        Ok(bytes.map(|bytes| TileFile::decode(&bytes, &self.identity(), tile)))
    }
}

fn hex(bytes: &[u8; 32]) -> String {
    blake3::Hash::from_bytes(*bytes).to_hex().to_string()
}
