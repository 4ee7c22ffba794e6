//! Questions about stored results. The coordinator reads sets; what needs rays or exact queries is answered
//! by whoever it was given, because it samples nothing itself.

use std::sync::{Arc, PoisonError};

use sightline_proto::v1;
use sightline_pvs::{Pvs, PvsError};
use sightline_records::JobRecord;
use sightline_records::ids::JobId;
use sightline_scene::{Scene, SceneError};
use sightline_store::BlobError;

use crate::jobs::control::{self, JobError};
use crate::jobs::stored_spec;
use crate::kept::SceneQueries;
use crate::state::Coordinator;
use crate::telemetry::metrics::Cache;

/// Faces of the cube that is rendered around a viewpoint.
const CUBE_FACES: u64 = 6;
/// Maximum number of pixels of a measurement: seconds of one question, for which the others wait.
const MAX_PIXELS: u64 = 100_000_000;

/// A question without an answer.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AskError {
    /// The job has no result.
    #[error(transparent)]
    Job(#[from] JobError),
    /// The question is about something that is not there.
    #[error("{0}")]
    Wrong(String),
    /// It cannot be answered for this result, or here.
    #[error("{0}")]
    Unable(String),
    /// A blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The stored result is damaged.
    #[error(transparent)]
    Pvs(#[from] PvsError),
    /// The stored scene is damaged.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// A done job's result. The one that was asked about last stays open.
fn open(c: &Coordinator, job: JobId) -> Result<Arc<Pvs>, AskError> {
    let digest = control::result(c, job)?;
    has_sets(&control::record(c, job).map_err(JobError::from)?)?;
    let mut last = c.last_asked.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, pvs)) = last.as_ref().filter(|(of, _)| *of == digest) {
        c.metrics.looked("result", Cache::Hit);
        return Ok(Arc::clone(pvs));
    }
    c.metrics.looked("result", Cache::Miss);
    let pvs = Arc::new(Pvs::from_bytes(c.blobs.read(&digest)?)?);
    *last = Some((digest, Arc::clone(&pvs)));
    Ok(pvs)
}

/// Whether a job computes sets that can be asked about.
pub(crate) fn has_sets(record: &JobRecord) -> Result<(), AskError> {
    let none = || {
        let id = record.id;
        AskError::Unable(format!(
            "job {id} computes ambient occlusion and has no sets; `Fetch` gives its result"
        ))
    };
    if stored_spec::receivers(&record.spec).is_some() {
        Err(none())
    } else {
        Ok(())
    }
}

/// A job's record and its scene.
pub(crate) fn scene(c: &Coordinator, job: JobId) -> Result<(JobRecord, Scene), AskError> {
    let record = control::record(c, job).map_err(JobError::from)?;
    let scene = Scene::from_blob(&record.name, &c.blobs.read(&record.scene)?)?;
    Ok((record, scene))
}

/// The cell of a point.
fn cell_at(pvs: &Pvs, v1::Point { x, y, z }: v1::Point) -> Result<u32, AskError> {
    pvs.find_cell([x, y, z]).ok_or_else(|| {
        let [min, max] = pvs.tree().view_box();
        AskError::Wrong(format!(
            "({x}, {y}, {z}) is outside the view box, which extends from {min:?} to {max:?}"
        ))
    })
}

/// A cell that there is.
fn cell_of(pvs: &Pvs, cell: u32) -> Result<u32, AskError> {
    let cells = pvs.cells();
    let none = || {
        AskError::Wrong(format!(
            "there is no cell {cell}; the result has {cells}, from 0"
        ))
    };
    (cell < cells).then_some(cell).ok_or_else(none)
}

fn nowhere() -> AskError {
    AskError::Wrong("give a point or a cell".to_owned())
}

/// The set of a cell.
pub(crate) fn query(
    c: &Coordinator,
    asked: &v1::QueryRequest,
) -> Result<v1::QueryResponse, AskError> {
    use v1::query_request::From;
    let pvs = open(c, JobId(asked.job))?;
    let from = asked.from.ok_or_else(nowhere)?;
    let cell = match from {
        From::Point(point) => cell_at(&pvs, point)?,
        From::Cell(cell) => cell_of(&pvs, cell)?,
    };
    let (mut visible, mut undecided, mut names) = (Vec::new(), Vec::new(), Vec::new());
    if asked.objects {
        pvs.visible_objects(cell, &mut visible)?;
        pvs.undecided_objects(cell, &mut undecided)?;
        let name = |id: &u32| {
            pvs.objects()
                .get(*id as usize)
                .map_or_else(String::new, |o| o.name.clone())
        };
        names = visible.iter().map(name).collect();
    } else {
        pvs.visible(cell, &mut visible)?;
        pvs.undecided(cell, &mut undecided)?;
    }
    let bounds = pvs.cell_bounds(cell).unwrap_or_default();
    Ok(v1::QueryResponse {
        cell,
        r#box: bounds.concat(),
        visible,
        undecided,
        names,
        set_aside: pvs.is_set_aside(cell)?,
    })
}

/// Computes why a triangle is visible or not. Stops when the asker `is_gone`.
pub(crate) fn why(
    c: &Coordinator,
    asked: &v1::WhyRequest,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<v1::WhyResponse, AskError> {
    use v1::why_request::From;
    let pvs = open(c, JobId(asked.job))?;
    let from = asked.from.ok_or_else(nowhere)?;
    let cell = match from {
        From::Point(point) => cell_at(&pvs, point)?,
        From::Cell(cell) => cell_of(&pvs, cell)?,
    };
    if asked.triangle >= pvs.triangle_count() {
        let (triangle, count) = (asked.triangle, pvs.triangle_count());
        return Err(AskError::Wrong(format!(
            "there is no triangle {triangle}; the scene has {count}, from 0"
        )));
    }
    let (_, scene) = scene(c, JobId(asked.job))?;
    answers(c)?
        .why(&pvs, scene, (cell, asked.triangle), is_gone)
        .map_err(AskError::Unable)
}

/// Counts wrong pixels. Stops when the asker `is_gone`.
pub(crate) fn measure(
    c: &Coordinator,
    asked: &v1::MeasureRequest,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<v1::MeasureResponse, AskError> {
    let usual = |n: u32, usual: u32| if n == 0 { usual } else { n };
    let asked = v1::MeasureRequest {
        viewpoints: usual(asked.viewpoints, 100),
        resolution: usual(asked.resolution, 128),
        ..*asked
    };
    if asked.viewpoints > 1000 {
        return Err(AskError::Wrong(format!(
            "{} viewpoints are more than 1000",
            asked.viewpoints
        )));
    }
    if !(8..=512).contains(&asked.resolution) {
        return Err(AskError::Wrong(format!(
            "a resolution of {} is not between 8 and 512",
            asked.resolution
        )));
    }
    let pixels = u64::from(asked.viewpoints) * CUBE_FACES * u64::from(asked.resolution).pow(2);
    if pixels > MAX_PIXELS {
        return Err(AskError::Wrong(format!(
            "{} viewpoints at resolution {} have {pixels} pixels, and at most {MAX_PIXELS} are measured; \
             ask for fewer viewpoints or a lower resolution",
            asked.viewpoints, asked.resolution
        )));
    }
    let pvs = open(c, JobId(asked.job))?;
    let (_, scene) = scene(c, JobId(asked.job))?;
    answers(c)?
        .measure(&pvs, scene, &asked, is_gone)
        .map_err(AskError::Unable)
}

fn answers(c: &Coordinator) -> Result<&dyn SceneQueries, AskError> {
    let none = || {
        AskError::Unable(
            "the program that this coordinator is in answers no such questions".to_owned(),
        )
    };
    c.answers.get().map(|answers| &**answers).ok_or_else(none)
}
